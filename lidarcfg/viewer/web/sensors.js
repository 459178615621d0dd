// Sensors on the vehicle: marker, axes, beam cones.

import {
  BufferAttribute,
  BufferGeometry,
  CylinderGeometry,
  Euler,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshLambertMaterial,
  Quaternion,
} from "three";
import { rgb } from "lidarcfg/colours";
import { placed } from "lidarcfg/tracks";

export const AXES = [["x", "#FF7F50"], ["y", "#2ED9A3"], ["z", "#56B4E9"]];
const STEP_DEG = 3.75;
const SPOKES = 16; // steps from one line along a cone to the next

function lines(ends, material) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
  return new LineSegments(geometry, material);
}

export function axes(length) {
  const made = lines(
    [0, 1, 2].flatMap((axis) => [0, 0, 0, ...[0, 1, 2].map((i) => (i === axis ? length : 0))]),
    new LineBasicMaterial({ vertexColors: true }),
  );
  const shades = AXES.flatMap(([, code]) => [...rgb(code), ...rgb(code)]);
  made.geometry.setAttribute("color", new BufferAttribute(new Uint8Array(shades), 3, true));
  return made;
}

// The maker's azimuth turns clockwise seen from above: x = cos ω cos α, y = -cos ω sin α, z = sin ω.
function cones(mount, color) {
  const [from, to] = mount.azimuth_fov_deg ?? [0, 360];
  const wide = to > from ? to - from : to - from + 360;
  const steps = Math.max(Math.round(wide / STEP_DEG), 1);
  const ends = [];
  for (const elevation of mount.elevation_deg) {
    const w = (elevation * Math.PI) / 180;
    const at = (step) => {
      const a = ((from + (step * wide) / steps) * Math.PI) / 180;
      return [Math.cos(w) * Math.cos(a), -Math.cos(w) * Math.sin(a), Math.sin(w)];
    };
    for (let step = 0; step < steps; step += 1) ends.push(...at(step), ...at(step + 1));
    for (let step = 0; step <= steps; step += SPOKES) ends.push(0, 0, 0, ...at(step));
  }
  return lines(ends, new LineBasicMaterial({ color, transparent: true, opacity: 0.3, depthWrite: false }));
}

export class Mount {
  constructor(about, color, stage) {
    Object.assign(this, { about, name: about.name });
    this.object = new Group();
    const marker = new Mesh(new CylinderGeometry(0.06, 0.06, 0.08, 24).rotateX(Math.PI / 2), new MeshLambertMaterial({ color }));
    this.cones = cones(about, color);
    this.cones.visible = false;
    this.object.add(marker, axes(0.5), this.cones);
    this.marker = marker;
    this.pose = [...about.position_m, ...about.rpy_rad];
    stage.labels.add(this.name, color, () => (this.object.visible ? placed(this.object) : null));
  }

  get pose() {
    return this.numbers;
  }

  // x, y, z, roll, pitch, yaw in metres and radians: R = Rz(yaw) Ry(pitch) Rx(roll).
  set pose(numbers) {
    this.numbers = [...numbers];
    this.object.position.set(...numbers.slice(0, 3));
    this.object.quaternion.setFromEuler(new Euler(...numbers.slice(3), "ZYX"));
  }

  // The pose that a handle has given to the object: what it did not touch is the same, bit for bit.
  moved(rotated) {
    if (!rotated) return [...this.object.position.toArray(), ...this.numbers.slice(3)];
    const { x, y, z } = new Euler().setFromQuaternion(new Quaternion().copy(this.object.quaternion), "ZYX");
    const before = this.numbers.slice(3);
    const options = [[x, y, z], [x + Math.PI, Math.PI - y, z + Math.PI]].map((option) => option.map((angle, i) => near(angle, before[i])));
    const change = (option) => option.reduce((sum, angle, i) => sum + Math.abs(angle - before[i]), 0);
    return [...this.numbers.slice(0, 3), ...(change(options[0]) <= change(options[1]) ? options[0] : options[1])];
  }
}

// The same angle, within half a turn of another.
function near(angle, other) {
  return angle - 2 * Math.PI * Math.round((angle - other) / (2 * Math.PI));
}
