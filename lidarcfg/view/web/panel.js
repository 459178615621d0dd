// The controls beside the picture: plain HTML inputs, all reachable by keyboard.

import { AXES } from "lidarcfg/sensors";
import { MODES } from "lidarcfg/colours";

const UNITS = { intensity: "%", ring: "", height: "m", time: "s" };
const COORDINATES = [["x", "m"], ["y", "m"], ["z", "m"], ["roll", "°"], ["pitch", "°"], ["yaw", "°"]];
const KEYS = [
  ["Space", "play or stop"],
  ["← →", "previous, next frame"],
  ["1 … 6", "colour"],
  ["M", "measure"],
  ["T, R", "move or rotate the sensor"],
  ["Esc", "deselect; end measuring"],
];

export function el(tag, props = {}, ...children) {
  const { style, ...others } = props;
  const element = Object.assign(document.createElement(tag), others);
  Object.assign(element.style, style);
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

const number = (value, digits = 0) =>
  value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay: "negative" });

export function section(title, ...children) {
  return el("fieldset", {}, el("legend", { textContent: title }), ...children);
}

export function check(id, text, on, onChange, colour, count) {
  const input = el("input", { type: "checkbox", id, checked: on });
  input.addEventListener("change", () => onChange(input.checked));
  const dot = colour && el("span", { className: "dot", style: { background: colour } });
  return el("label", {}, input, dot, text, count === undefined ? null : el("span", { className: "count", textContent: count }));
}

export function slide(id, text, [min, max, step], value, shown, onInput) {
  const input = el("input", { type: "range", id, min, max, step, value });
  const output = el("output", { textContent: shown(value) });
  input.addEventListener("input", () => {
    output.textContent = shown(input.valueAsNumber);
    onInput(input.valueAsNumber);
  });
  return el("label", {}, text, input, output);
}

export function push(id, text, onClick) {
  const button = el("button", { type: "button", id, textContent: text });
  button.addEventListener("click", () => onClick(button));
  return button;
}

// Sensors with their number of points; each can be hidden.
export function sensorSection(about, onShow) {
  const counts = new Map((about.points?.sensors ?? []).map(({ name, count }) => [name, count]));
  const rows = about.sensors.map(({ name, colour }, i) => {
    const count = counts.has(name) ? `${number(counts.get(name))} points` : "";
    return check(`sensor-${i}`, name, true, (on) => onShow(name, on), colour, count);
  });
  return section("Sensors", el("div", { className: "scroll" }, ...rows));
}

// What the points' colours mean, with a legend or a colour bar.
export function colourSection(about, onColour) {
  const { points, colours } = about;
  const choice = el("select", { id: "colour", ariaLabel: "Colour of the points" });
  MODES.filter((mode) => mode !== "object" || points.objects).forEach((mode) => {
    choice.append(el("option", { value: mode, textContent: mode, selected: mode === about.by }));
  });
  const legend = el("div", { id: "legend" });
  const show = () => {
    legend.replaceChildren(...legendOf(choice.value, points, colours));
    onColour(choice.value);
  };
  choice.addEventListener("change", show);
  show();
  const total = el("span", { className: "count", textContent: `${number(points.count)} points` });
  return section("Points", el("label", {}, "Coloured by", choice, total), legend);
}

function legendOf(mode, points, colours) {
  if (mode === "sensor") return [];
  if (mode === "object") {
    const rows = points.objects
      .filter(({ count }) => count)
      .sort((a, b) => b.count - a.count)
      .map(({ name, colour, count }) => entry(colour, name, `${number(count)} points`));
    return [el("div", { className: "scroll" }, ...rows)];
  }
  const [low, high] = points.spans[mode];
  const digits = Math.min(Math.max(1 - Math.floor(Math.log10(high - low)), 0), 9);
  const ticks = [0, 0.25, 0.5, 0.75, 1].map((fraction) => {
    const value = low + fraction * (high - low);
    const text = number(value, mode === "ring" ? 0 : digits);
    return el("span", { textContent: `${text} ${UNITS[mode]}` });
  });
  const bar = el("div", { className: "bar", style: { background: `linear-gradient(to right, ${colours.scale.join()})` } });
  const parts = [bar, el("div", { className: "ticks" }, ...ticks)];
  if (mode === "intensity") parts.push(entry(colours.retro, "retro-reflectors, 101 to 255", ""));
  if (mode === "height") parts.push(el("div", { className: "dim", textContent: "z; 1 % of the points lie beyond each end" }));
  return parts;
}

