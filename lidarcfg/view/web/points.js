// The merged cloud, drawn by the processor into an image with depths that takes part in the scene like any surface.
// For a browser without a GPU each of WebGL's points is ten times the work.

import { AlwaysDepth, DataTexture, FloatType, GLSL3, Matrix4, Mesh, PlaneGeometry, RedFormat, ShaderMaterial, Vector2, Vector3 } from "three";
import { readArray } from "lidarcfg/data";

export const MODES = ["sensor", "intensity", "ring", "height", "time", "object"];
const DIFFUSE = 100; // intensities above are of retro-reflectors
const PICK_PX = 8;
const NEAR_M = 25; // a point this far off is as large as the slider says; nearer ones are larger
const LARGEST = 3; // times as large
const DENSE = 1e6; // of more points each is smaller

const VERTEX = "void main() { gl_Position = vec4(position.xy * 2.0, 0.0, 1.0); }";
const FRAGMENT = `
uniform highp sampler2D colours, depths;
uniform vec2 clip;
out vec4 colour;
void main() {
  float away = texelFetch(depths, ivec2(gl_FragCoord.xy), 0).r;
  if (away == 0.0) discard;
  colour = texelFetch(colours, ivec2(gl_FragCoord.xy), 0);
  gl_FragDepth = 0.5 + 0.5 * (clip.x + clip.y / away);
}`;

export function rgb(code) {
  return [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16));
}

// As one number of an image's four bytes.
function packed([red, green, blue]) {
  return (255 << 24) | (blue << 16) | (green << 8) | red;
}

// A colour for each of `steps` values from the scale's stops.
function ramp(stops, steps) {
  const colours = stops.map(rgb);
  return Array.from({ length: steps }, (_, i) => {
    const at = (i / (steps - 1)) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    return packed(colours[low].map((value, c) => value + (at - low) * (colours[low + 1][c] - value)));
  });
}

// Of each colour, by intensity, 101 shades: darker for dark objects.
function lit(codes) {
  const light = Array.from({ length: DIFFUSE + 1 }, (_, i) => 0.7 + 0.3 * Math.sqrt(i / DIFFUSE));
  return Int32Array.from(codes.flatMap((code) => light.map((share) => packed(rgb(code).map((value) => share * value)))));
}

export class Cloud {
  static async read(about) {
    const { points } = about;
    const arrays = {
      position: await readArray("position", Float32Array),
      time: await readArray("time", Uint32Array),
      fact: await readArray("fact", Uint8Array), // intensity, ring, sensor's low and high byte
    };
    if (points.objects) arrays.thing = await readArray("thing", Uint16Array);
    return new Cloud(about, arrays);
  }

