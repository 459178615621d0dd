// Moving a rig's sensors. The server evaluates the moved rig, one request at a time.

import { TransformControls } from "three";
import { ask } from "lidarcfg/data";
import { AXES } from "lidarcfg/sensors";

export class Handles {
  constructor(stage, mounts, onMove) {
    Object.assign(this, { stage, mounts, onMove, selected: null });
    this.start = mounts.map((mount) => mount.pose);
    this.controls = new TransformControls(stage.camera, stage.canvas);
    this.controls.size = 0.8;
    this.controls.setColors(...AXES.map(([, colour]) => colour), "white");
    stage.scene.add(this.controls.getHelper());
    this.controls.addEventListener("change", () => stage.redraw());
    this.controls.addEventListener("dragging-changed", ({ value }) => {
      stage.orbit.enabled = !value;
    });
    this.controls.addEventListener("objectChange", () => {
      this.selected.takeMove(this.controls.mode === "rotate");
      this.changed();
    });
  }

  select(mount) {
    this.selected = mount;
    if (mount) this.controls.attach(mount.object);
    else this.controls.detach();
    this.stage.redraw();
  }

  mode(mode) {
    this.controls.setMode(mode);
    this.controls.setSpace(mode === "rotate" ? "local" : "world");
  }

  setPose(mount, pose) {
    mount.pose = pose;
    this.changed();
  }

  reset() {
    this.mounts.forEach((mount, i) => {
      mount.pose = this.start[i];
    });
    this.changed();
  }

  changed() {
    this.stage.moved();
    this.onMove();
  }

  get poses() {
    return this.mounts.map((mount) => mount.pose);
  }
}

// Asks for an evaluation of the rig; while it waits for an answer, only the latest request is kept.
export class Evaluator {
  constructor(question, onAnswer, onError) {
    Object.assign(this, { question, onAnswer, onError, busy: false, again: false, answered: 0, tookMs: 0 });
  }

  async ask() {
    this.again = true;
    if (this.busy) return;
    this.busy = true;
    while (this.again) {
      this.again = false;
      const began = performance.now();
      try {
        const answer = await (await ask("evaluate", this.question())).json();
        this.tookMs = performance.now() - began;
        this.onAnswer(answer);
        this.answered += 1;
      } catch (error) {
        this.onError(error);
      }
    }
    this.busy = false;
  }
}

export async function saveRig(poses) {
  const file = await (await ask("rig.yaml", { poses })).blob();
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = "rig.yaml";
  link.click();
  URL.revokeObjectURL(link.href);
}
