// One frame at a time, several that are accumulated, or all of them.

import { el, number, push, section } from "lidarcfg/panel";

export class TimeSection {
  constructor({ points, timeline }, onFrame, onPlay) {
    Object.assign(this, { timeline, onFrame, onPlay, at: 0, width: 1, whole: Boolean(points), playing: false });
    const { frames, frame, unit_s } = timeline;
    this.slider = el("input", { type: "range", id: "time", min: 0, max: frames.length - 1, step: 1, value: 0, ariaLabel: "Frame" });
    this.slider.addEventListener("input", () => this.go(this.slider.valueAsNumber));
    this.every = el("input", { type: "checkbox", id: "whole", checked: this.whole });
    this.every.addEventListener("change", () => this.all(this.every.checked));
    this.button = push("play", "Play", () => this.play(!this.playing));
    this.joined = el("input", { type: "number", id: "joined", min: 1, max: frames.length, step: 1, value: 1 });
    this.joined.addEventListener("change", () => this.accumulate(this.joined.valueAsNumber));
    this.when = el("div", { className: "dim", id: "when" });
    const whole = timeline.drives ? "whole recording, deskewed" : "whole recording";
    const count = el("span", { className: "count", textContent: `${number(frames.length)} × ${number(frame * unit_s * 1000)} ms` });
    const many = frames.length > 1;
    this.element = section(
      "Time",
      many && points ? el("label", {}, this.every, whole, count) : null,
      many ? el("div", { className: "row" }, this.button, this.slider) : null,
      many && points ? el("label", {}, "scans accumulated", this.joined) : null,
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
    const { length } = this.timeline.frames;
    this.at = (at + length) % length;
    this.slider.value = this.at;
    this.whole = this.every.checked = false;
    this.refresh();
  }

  // So many scans up to the one at the slider.
  accumulate(count) {
    this.width = Math.min(Math.max(Math.round(count) || 1, 1), this.timeline.frames.length);
    this.joined.value = this.width;
    this.go(this.at);
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Stop" : "Play";
    this.button.ariaPressed = on;
    if (on && this.whole) this.go(this.at);
    this.onPlay(on);
  }

  refresh() {
    const { frames, frame, unit_s, end, start } = this.timeline;
    const first = Math.max(this.at - this.width + 1, 0);
    const slice = this.whole ? [0, end] : [frames[first] * frame, (frames[this.at] + 1) * frame - 1];
    const [from, to] = [slice[0], Math.min(slice[1] + 1, end)].map((time) => (time * unit_s).toFixed(3));
    const which = this.whole ? "" : `frame ${this.at + 1} of ${frames.length}: `;
    this.when.textContent = `${which}${from} s to ${to} s after ${start}`;
    this.onFrame(this.at, ...slice);
  }
}
