// What the rig was before each change, for undo and redo.

export class History {
  constructor(state, restore, onChange) {
    Object.assign(this, { state, restore, onChange, past: [], future: [], last: null });
  }

  // Before a change; those of one `step` (a drag, a number that is typed) are undone as one.
  before(step) {
    if (step !== null && step === this.last) return;
    this.last = step;
    this.past.push(this.state());
    this.future = [];
    this.onChange();
  }

  undo() {
    this.go(this.past, this.future);
  }

  redo() {
    this.go(this.future, this.past);
  }

  go(from, to) {
    if (!from.length) return;
    to.push(this.state());
    this.last = null;
    this.restore(from.pop());
    this.onChange();
  }
}
