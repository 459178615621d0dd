// The rig's sensors: which one has the handles, its pose in numbers, undo and redo, and where the rig is saved.

import { ask } from "lidarcfg/data";
import { download, el, push, section } from "lidarcfg/panel";

const COORDINATES = [["x", "m"], ["y", "m"], ["z", "m"], ["roll", "°"], ["pitch", "°"], ["yaw", "°"]];

export class RigSection {
  constructor(handles, about, say) {
    Object.assign(this, { handles, about, say });
    this.choice = el("select", { id: "mount", ariaLabel: "Sensor to move" }, el("option", { value: "", textContent: "no sensor" }));
    handles.mounts.forEach((mount, i) => this.choice.append(el("option", { value: i, textContent: mount.name })));
    this.choice.addEventListener("change", () => this.select(handles.mounts[this.choice.value] ?? null));
    this.modes = ["translate", "rotate"].map((mode) => push(mode, mode === "rotate" ? "Rotate" : "Move", () => this.mode(mode)));
    this.inputs = COORDINATES.map(([name], i) => {
      const input = el("input", { type: "number", id: `pose-${name}`, step: i < 3 ? 0.01 : 0.5 });
      input.addEventListener("input", () => this.typed(i));
      input.addEventListener("change", () => this.show(null)); // a number that could not be taken, for example
      return input;
    });
    const labels = COORDINATES.map(([name, unit], i) => el("label", {}, `${name} (${unit})`, this.inputs[i]));
    this.pose = el("div", { className: "pose" }, ...labels);
    this.stale = el("div", { className: "dim", hidden: true, textContent: "The points are those of the rig before it was moved." });
    this.steps = [push("undo", "Undo", () => this.undo()), push("redo", "Redo", () => this.redo())];
    this.element = section(
      "Move a sensor",
      el("div", { className: "row" }, this.choice, ...this.modes),
      this.pose,
      this.partners(),
      this.stale,
      el("div", { className: "row" }, ...this.steps, push("reset", "Reset", () => handles.reset())),
      el("div", { className: "row" }, about.file ? push("save", "Save …", () => this.save()) : null, push("download", "Download rig.yaml", () => downloadRig(handles.poses))),
    );
    this.mode("translate");
    this.select(null);
    this.count();
  }

  // Whether the other sensor of a mirrored pair follows.
  partners() {
    if (!this.handles.pairs.length) return null;
    const input = el("input", { type: "checkbox", id: "mirror", checked: true });
    input.addEventListener("change", () => {
      this.handles.mirrors = input.checked;
    });
    return el("label", {}, input, "the mirrored partner follows");
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

  // The pose in numbers; not in the one that is being typed, unless it is undone.
  show(typing = document.activeElement) {
    const mount = this.handles.selected;
    mount?.pose.forEach((value, i) => {
      if (typing !== this.inputs[i]) this.inputs[i].value = Number((i < 3 ? value : (value * 180) / Math.PI).toFixed(i < 3 ? 4 : 3));
    });
  }

  typed(i) {
    const value = this.inputs[i].valueAsNumber;
    const mount = this.handles.selected;
    if (!mount || !Number.isFinite(value)) return;
    const pose = this.handles.wish(mount).map((before, j) => (j !== i ? before : i < 3 ? value : (value * Math.PI) / 180));
    this.handles.move(mount, pose, `${mount.name} ${i}`);
  }

  undo() {
    this.handles.history.undo();
    this.show(null);
  }

  redo() {
    this.handles.history.redo();
    this.show(null);
  }

  // How many steps there are to take back, and to take again.
  count() {
    const { past, future } = this.handles.history;
    [past, future].forEach((states, i) => {
      this.steps[i].disabled = !states.length;
    });
  }

  async save() {
    if (!(await agreed(question(this.about), "Save"))) return;
    try {
      const { file } = await (await ask("save", { poses: this.handles.poses }, this.about.token)).json();
      this.say(`saved ${file}`);
    } catch (error) {
      this.say(error.message);
    }
  }
}

function question({ file, points }) {
  const kept = "Of this file the numbers of position_m and of rpy_deg or rpy_rad change, of the sensors that were moved. Its comments and all else stay.";
  const record = points ? " A capture that this rig recorded knows the file by its checksum, and asks for --rig from then on." : "";
  return [`Save the moved rig as ${file}?`, `${kept}${record}`];
}

// Asks, and waits for an answer.
function agreed([title, text], yes) {
  return new Promise((resolve) => {
    const dialog = el("dialog", { id: "ask" }, el("h1", { textContent: title }), el("p", { textContent: text }));
    const answer = (agreed) => {
      dialog.remove();
      resolve(agreed);
    };
    const cancel = push("ask-no", "Cancel", () => answer(false));
    cancel.autofocus = true;
    dialog.append(el("div", { className: "row" }, push("ask-yes", yes, () => answer(true)), cancel));
    dialog.addEventListener("cancel", () => answer(false)); // the Esc key
    document.body.append(dialog);
    dialog.showModal();
  });
}

async function downloadRig(poses) {
  download(await (await ask("rig.yaml", { poses })).blob(), "rig.yaml");
}
