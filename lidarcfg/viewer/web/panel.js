// The controls beside the picture: plain HTML inputs, all reachable by keyboard.

import { MODES } from "lidarcfg/colours";

const UNITS = { intensity: "%", ring: "", height: "m", time: "s" };
export function el(tag, props = {}, ...children) {
  const { style, ...others } = props;
  const element = Object.assign(document.createElement(tag), others);
  Object.assign(element.style, style);
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export const number = (value, digits = 0) =>
  value.toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits, signDisplay: "negative" });

const counted = (points) => `${number(points)} ${points === 1 ? "point" : "points"}`;

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

export function download(blob, name) {
  const link = el("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  URL.revokeObjectURL(link.href);
}

// Sensors with their number of points; each can be hidden.
export function sensorSection(about, onShow) {
  const counts = new Map((about.points?.sensors ?? []).map(({ name, count }) => [name, count]));
  if (!about.sensors.length) return null;
  const rows = about.sensors.map(({ name, colour }, i) => {
    const count = counts.has(name) ? counted(counts.get(name)) : "";
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
  const total = el("span", { className: "count", textContent: counted(points.count) });
  return section("Points", el("label", {}, "colour", choice, total), legend);
}

function legendOf(mode, points, colours) {
  if (mode === "sensor") return [];
  if (mode === "object") {
    const rows = points.objects
      .filter(({ count }) => count)
      .sort((a, b) => b.count - a.count)
      .map(({ name, colour, count }) => entry(colour, name, counted(count)));
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

// PASS or FAIL of the rig and of each requirement, with its margin; the rest is told under the pointer.
export class VerdictSection {
  constructor(names) {
    this.text = el("div", { className: "big", id: "verdict" });
    this.rows = el("tbody", { id: "requirements" });
    this.error = el("div", { className: "bad", id: "verdict-error" });
    this.element = section("Requirements", this.text, this.error, el("table", {}, headed("requirement", "margin", ""), this.rows));
    this.rows.replaceChildren(...names.map((name) => row(name, "", "…")));
  }

  set({ pass, text, requirements }) {
    this.rows.className = "";
    this.error.textContent = "";
    this.text.textContent = pass ? "PASS" : "FAIL";
    this.text.className = pass ? "big good" : "big bad";
    this.text.title = text;
    this.rows.replaceChildren(
      ...requirements.map((one) => {
        const line = row(one.name, one.margin, one.pass ? "PASS" : "FAIL");
        line.title = one.detail;
        line.lastChild.className = one.pass ? "good" : "bad";
        return line;
      }),
    );
  }

  // Until that on the latest pose comes.
  stale() {
    this.rows.className = "stale";
    this.text.classList.add("stale");
  }

  fail({ message }) {
    this.error.textContent = message;
  }
}

// How often the rig misses each object, and what the colours on the ground mean.
export class MissesSection {
  constructor(about) {
    this.text = el("div", { className: "big", id: "misses" });
    this.rest = el("div", { className: "dim" });
    this.rows = el("tbody", { id: "missed-objects" });
    this.error = el("div", { className: "bad" });
    const bar = el("div", { className: "bar", style: { background: `linear-gradient(to right, ${about.colours.missed.join()})` } });
    const shares = ["0", "6", "25", "56", "100 %"]; // at even steps of their square root
    const ticks = el("div", { className: "ticks" }, ...shares.map((textContent) => el("span", { textContent })));
    this.element = section("What is missed", this.text, el("table", {}, headed("object", "missed"), this.rows), bar, ticks, this.rest, this.error);
  }

  set({ share, returns, objects, places, places_of_reports }) {
    this.error.textContent = "";
    this.text.textContent = `misses ${number(100 * share, 2)} %`;
    this.text.dataset.value = share;
    this.rows.replaceChildren(...objects.map((one) => row(one.name, `${number(100 * one.share, 2)} %`)));
    this.rest.textContent = `of places, with fewer than ${returns} returns; from ${number(places)} places of each object, where reports count at ${number(places_of_reports)}. Squares on the ground: the share of objects missed there; none: nothing is.`;
  }

  fail({ message }) {
    this.error.textContent = message;
  }
}

// Max VSR, what no sensor sees, how often objects are detected, and the worst subspaces in a table.
export class EvaluationSection {
  constructor(about, onCount) {
    this.vsr = el("div", { className: "big", id: "vsr" });
    this.rest = el("div", { className: "dim", id: "subspaces" });
    this.other = el("div", { id: "other-vsr" });
    this.blind = el("div", { id: "blind-volume" });
    this.zones = el("div", { id: "zone-vsr" });
    this.violations = el("div", { className: "bad", id: "violations" });
    this.rows = el("tbody");
    this.rates = el("tbody", { id: "rates" });
    const most = about.evaluation.worst.length;
    this.element = section(
      `Study ${about.study.name}`,
      this.vsr,
      this.other,
      this.rest,
      this.blind,
      this.zones,
      this.violations,
      about.study.detects ? el("table", {}, headed("object", "detected"), this.rates) : null,
      slide("worst", "worst shown", [0, most, 1], Math.min(about.worst, most), String, onCount),
      el("table", {}, headed("worst", "VSR (m)", "volume (m³)"), this.rows),
    );
  }

  set({ max_vsr_m, other_max_vsr_m, transparent, subspaces, blind, zones, worst, violations, rates }, count) {
    this.vsr.textContent = `max VSR ${max_vsr_m.toFixed(6)} m`;
    this.vsr.dataset.value = max_vsr_m;
    this.rest.textContent = `${number(subspaces)} subspaces`;
    const more = other_max_vsr_m && `${number(100 * (other_max_vsr_m / max_vsr_m - 1), 1)} %`;
    const which = transparent ? "with the bodies that hide" : "if nothing hid anything";
    this.other.textContent = more ? `${other_max_vsr_m.toFixed(6)} m ${which} (${more})` : "";
    this.blind.textContent = blind ? `${number(blind.volume_m3, 2)} m³ seen by no sensor (${number(100 * blind.fraction, 2)} %)` : "";
    this.zones.replaceChildren(...zones.map(({ name, max_vsr_m: most }) => el("div", { textContent: `${name}: max VSR ${most.toFixed(4)} m` })));
    if (rates) this.setRates(rates);
    this.violations.replaceChildren(...violations.map((text) => el("div", { textContent: text })));
    this.rows.replaceChildren(
      ...worst.slice(0, count).map(({ vsr_m, volume_m3 }, i) => row(i + 1, vsr_m.toFixed(4), volume_m3.toFixed(2))),
    );
  }

  // Until those of the latest pose come.
  staleRates() {
    this.rates.className = "stale";
  }

  setRates(rates) {
    this.rates.className = "";
    const interval = (half_width) => (half_width ? ` ± ${number(100 * half_width, 2)}` : "");
    this.rates.replaceChildren(...rates.map(({ name, rate, half_width }) => row(name, `${number(100 * rate, 2)}${interval(half_width)} %`)));
  }
}

const row = (...texts) => el("tr", {}, ...texts.map((text) => el("td", { textContent: text })));
const headed = (...texts) => el("thead", {}, el("tr", {}, ...texts.map((text) => el("th", { textContent: text, scope: "col" }))));