const entry = (colour, text, count) =>
  el("div", { className: "row" }, el("span", { className: "dot", style: { background: colour } }), text, el("span", { className: "count", textContent: count }));

// One frame at a time, or all of them.
export class TimeSection {
  constructor(points, onSlice, onPlay) {
    Object.assign(this, { points, onSlice, onPlay, at: 0, width: 1, whole: true, playing: false });
    const { frames, frame, unit_s } = points;
    this.slider = el("input", { type: "range", id: "time", min: 0, max: frames.length - 1, step: 1, value: 0, ariaLabel: "Frame" });
    this.slider.addEventListener("input", () => this.go(this.slider.valueAsNumber));
    this.every = el("input", { type: "checkbox", id: "whole", checked: true });
    this.every.addEventListener("change", () => this.all(this.every.checked));
    this.button = push("play", "Play", () => this.play(!this.playing));
    this.joined = el("input", { type: "number", id: "joined", min: 1, max: frames.length, step: 1, value: 1 });
    this.joined.addEventListener("change", () => {
      this.width = Math.min(Math.max(Math.round(this.joined.valueAsNumber) || 1, 1), frames.length);
      this.joined.value = this.width;
      this.go(this.at);
    });
    this.when = el("div", { className: "dim", id: "when" });
    this.element = section(
      "Time",
      el("label", {}, this.every, "all at once", el("span", { className: "count", textContent: `${number(frames.length)} frames of ${number(frame * unit_s * 1000)} ms` })),
      el("div", { className: "row" }, this.button, this.slider),
      el("label", {}, "frames at once", this.joined),
      this.when,
    );
    this.refresh();
  }

  all(on) {
    this.whole = this.every.checked = on;
    if (on) this.play(false);
    this.refresh();
  }

  go(at) {
    this.at = (at + this.points.frames.length) % this.points.frames.length;
    this.slider.value = this.at;
    this.whole = this.every.checked = false;
    this.refresh();
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Stop" : "Play";
    this.button.ariaPressed = on;
    if (on && this.whole) this.go(this.at);
    this.onPlay(on);
  }

  refresh() {
    const { frames, frame, unit_s, end, start } = this.points;
    const last = Math.min(this.at + this.width, frames.length) - 1;
    const slice = this.whole ? [0, end] : [frames[this.at] * frame, (frames[last] + 1) * frame - 1];
    const [from, to] = [slice[0], Math.min(slice[1] + 1, end)].map((time) => (time * unit_s).toFixed(3));
    const which = this.whole ? "" : `frame ${this.at + 1} of ${frames.length}: `;
    this.when.textContent = `${which}${from} s to ${to} s after ${start}`;
    this.onSlice(...slice);
  }
}

// Max VSR, what no sensor sees, and the worst subspaces in a table.
export class EvaluationSection {
  constructor(about, onCount) {
    this.vsr = el("div", { className: "big", id: "vsr" });
    this.rest = el("div", { className: "dim", id: "subspaces" });
    this.other = el("div", { id: "other-vsr" });
    this.blind = el("div", { id: "blind-volume" });
    this.violations = el("div", { className: "bad", id: "violations" });
    this.rows = el("tbody");
    const head = el("tr", {}, ...["worst", "VSR (m)", "volume (m³)"].map((text) => el("th", { textContent: text, scope: "col" })));
    const most = about.evaluation.worst.length;
    this.element = section(
      `Study ${about.study.name}`,
      this.vsr,
      this.other,
      this.rest,
      this.blind,
      this.violations,
      slide("worst", "worst shown", [0, most, 1], Math.min(about.worst, most), String, onCount),
      el("table", {}, el("thead", {}, head), this.rows),
    );
  }

