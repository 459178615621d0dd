// Texts at places in the scene.

import { Vector3 } from "three";

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
    this.box.append(element);
    const label = { element, place };
    this.labels.add(label);
    return label;
  }

  remove(label) {
    label.element.remove();
    this.labels.delete(label);
  }

  update(camera, width, height) {
    const at = new Vector3();
    for (const { element, place } of this.labels) {
      const found = place();
      if (found) at.copy(found).project(camera);
      const seen = found && at.z > -1 && at.z < 1 && Math.abs(at.x) < 1.1 && Math.abs(at.y) < 1.1;
      element.hidden = !seen;
      if (!seen) continue;
      const x = ((at.x + 1) / 2) * width;
      const y = ((1 - at.y) / 2) * height;
      element.style.transform = `translate(${x}px, ${y}px) translate(-50%, -190%)`;
    }
  }
}