  constructor(about, arrays) {
    const { points, colours } = about;
    Object.assign(this, { about: points, colours, arrays, count: points.count, size: 2 });
    const colourOf = new Map(about.sensors.map(({ name, colour }) => [name, colour]));
    this.shown = new Uint8Array(points.sensors.length).fill(1);
    this.sensorShades = lit(points.sensors.map(({ name }) => colourOf.get(name)));
    this.objectShades = lit((points.objects ?? []).map(({ colour }) => colour));
    this.scale = Int32Array.from(ramp(colours.scale, 256));
    const blank = new DataTexture(new Uint8Array(4), 1, 1);
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      depthFunc: AlwaysDepth,
      uniforms: { colours: { value: blank }, depths: { value: blank }, clip: { value: new Vector2() } },
    });
    this.uniforms = material.uniforms;
    this.object = new Mesh(new PlaneGeometry(1, 1), material);
    this.object.frustumCulled = false;
    this.object.renderOrder = -1; // all else is drawn before or behind it
    this.slice(0, points.end);
    this.colourBy(about.by);
  }

  colourBy(mode) {
    this.mode = mode;
  }

  show(name, on) {
    const index = this.about.sensors.findIndex((sensor) => sensor.name === name);
    if (index >= 0) this.shown[index] = on;
  }

  // Only what was seen from `first` to `last`, in units of time.
  slice(first, last) {
    Object.assign(this, { first, last });
  }

  // Ranges of at most so many points: of each bin in time the same share, as each stands in an order of chance.
  ranges(limit) {
    const { bins, end } = this.about;
    const width = (end + 1) / (bins.length - 1);
    const from = Math.max(Math.floor(this.first / width) - 1, 0); // one more, as the bins were cut by other roundings
    const to = Math.min(Math.floor(this.last / width) + 1, bins.length - 2);
    const share = limit / Math.max(bins[to + 1] - bins[from], 1);
    if (share >= 1) return [[bins[from], bins[to + 1]]];
    return Array.from({ length: to - from + 1 }, (_, i) => bins[from + i]).map((start, i) => [
      start,
      start + Math.ceil(share * (bins[from + i + 1] - start)),
    ]);
  }

  // Draw at most so many points as the camera sees them; `ratio` is device pixels to one of the page's.
  draw(camera, size, ratio, limit) {
    const [width, height] = [Math.floor(size.x * ratio), Math.floor(size.y * ratio)];
    if (this.width !== width || this.height !== height) this.resize(width, height);
    this.ratio = ratio;
    camera.updateMatrixWorld();
    const m = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    m.multiply(new Matrix4().makeTranslation(...this.about.origin_m));
    this.depths.fill(0);
    const ranges = this.ranges(limit);
    this.drawn = ranges.reduce((sum, [start, stop]) => sum + stop - start, 0);
    const side = this.size * ratio * Math.min(Math.sqrt(DENSE / this.drawn), 1);
    for (const [start, stop] of ranges) this.splat(m.elements, start, stop, camera.near, side);
    this.shade();
    const { elements } = camera.projectionMatrix;
    this.uniforms.clip.value.set(-elements[10], elements[14]);
    this.uniforms.colours.value.needsUpdate = true;
    this.uniforms.depths.value.needsUpdate = true;
  }

  resize(width, height) {
    Object.assign(this, { width, height });
    this.depths = new Float32Array(width * height); // ahead of the camera in metres; 0: nothing
    this.ids = new Int32Array(width * height);
    this.image = new Int32Array(width * height);
    const { colours, depths } = this.uniforms;
    colours.value.dispose();
    depths.value.dispose();
    colours.value = new DataTexture(new Uint8Array(this.image.buffer), width, height);
    depths.value = new DataTexture(this.depths, width, height, RedFormat, FloatType);
  }

  // Points `start` to `stop` into depths and ids, the nearest winning. Rows go up, as in WebGL.
  splat(m, start, stop, near, size) {
    const { width, height, depths, ids, first, last, shown } = this;
    const { position, time, fact } = this.arrays;
    const [halfWidth, halfHeight] = [width / 2, height / 2];
    const [ax, bx, cx, dx] = [0, 4, 8, 12].map((i) => m[i] * halfWidth);
    const [ay, by, cy, dy] = [1, 5, 9, 13].map((i) => m[i] * halfHeight);
    const [aw, bw, cw, dw] = [m[3], m[7], m[11], m[15]];
    const large = (NEAR_M * size) / 1.5; // nearer than this a point is more than a pixel
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
      const side = Math.min(Math.round((NEAR_M * size) / w), most);
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

  // A colour for each pixel that shows a point.
  shade() {
    const { depths, ids, image, mode, scale } = this;
    const { position, time, fact, thing } = this.arrays;
    const { origin_m, unit_s, spans } = this.about;
    const [low, high] = spans[mode] ?? [0, 1];
    const steps = 255 / (high - low);
    const retro = packed(rgb(this.colours.retro));
    const sample = (value) => scale[Math.round(Math.min(Math.max((value - low) * steps, 0), 255))];
    const lightOf = (i) => Math.min(fact[4 * i], DIFFUSE);
    const colourOf = {
      sensor: (i) => this.sensorShades[(fact[4 * i + 2] + 256 * fact[4 * i + 3]) * (DIFFUSE + 1) + lightOf(i)],
      object: (i) => this.objectShades[thing[i] * (DIFFUSE + 1) + lightOf(i)],
      intensity: (i) => (fact[4 * i] > DIFFUSE ? retro : sample(fact[4 * i])),
      ring: (i) => sample(fact[4 * i + 1]),
      height: (i) => sample(position[3 * i + 2] + origin_m[2]),
      time: (i) => sample(time[i] * unit_s),
    }[mode];
    for (let at = 0; at < depths.length; at += 1) if (depths[at] !== 0) image[at] = colourOf(ids[at]);
  }

  // The point that is shown nearest to (x, y), within a few pixels, or null.
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
