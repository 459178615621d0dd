// Moving a rig's sensors. The server evaluates the moved rig, one request at a time.

import { TransformControls } from "three";
import { ask } from "lidarcfg/data";
import { History } from "lidarcfg/history";
import { AXES } from "lidarcfg/sensors";

const PAUSE_MS = 150; // in a move, after which what takes long is asked for

export class Handles {
  constructor(stage, mounts, { mirrored: pairs, on_surface: onSurface }, onMove, onHistory, onError) {
    Object.assign(this, { stage, mounts, pairs, onSurface, onMove, selected: null, mirrors: true, drags: 0, wanted: null, pending: null });
    this.slider = new Evaluator("place", () => this.asked(), ({ poses }) => this.sit(poses), onError);
    this.start = mounts.map((mount) => mount.pose);
    this.history = new History(() => this.poses, (poses) => this.restore(poses), onHistory);
    this.controls = new TransformControls(stage.camera, stage.canvas);
    this.controls.size = 0.8;
    this.controls.setColors(...AXES.map(([, colour]) => colour), "white");
    stage.scene.add(this.controls.getHelper());
    this.controls.addEventListener("change", () => stage.redraw());
    this.controls.addEventListener("dragging-changed", ({ value }) => {
      stage.orbit.enabled = !value;
      this.drags += 1;
    });
    this.controls.addEventListener("objectChange", () => {
      this.move(this.selected, this.selected.moved(this.controls.mode === "rotate"), `drag ${this.drags}`);
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

  // `step` names what is undone as one. The server says where a sensor goes that sits on a surface.
  move(mount, pose, step) {
    const index = this.mounts.indexOf(mount);
    if (this.onSurface.includes(index)) {
      this.wanted = { index, pose, step };
      this.slider.ask();
      return;
    }
    this.history.before(step);
    mount.pose = pose;
    this.changed(mount);
  }

  // Where a sensor is, or is to go as soon as the server says how far.
  wish(mount) {
    const waiting = this.slider.busy && this.mounts[this.wanted?.index] === mount;
    return waiting ? this.wanted.pose : mount.pose;
  }

  asked() {
    const { index, pose, step } = this.wanted;
    this.pending = { poses: this.poses, step };
    return { poses: this.poses, mount: index, pose, mirrors: this.mirrors };
  }

  // The sensors that the server has moved; not if the rig was restored meanwhile.
  sit(poses) {
    if (!this.pending) return;
    const moved = poses.map((pose, i) => pose.some((value, j) => value !== this.pending.poses[i][j]));
    if (moved.includes(true)) this.history.before(this.pending.step);
    this.place(poses.map((pose, i) => (moved[i] ? pose : this.mounts[i].pose)));
  }

  reset() {
    this.history.before(null);
    this.restore(this.start);
  }

  restore(poses) {
    this.wanted = null;
    this.pending = null;
    this.slider.drop();
    this.place(poses);
  }

  place(poses) {
    this.mounts.forEach((mount, i) => {
      mount.pose = poses[i];
    });
    this.changed(null);
  }

  // The other sensor of a mirrored pair goes where the moved one's image is.
  changed(mount) {
    if (this.mirrors && mount) {
      const index = this.mounts.indexOf(mount);
      for (const [one, other, plane] of this.pairs) {
        if (index === one || index === other) this.mounts[index === one ? other : one].pose = mirrored(mount.pose, plane);
      }
    }
    this.stage.moved();
    this.onMove();
  }

  get poses() {
    return this.mounts.map((mount) => mount.pose);
  }
}

function mirrored([x, y, z, roll, pitch, yaw], plane) {
  return [x, 2 * plane - y, z, -roll, pitch, -yaw];
}

// Asks the server about the rig; while it waits for an answer, only the latest request is kept.
export class Evaluator {
  constructor(path, question, onAnswer, onError) {
    Object.assign(this, { path, question, onAnswer, onError, busy: false, again: false, timer: null, answered: 0, tookMs: 0 });
  }

  // Ask as soon as there was no other wish to ask for a while.
  askSoon() {
    this.forget();
    this.timer = setTimeout(() => {
      this.timer = null;
      this.ask();
    }, PAUSE_MS);
  }

  // Do not ask what was to be asked soon: there is something newer.
  forget() {
    clearTimeout(this.timer);
    this.timer = null;
  }

  // Forget what has not been asked yet.
  drop() {
    this.again = false;
  }

  async ask() {
    this.again = true;
    if (this.busy) return;
    this.busy = true;
    while (this.again) {
      this.again = false;
      const began = performance.now();
      try {
        const answer = await (await ask(this.path, this.question())).json();
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
