// Texts above places in the scene, with a line down to them. One that would lie over an earlier one stands above it.

import { Vector3 } from "three";

const LIFT = 0.9; // of its height, from its place up to its lower edge
const GAP = 1; // px between two
const BACK = "#10141ccc"; // as the style sheet has them
const PAD = 5; // px

export class Labels {
  constructor(box) {
    this.box = box;
    this.labels = new Set();
  }

  // `place` returns its position, or null while it is hidden.
  add(text, colour, place) {
    const element = document.createElement("span");
    element.textContent = text;
    element.style.color = colour;
    const line = document.createElement("i");
    line.style.background = colour;
    this.box.append(line, element);
    const label = { element, line, place };
    this.labels.add(label);
    return label;
  }

  remove(label) {
    label.element.remove();
    label.line.remove();
    this.labels.delete(label);
  }

  // Draw those that are shown as they are on the page.
  draw(context) {
    const { font } = getComputedStyle(this.box.querySelector("span") ?? this.box);
    Object.assign(context, { font, textBaseline: "middle" });
    for (const { at, size, element, line } of this.labels) {
      if (!at) continue;
      const [x, y, middle, foot] = at;
      const [wide, high] = size;
      context.fillStyle = line.style.background;
      context.fillRect(middle, y + high, 1, Math.max(foot - y - high, 0));
      context.fillStyle = BACK;
      context.fillRect(x, y, wide, high);
      context.fillStyle = element.style.color;
      context.fillText(element.textContent, x + PAD, y + high / 2, wide - 2 * PAD);
    }
  }

  update(camera, width, height) {
    const at = new Vector3();
    const boxes = [];
    for (const label of this.labels) {
      const { element, line } = label;
      label.at = null;
      const found = label.place();
      if (found) at.copy(found).project(camera);
      const seen = found && at.z > -1 && at.z < 1 && Math.abs(at.x) < 1.1 && Math.abs(at.y) < 1.1;
      element.hidden = line.hidden = !seen;
      if (!seen) continue;
      label.size ??= [element.offsetWidth, element.offsetHeight];
      const [wide, high] = label.size;
      const middle = ((at.x + 1) / 2) * width;
      const foot = ((1 - at.y) / 2) * height;
      const x = middle - wide / 2;
      const y = free(boxes, x, foot - (1 + LIFT) * high, wide, high);
      boxes.push([x, y, wide, high]);
      label.at = [x, y, middle, foot];
      element.style.transform = `translate(${x}px, ${y}px)`;
      line.style.transform = `translate(${middle}px, ${Math.min(y + high, foot)}px)`;
      line.style.height = `${Math.max(foot - y - high, 0)}px`;
    }
  }
}

// The lowest place that is not below y and free of boxes; near the top of the picture, the highest one below them.
function free(boxes, x, y, wide, high) {
  const inWay = (at) => boxes.find(([left, top, w, h]) => left < x + wide && x < left + w && top < at + high && at < top + h);
  let up = y;
  for (let box = inWay(up); box; box = inWay(up)) up = box[1] - high - GAP;
  if (up >= 0) return up;
  let down = Math.max(y, 0);
  for (let box = inWay(down); box; box = inWay(down)) down = box[1] + box[3] + GAP;
  return down;
}
