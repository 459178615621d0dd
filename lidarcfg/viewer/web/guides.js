// A grid on the ground, and rings of equal range around the vehicle.

import { BufferAttribute, BufferGeometry, Group, LineBasicMaterial, LineSegments, Vector3 } from "three";
import { placed } from "lidarcfg/tracks";

const GRID_M = 100; // to each side
const STEP_M = 5;
const RINGS_M = [5, 10, 20, 30, 50, 75, 100, 150, 200];
const STEPS = 180; // of a ring

function lines(ends, color, opacity) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
  return new LineSegments(geometry, new LineBasicMaterial({ color, opacity, transparent: true, depthWrite: false }));
}

// In short pieces: renderers on the processor drop lines that begin far behind the camera.
export function grid(z) {
  const ends = [];
  for (let at = -GRID_M; at <= GRID_M; at += STEP_M) {
    for (let from = -GRID_M; from < GRID_M; from += STEP_M) {
      ends.push(at, from, z, at, from + STEP_M, z, from, at, z, from + STEP_M, at, z);
    }
  }
  return lines(ends, "white", 0.3);
}

// Their ranges stand at the front.
export function rings(z, stage, color) {
  const group = new Group();
  group.isEndless = true; // nobody wants them whole
  const ends = [];
  const at = (radius, step) => [radius * Math.cos((2 * Math.PI * step) / STEPS), radius * Math.sin((2 * Math.PI * step) / STEPS), z];
  for (const radius of RINGS_M) {
    for (let step = 0; step < STEPS; step += 1) ends.push(...at(radius, step), ...at(radius, step + 1));
    const front = new Vector3(radius, 0, z);
    stage.labels.add(`${radius} m`, color, () => (group.visible ? placed(group, front) : null));
  }
  group.add(lines(ends, color, 0.55));
  return group;
}