  set({ max_vsr_m, other_max_vsr_m, transparent, subspaces, blind, worst, violations }, count) {
    this.vsr.textContent = `max VSR ${max_vsr_m.toFixed(6)} m`;
    this.vsr.dataset.value = max_vsr_m;
    this.rest.textContent = `${number(subspaces)} subspaces`;
    const more = other_max_vsr_m && `${number(100 * (other_max_vsr_m / max_vsr_m - 1), 1)} %`;
    const which = transparent ? "with the bodies that hide" : "if nothing hid anything";
    this.other.textContent = more ? `${other_max_vsr_m.toFixed(6)} m ${which} (${more})` : "";
    this.blind.textContent = blind ? `${number(blind.volume_m3, 2)} m³ seen by no sensor (${number(100 * blind.fraction, 2)} %)` : "";
    this.violations.replaceChildren(...violations.map((text) => el("div", { textContent: text })));
    this.rows.replaceChildren(
      ...worst.slice(0, count).map(({ vsr_m, volume_m3 }, i) =>
        el("tr", {}, ...[i + 1, vsr_m.toFixed(4), volume_m3.toFixed(2)].map((text) => el("td", { textContent: text })))),
    );
  }
}

// The rig's sensors: which one has the handles, and its pose in numbers.
export class RigSection {
  constructor(handles, { onSave, onReset }) {
    this.handles = handles;
    this.choice = el("select", { id: "mount", ariaLabel: "Sensor to move" }, el("option", { value: "", textContent: "no sensor" }));
    handles.mounts.forEach((mount, i) => this.choice.append(el("option", { value: i, textContent: mount.name })));
    this.choice.addEventListener("change", () => this.select(handles.mounts[this.choice.value] ?? null));
    this.modes = ["translate", "rotate"].map((mode) => push(mode, mode === "rotate" ? "Rotate" : "Move", () => this.mode(mode)));
    this.inputs = COORDINATES.map(([name], i) => {
      const input = el("input", { type: "number", id: `pose-${name}`, step: i < 3 ? 0.01 : 0.5 });
      input.addEventListener("input", () => this.typed(i));
      return input;
    });
    const labels = COORDINATES.map(([name, unit], i) => el("label", {}, `${name} (${unit})`, this.inputs[i]));
    this.pose = el("div", { className: "pose" }, ...labels);
    this.stale = el("div", { className: "dim", hidden: true, textContent: "The points are those of the rig before it was moved." });
    this.element = section(
      "Move a sensor",
      el("div", { className: "row" }, this.choice, ...this.modes),
      this.pose,
      this.stale,
      el("div", { className: "row" }, push("save", "Save rig.yaml", onSave), push("reset", "Reset", onReset)),
    );
    this.mode("translate");
    this.select(null);
  }

  select(mount) {
    this.handles.select(mount);
    this.choice.value = mount ? this.handles.mounts.indexOf(mount) : "";
    this.pose.hidden = !mount;
    this.show();
  }

  mode(mode) {
    this.handles.mode(mode);
    this.modes.forEach((button) => {
      button.ariaPressed = button.id === mode;
    });
  }

  show() {
    const mount = this.handles.selected;
    mount?.pose.forEach((value, i) => {
      if (document.activeElement !== this.inputs[i]) this.inputs[i].value = Number((i < 3 ? value : (value * 180) / Math.PI).toFixed(i < 3 ? 4 : 3));
    });
  }

  typed(i) {
    const value = this.inputs[i].valueAsNumber;
    const mount = this.handles.selected;
    if (!mount || !Number.isFinite(value)) return;
    this.handles.setPose(mount, mount.pose.map((before, j) => (j !== i ? before : i < 3 ? value : (value * Math.PI) / 180)));
  }
}

export function help() {
  const keys = KEYS.flatMap(([key, what]) => [el("div", {}, el("kbd", { textContent: key }), ` ${what}`)]);
  const axes = AXES.flatMap(([name, code]) => [el("span", { style: { color: code }, textContent: ` ${name}` })]);
  return el(
    "details",
    { style: { marginTop: "12px" } },
    el("summary", { textContent: "Keys and axes" }),
    ...keys,
    el("div", {}, "Drag to orbit, wheel to zoom, right button to pan."),
    el("div", {}, "Axes:", ...axes, ": forward, left, up (REP-103, metres)"),
  );
}
