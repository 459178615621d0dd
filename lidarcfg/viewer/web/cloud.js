// The merged cloud: its arrays, what of it is shown, and the point under the pointer. Subclasses draw it.

import { Matrix4, Vector3 } from "three";
import { ramp, shades } from "lidarcfg/colours";
import { readArray } from "lidarcfg/data";

const PICK_PX = 8;
const BOUNDED = 20_000; // points that tell where most of them are
export const FULL_SIZE_M = 25; // a point this far away has the size of the slider; nearer ones are larger
export const LARGEST = 3; // times the slider's size
const DENSE = 1e6; // of more points, each is smaller

export async function readArrays({ points }) {
  const arrays = {
    position: await readArray("position", Float32Array),
    time: await readArray("time", Uint32Array),
    fact: await readArray("fact", Uint8Array), // intensity, ring, sensor's low and high byte
  };
  if (points.objects) arrays.thing = await readArray("thing", Uint16Array);
  return arrays;
}

export class Cloud {
  constructor(about, arrays) {
    const { points, colours } = about;
    Object.assign(this, { about: points, colours, arrays, count: points.count, size: 2, drawn: 0 });
    const colourOf = new Map(about.sensors.map(({ name, colour }) => [name, colour]));
    this.shown = new Uint8Array(points.sensors.length).fill(255);
    this.sensorShades = shades(points.sensors.map(({ name }) => colourOf.get(name)));
    this.objectShades = shades((points.objects ?? []).map(({ colour }) => colour));
    this.scale = ramp(colours.scale, 256);
    this.slice(0, points.end);
    this.colourBy(about.by);
  }

  colourBy(mode) {
    this.mode = mode;
  }

  show(name, on) {
    const index = this.about.sensors.findIndex((sensor) => sensor.name === name);
    if (index >= 0) this.shown[index] = on ? 255 : 0;
  }

  // Only the points from `first` to `last`, in units of time.
  slice(first, last) {
    Object.assign(this, { first, last });
  }

  // Ranges of at most so many points: the same fraction of each bin in time, within which the order is random.
  ranges(limit) {
    const { bins, end } = this.about;
    const width = (end + 1) / (bins.length - 1);
    const from = Math.max(Math.floor(this.first / width) - 1, 0); // one more, as the bins were cut with other rounding
    const to = Math.min(Math.floor(this.last / width) + 1, bins.length - 2);
    const fraction = limit / Math.max(bins[to + 1] - bins[from], 1);
    if (fraction >= 1) return [[bins[from], bins[to + 1]]];
    return Array.from({ length: to - from + 1 }, (_, i) => bins[from + i]).map((start, i) => [
      start,
      start + Math.ceil(fraction * (bins[from + i + 1] - start)),
    ]);
  }

  // Take over the view: `ratio` is device pixels to one of the page's. Says which ranges are to be drawn.
  view(camera, size, ratio, limit) {
    const ranges = this.ranges(limit);
    Object.assign(this, { camera, ratio, drawn: ranges.reduce((sum, [start, stop]) => sum + stop - start, 0) });
    [this.width, this.height] = [Math.floor(size.x * ratio), Math.floor(size.y * ratio)];
    this.side = this.size * ratio * Math.min(Math.sqrt(DENSE / this.drawn), 1);
    return ranges;
  }

  // Draw the ranges into depths (metres ahead of the camera; 0: nothing) and ids, the nearest winning.
  rasterise(ranges) {
    const { camera, width, height } = this;
    if (this.depths?.length !== width * height) {
      this.depths = new Float32Array(width * height);
      this.ids = new Int32Array(width * height);
    }
    this.depths.fill(0);
    camera.updateMatrixWorld();
    const matrix = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    matrix.multiply(new Matrix4().makeTranslation(...this.about.origin_m));
    for (const [start, stop] of ranges) this.splat(matrix.elements, start, stop);
  }

