// Region, what it excludes, zones, the vehicle's bodies, worst subspaces, what is blind, and scenes.

import {
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  EdgesGeometry,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshLambertMaterial,
  PlaneGeometry,
  Vector3,
} from "three";
import { unpacked } from "lidarcfg/data";
import { placed } from "lidarcfg/tracks";

export function body(mesh, color, opacity) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(unpacked(mesh.vertices, Float32Array), 3));
  geometry.setIndex(new BufferAttribute(unpacked(mesh.triangles, Uint32Array), 1));
  const made = new Mesh(geometry, translucent(color, opacity));
  made.position.set(...mesh.origin_m);
  return made;
}

function translucent(color, opacity) {
  const look = { color, opacity, transparent: true, depthWrite: false, side: DoubleSide, flatShading: true };
  return new MeshLambertMaterial(look);
}

export function box(low, high, color) {
  const size = high.map((value, axis) => value - low[axis]);
  const lines = new LineSegments(new EdgesGeometry(new BoxGeometry(...size)), new LineBasicMaterial({ color }));
  lines.position.set(...high.map((value, axis) => (value + low[axis]) / 2));
  return lines;
}

// The vehicle's bodies: they hide what is behind them, unless they are switched transparent.
export class Vehicle {
  constructor(vehicle, colours) {
    this.object = new Group();
    this.object.add(body(vehicle.mesh, colours.vehicle, 1));
    this.transparent = false;
  }

  set transparent(on) {
    for (const { material } of this.object.children) Object.assign(material, { opacity: on ? 0.15 : 1, depthWrite: !on });
  }
}

// A body that changes with the rig, such as what no sensor sees.
export class Changing {
  constructor(color, opacity) {
    Object.assign(this, { color, opacity, object: new Group() });
  }

  set(mesh) {
    emptied(this.object);
    if (mesh) this.object.add(body(mesh, this.color, this.opacity));
  }
}

// What is missed on the ground, in squares of unlit colours.
export class Missed {
  constructor() {
    this.object = new Group();
  }

  set(squares) {
    emptied(this.object);
    for (const { colour, mesh } of squares) {
      const made = body(mesh, "black", 0.75);
      made.material.emissive.set(colour);
      this.object.add(made);
    }
  }
}

function emptied(group) {
  for (const mesh of group.children) {
    mesh.geometry.dispose();
    mesh.material.dispose();
  }
  group.clear();
}

export function region(study, colours) {
  const group = new Group();
  group.add(box(study.min_m, study.max_m, colours.excluded));
  if (study.excluded) group.add(body(study.excluded, colours.excluded, 0.3));
  return group;
}

// Boxes, and on the vehicle where the bases of sensors may be.
export function bounds(study, colours) {
  const group = new Group();
  for (const { min_m, max_m } of study.bounds) group.add(box(min_m, max_m, "white"));
  if (study.base_area) group.add(body(study.base_area, colours.base_area, 0.6));
  return group;
}

// The parts of the region that weigh more or less, each with its name.
export function zones(study, stage, colours) {
  const group = new Group();
  for (const { name, weight, min_m, max_m } of study.zones) {
    const edges = box(min_m, max_m, colours.zone);
    const top = new Vector3(0, 0, (max_m[2] - min_m[2]) / 2);
    const text = weight === 1 ? name : `${name} × ${weight}`;
    stage.labels.add(text, colours.zone, () => (group.visible ? placed(edges, top) : null));
    group.add(edges);
  }
  return group;
}

// Scenes; dynamic objects are handed to the tracks along which they move.
export function scenery(scenes, colours, tracks) {
  const group = new Group();
  for (const { mesh, dynamic, ground } of scenes) {
    if (mesh) group.add(body(mesh, colours.excluded, 0.16));
    for (const { mesh: own, track } of dynamic) {
      const object = new Group();
      object.add(body(own, colours.excluded, 0.4));
      group.add(object);
      tracks.add(object, track);
    }
    if (!ground) continue;
    const plane = new Mesh(new PlaneGeometry(2 * ground.half_m, 2 * ground.half_m), translucent(colours.excluded, 0.08));
    plane.position.set(...ground.center_m);
    plane.isEndless = true; // it cannot be shown whole
    group.add(plane);
    tracks?.under(plane);
  }
  return group;
}

// The worst subspaces of the rig, each with its VSR.
export class Worst {
  constructor(stage, colours) {
    Object.assign(this, { stage, colours, labels: [] });
    this.object = new Group();
  }

  set(worst) {
    for (const label of this.labels) this.stage.labels.remove(label);
    emptied(this.object);
    this.labels = worst.map(({ vsr_m, centroid_m, mesh }, rank) => {
      this.object.add(body(mesh, this.colours.worst, rank ? 0.2 : 0.32));
      const at = new Vector3(...centroid_m);
      const text = `VSR ${vsr_m.toFixed(4)} m`;
      return this.stage.labels.add(text, this.colours.worst, () => (this.object.visible ? placed(this.object, at) : null));
    });
  }
}
