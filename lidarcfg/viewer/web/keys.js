// The keys: one list for what they do and for the panel that names them.

import { MODES } from "lidarcfg/colours";
import { el, push } from "lidarcfg/panel";
import { AXES } from "lidarcfg/sensors";

const MOUSE = [["drag", "orbit"], ["right drag", "pan"], ["wheel", "zoom"], ["click", "what is there; select a sensor"]];

function clicked(id) {
  document.getElementById(id)?.click();
}

function colour(view, key) {
  const choice = document.getElementById("colour");
  const mode = MODES[key - 1];
  if (![...(choice?.options ?? [])].some(({ value }) => value === mode)) return;
  choice.value = mode;
  choice.dispatchEvent(new Event("change"));
}

function shortcuts(view) {
  const { time, stage, rig } = view;
  const escape = () => {
    view.measuring(false);
    rig?.select(null);
    view.help.dialog.close();
  };
  return [
    [" ", "Space", "play or stop", () => time?.play(!time.playing)],
    ["ArrowLeft", "←", "previous frame", () => time?.go(time.at - 1)],
    ["ArrowRight", "→", "next frame", () => time?.go(time.at + 1)],
    ["w", "W", "whole recording, or one frame", () => time?.all(!time.whole)],
    ["+", "+", "accumulate one scan more", () => time?.accumulate(time.width + 1)],
    ["-", "−", "accumulate one scan less", () => time?.accumulate(time.width - 1)],
    ["123456", "1 … 6", `colour by ${MODES.join(", ")}`, (key) => colour(view, key)],
    ["f", "F", "zoom to fit all that is shown", () => stage.fitShown()],
    ["v", "V", "follow the vehicle", () => clicked("follow")],
    ["g", "G", "grid", () => clicked("grid")],
    ["c", "C", "range rings", () => clicked("rings")],
    ["m", "M", "measure", () => view.measuring(!view.measure.on)],
    ["p", "P", "save a picture", () => clicked("save-picture")],
    ["t", "T", "move the sensor", () => rig?.mode("translate")],
    ["r", "R", "rotate the sensor", () => rig?.mode("rotate")],
    ["ctrl+z", "Ctrl Z", "undo a change of the rig", () => rig?.undo()],
    ["ctrl+y", "Ctrl Y", "redo it; also Ctrl Shift Z", () => rig?.redo()],
    ["Escape", "Esc", "deselect; end measuring", escape],
    ["?", "?", "this list", () => view.help.toggle()],
  ];
}

function named(event) {
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (!event.ctrlKey && !event.metaKey) return key;
  return event.shiftKey && key === "z" ? "ctrl+y" : `ctrl+${key}`;
}

// Whether the element reads keys itself; undo and redo are of the rig even there.
function reads(target, key) {
  const own = /^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName) || (/^(BUTTON|SUMMARY)$/.test(target.tagName) && (key === " " || key === "Enter"));
  return own && !(key.startsWith("ctrl+") && target.closest(".pose"));
}

export function listenToKeys(view) {
  const list = shortcuts(view);
  view.help = new Help(list);
  window.addEventListener("keydown", (event) => {
    const key = named(event);
    if (event.altKey || reads(event.target, key) || document.getElementById("ask")) return;
    const found = list.find(([keys]) => keys === key || (keys.length > 1 && /^\d+$/.test(keys) && key.length === 1 && keys.includes(key)));
    if (!found) return;
    found[3](key);
    event.preventDefault();
    view.stage.redraw();
  });
}

// The panel that lists them.
class Help {
  constructor(list) {
    const row = ([keys, what]) => el("tr", {}, el("td", {}, el("kbd", { textContent: keys })), el("td", { textContent: what }));
    const rows = [...list.map(([, shown, what]) => [shown, what]), ...MOUSE].map(row);
    const axes = AXES.map(([name, code]) => el("span", { style: { color: code }, textContent: `${name} ` }));
    this.dialog = el(
      "dialog",
      { id: "help", ariaLabel: "Keys" },
      el("table", {}, el("tbody", {}, ...rows)),
      el("p", { className: "dim" }, "Axes: ", ...axes, "are forward, left, up (REP-103, metres)."),
      push("help-close", "Close", () => this.toggle()),
    );
    document.body.append(this.dialog);
  }

  toggle() {
    if (this.dialog.open) this.dialog.close();
    else this.dialog.show();
  }
}