  // Points `start` to `stop`. Rows go up, as in WebGL.
  splat(m, start, stop) {
    const { width, height, depths, ids, first, last, shown, side: size } = this;
    const { position, time, fact } = this.arrays;
    const { near } = this.camera;
    const [halfWidth, halfHeight] = [width / 2, height / 2];
    const [ax, bx, cx, dx] = [0, 4, 8, 12].map((i) => m[i] * halfWidth);
    const [ay, by, cy, dy] = [1, 5, 9, 13].map((i) => m[i] * halfHeight);
    const [aw, bw, cw, dw] = [m[3], m[7], m[11], m[15]];
    const large = (FULL_SIZE_M * size) / 1.5; // nearer than this a point is more than a pixel
    const most = Math.max(Math.round(LARGEST * size), 1);
    const every = shown.every(Boolean);
    for (let i = start; i < stop; i += 1) {
      if (time[i] < first || time[i] > last) continue;
      const x = position[3 * i];
      const y = position[3 * i + 1];
      const z = position[3 * i + 2];
      const w = aw * x + bw * y + cw * z + dw;
      if (w < near) continue;
      const column = Math.floor((ax * x + bx * y + cx * z + dx) / w + halfWidth);
      const row = Math.floor((ay * x + by * y + cy * z + dy) / w + halfHeight);
      if (column < 0 || row < 0 || column >= width || row >= height) continue;
      if (!every && !shown[fact[4 * i + 2] + 256 * fact[4 * i + 3]]) continue;
      if (w >= large) {
        const at = row * width + column;
        if (depths[at] === 0 || w < depths[at]) {
          depths[at] = w;
          ids[at] = i;
        }
        continue;
      }
      const side = Math.min(Math.round((FULL_SIZE_M * size) / w), most);
      const left = Math.max(column - (side >> 1), 0);
      const right = Math.min(column - (side >> 1) + side, width);
      const top = Math.min(row - (side >> 1) + side, height);
      for (let r = Math.max(row - (side >> 1), 0); r < top; r += 1) {
        for (let at = r * width + left; at < r * width + right; at += 1) {
          if (depths[at] === 0 || w < depths[at]) {
            depths[at] = w;
            ids[at] = i;
          }
        }
      }
    }
  }

  // The point shown nearest to (x, y) within a few pixels, or null.
  pick(x, y) {
    const { width, height, depths, ids, ratio } = this;
    const [column, row, reach] = [Math.floor(x * ratio), height - 1 - Math.floor(y * ratio), Math.ceil(PICK_PX * ratio)];
    let found = null;
    let least = (reach + 0.5) ** 2;
    for (let r = Math.max(row - reach, 0); r <= Math.min(row + reach, height - 1); r += 1) {
      for (let c = Math.max(column - reach, 0); c <= Math.min(column + reach, width - 1); c += 1) {
        const off = (c - column) ** 2 + (r - row) ** 2;
        if (off < least && depths[r * width + c] !== 0) [found, least] = [ids[r * width + c], off];
      }
    }
    return found;
  }

  // Corners of the box that holds most of the points that are shown: without the outermost hundredth on each side.
  bounds() {
    const { time } = this.arrays;
    const some = this.ranges(BOUNDED).flatMap(([start, stop]) => Array.from({ length: stop - start }, (_, i) => start + i));
    const places = some.filter((i) => time[i] >= this.first && time[i] <= this.last).map((i) => this.place(i).toArray());
    if (!places.length) return [];
    const ends = [0, 1, 2].map((axis) => {
      const sorted = places.map((at) => at[axis]).sort((a, b) => a - b);
      return [0.01, 0.99].map((fraction) => sorted[Math.round(fraction * (sorted.length - 1))]);
    });
    return [0, 1, 2, 3, 4, 5, 6, 7].map((i) => new Vector3(...ends.map((end, axis) => end[(i >> axis) & 1])));
  }

  place(i) {
    const { position } = this.arrays;
    return new Vector3(...[0, 1, 2].map((axis) => position[3 * i + axis] + this.about.origin_m[axis]));
  }

  describe(i) {
    const { fact, time, thing } = this.arrays;
    const [x, y, z] = this.place(i).toArray().map((value) => value.toFixed(3));
    const sensor = this.about.sensors[fact[4 * i + 2] + 256 * fact[4 * i + 3]].name;
    const parts = [`x ${x} m, y ${y} m, z ${z} m`, `intensity ${fact[4 * i]}`, `ring ${fact[4 * i + 1]}`];
    parts.push(`${(time[i] * this.about.unit_s).toFixed(6)} s`, sensor);
    if (thing) parts.push(this.about.objects[thing[i]].name);
    return parts.join(" · ");
  }
}
