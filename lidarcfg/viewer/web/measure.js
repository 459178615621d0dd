// A click says what is under the pointer; while measuring, two clicks give a distance.

import { BufferAttribute, BufferGeometry, Line, LineBasicMaterial, Raycaster, Vector2, Vector3 } from "three";
import { placed } from "lidarcfg/tracks";

const CLICK_PX = 4; // further is a drag

export class Measure {
  constructor(stage, targets, onText, onMount) {
    Object.assign(this, { stage, targets, onText, onMount, on: false, ends: [], label: null });
    this.line = new Line(new BufferGeometry(), new LineBasicMaterial({ color: "white", depthTest: false }));
    this.line.renderOrder = 10;
    this.line.frustumCulled = false;
    this.line.visible = false;
    stage.scene.add(this.line);
    let down = null;
    stage.canvas.addEventListener("pointerdown", (event) => {
      down = [event.clientX, event.clientY];
    });
    stage.canvas.addEventListener("pointerup", (event) => {
      const clicked = down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < CLICK_PX;
      down = null;
      if (clicked && event.button === 0) this.click(event.offsetX, event.offsetY);
    });
  }

  clear() {
    this.ends = [];
    this.line.visible = false;
    if (this.label) this.stage.labels.remove(this.label);
    this.label = null;
    this.stage.redraw();
  }

  // A sensor, the nearest point, or the surface of a body.
  under(x, y) {
    const { camera, size, points } = this.stage;
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2((2 * x) / size.x - 1, 1 - (2 * y) / size.y), camera);
    const { mounts, bodies } = this.targets();
    const [marker] = ray.intersectObjects(mounts.map((mount) => mount.marker), false);
    if (marker) {
      const mount = mounts.find((one) => one.marker === marker.object);
      return { at: placed(mount.object), text: `${mount.name}, ${mount.about.model}`, mount };
    }
    const index = points?.object.visible ? points.pick(x, y) : null;
    if (index !== null) return { at: points.place(index), text: points.describe(index) };
    const [hit] = ray.intersectObjects(bodies, true).filter(({ object }) => object.isMesh);
    if (!hit) return null;
    const [px, py, pz] = hit.point.toArray().map((value) => value.toFixed(3));
    return { at: hit.point, text: `x ${px} m, y ${py} m, z ${pz} m, on a body` };
  }

  click(x, y) {
    const found = this.under(x, y);
    if (!this.on) {
      if (found?.mount) this.onMount(found.mount);
      this.onText(found?.text ?? "");
      return;
    }
    if (!found) return;
    if (this.ends.length === 2) this.clear();
    this.ends.push(found.at);
    this.onText(this.ends.length === 1 ? `from ${found.text}; click the second point` : this.show());
  }

  show() {
    const [a, b] = this.ends;
    const [dx, dy, dz] = b.clone().sub(a).toArray();
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array([0, 0, 0, dx, dy, dz]), 3));
    this.line.geometry.dispose();
    this.line.geometry = geometry;
    this.line.position.copy(a);
    this.line.visible = true;
    const halfway = new Vector3().addVectors(a, b).multiplyScalar(0.5);
    this.distance_m = Math.hypot(dx, dy, dz);
    this.label = this.stage.labels.add(`${this.distance_m.toFixed(3)} m`, "white", () => halfway);
    this.stage.redraw();
    const parts = [["dx", dx], ["dy", dy], ["dz", dz], ["level", Math.hypot(dx, dy)]];
    return `${this.distance_m.toFixed(3)} m: ${parts.map(([name, value]) => `${name} ${value.toFixed(3)} m`).join(", ")}`;
  }
}
