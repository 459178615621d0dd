// Where the vehicle and dynamic objects are in each frame. The page's frame is the vehicle's at the first point's time.

import { Euler, Quaternion, Vector3 } from "three";
import { readArray } from "lidarcfg/data";

const POSE = 7; // x, y, z and a quaternion

export async function readTracks({ timeline }) {
  return timeline ? readArray("tracks", Float64Array) : null;
}

export class Tracks {
  constructor(poses, timeline, vehicle, stage) {
    Object.assign(this, { poses, count: timeline.frames.length, vehicle, stage, objects: [], grounds: [], following: false });
  }

  // The object moves along a track; track 0 is the vehicle's.
  add(object, track) {
    this.objects.push([object, track]);
  }

  // A plane that stays under the vehicle.
  under(plane) {
    this.grounds.push([plane, plane.position.x, plane.position.y]);
  }

  // Put everything where it is in a frame; the camera goes along if it follows the vehicle.
  go(frame) {
    const [place, heading] = [this.vehicle.position.clone(), yaw(this.vehicle)];
    this.put(this.vehicle, 0, frame);
    for (const [object, track] of this.objects) this.put(object, track, frame);
    for (const [plane, x, y] of this.grounds) Object.assign(plane.position, { x: x + this.vehicle.position.x, y: y + this.vehicle.position.y });
    if (this.following) this.stage.carry(place, this.vehicle.position, yaw(this.vehicle) - heading);
  }

  put(object, track, frame) {
    const first = POSE * (track * this.count + frame);
    const pose = this.poses.subarray(first, first + POSE);
    object.position.fromArray(pose);
    object.quaternion.fromArray(pose, 3);
    object.updateMatrixWorld();
  }
}

const yaw = (object) => new Euler().setFromQuaternion(new Quaternion().copy(object.quaternion), "ZYX").z;

// A place that an object carries, in the page's frame.
export const placed = (object, at = new Vector3()) => object.localToWorld(at.clone());
