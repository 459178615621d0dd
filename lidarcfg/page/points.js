// The merged cloud. Colours, sensors and time are chosen in the shader: changing them moves no point.

import {
  BufferAttribute,
  BufferGeometry,
  DataTexture,
  GLSL3,
  IntType,
  Matrix4,
  Points,
  ShaderMaterial,
  Vector2,
  Vector3,
} from "three";
import { readArray } from "lidarcfg/data";

export const MODES = ["sensor", "intensity", "ring", "height", "time", "object"];
const DIFFUSE = 100; // intensities above are of retro-reflectors
const PICK_PX = 8;

const VERTEX = `
in uint time;
in uvec4 fact;
#ifdef THINGS
in uint thing;
#endif
uniform sampler2D sensors, things, scale;
uniform int mode;
uniform vec2 span;
uniform uint first, last;
uniform float secondsPerUnit, originZ, size;
uniform vec3 retro;
out vec3 shade;

void main() {
  uint sensor = fact.z + 256u * fact.w;
  vec4 own = texelFetch(sensors, ivec2(sensor & 255u, sensor >> 8), 0);
  if (own.a == 0.0 || time < first || time > last) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_PointSize = 0.0;
    return;
  }
  float light = 0.7 + 0.3 * sqrt(min(float(fact.x), 100.0) / 100.0);
  if (mode == 0) shade = own.rgb * light;
#ifdef THINGS
  else if (mode == 5) shade = texelFetch(things, ivec2(thing & 255u, thing >> 8), 0).rgb * light;
#endif
  else {
    float value = mode == 1 ? float(fact.x) : mode == 2 ? float(fact.y)
      : mode == 3 ? position.z + originZ : float(time) * secondsPerUnit;
    float share = clamp((value - span.x) / (span.y - span.x), 0.0, 1.0);
    shade = texelFetch(scale, ivec2(int(share * 255.0 + 0.5), 0), 0).rgb;
    if (mode == 1 && fact.x > ${DIFFUSE}u) shade = retro;
  }
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_PointSize = clamp(size * 25.0 / gl_Position.w, 1.0, 3.0 * size);
}`;

const FRAGMENT = `
in vec3 shade;
out vec4 colour;
void main() { colour = vec4(shade, 1.0); }`;

export function rgb(code) {
  return [1, 3, 5].map((at) => parseInt(code.slice(at, at + 2), 16));
}

function texture(colours) {
  const rows = Math.max(Math.ceil(colours.length / 256), 1);
  const bytes = new Uint8Array(256 * rows * 4).fill(255);
  colours.forEach((code, i) => bytes.set(rgb(code), 4 * i));
  const made = new DataTexture(bytes, 256, rows);
  made.needsUpdate = true;
  return made;
}

// 256 colours from the scale's stops.
export function ramp(stops) {
  const colours = stops.map(rgb);
  return Array.from({ length: 256 }, (_, i) => {
    const at = (i / 255) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    const mixed = colours[low].map((value, c) => value + (at - low) * (colours[low + 1][c] - value));
    return `#${mixed.map((value) => Math.round(value).toString(16).padStart(2, "0")).join("")}`;
  });
}

export class Cloud {
  static async read(about) {
    const { points } = about;
    const arrays = {
      position: await readArray("position", Float32Array),
      time: await readArray("time", Uint32Array),
      fact: await readArray("fact", Uint8Array),
    };
    if (points.objects) arrays.thing = await readArray("thing", Uint16Array);
    return new Cloud(about, arrays);
  }

  constructor(about, arrays) {
    const { points, colours } = about;
    Object.assign(this, { about: points, arrays, count: points.count });
    this.colourOf = new Map(about.sensors.map(({ name, colour }) => [name, colour]));
    this.first = 0;
    this.last = points.end;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(arrays.position, 3));
    for (const [name, size] of [["time", 1], ["fact", 4], ["thing", 1]]) {
      if (!arrays[name]) continue;
      const attribute = new BufferAttribute(arrays[name], size);
      attribute.gpuType = IntType;
      geometry.setAttribute(name, attribute);
    }
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      defines: arrays.thing ? { THINGS: 1 } : {},
      uniforms: {
        sensors: { value: texture(points.sensors.map(({ name }) => this.colourOf.get(name))) },
        things: { value: texture((points.objects ?? []).map(({ colour }) => colour)) },
        scale: { value: texture(ramp(colours.scale)) },
        mode: { value: 0 },
        span: { value: new Vector2(0, 1) },
        first: { value: 0 },
        last: { value: points.end },
        secondsPerUnit: { value: points.unit_s },
        originZ: { value: points.origin_m[2] },
        size: { value: 2 },
        retro: { value: new Vector3(...rgb(colours.retro).map((value) => value / 255)) },
      },
    });
    this.uniforms = material.uniforms;
    this.object = new Points(geometry, [material]);
    this.object.position.set(...points.origin_m);
    this.object.frustumCulled = false;
    this.colourBy(about.by);
    this.allow(Infinity);
  }

  colourBy(mode) {
    this.uniforms.mode.value = MODES.indexOf(mode);
    this.uniforms.span.value.set(...(this.about.spans[mode] ?? [0, 1]));
  }

  show(name, on) {
    const index = this.about.sensors.findIndex((sensor) => sensor.name === name);
    if (index < 0) return;
    const { value } = this.uniforms.sensors;
    value.image.data[4 * index + 3] = on ? 255 : 0;
    value.needsUpdate = true;
  }

  // Only what was seen from `first` to `last`, in units of time.
  slice(first, last) {
    this.first = this.uniforms.first.value = first;
    this.last = this.uniforms.last.value = last;
  }

  // Draw at most so many points: of each bin in time the same share, as each stands in an order of chance.
  allow(limit) {
    const { bins, end } = this.about;
    const width = (end + 1) / (bins.length - 1);
    const from = Math.max(Math.floor(this.first / width) - 1, 0); // bins are cut in float64 on the other side, too
    const to = Math.min(Math.floor(this.last / width) + 1, bins.length - 2);
    const share = Math.min(limit / Math.max(bins[to + 1] - bins[from], 1), 1);
    const { geometry } = this.object;
    geometry.clearGroups();
    this.drawn = 0;
    const parts = share === 1 ? [[bins[from], bins[to + 1] - bins[from]]] : [];
    for (let i = from; share < 1 && i <= to; i += 1) parts.push([bins[i], Math.ceil(share * (bins[i + 1] - bins[i]))]);
    for (const [start, count] of parts) {
      if (count) geometry.addGroup(start, count, 0);
      this.drawn += count;
    }
  }

  // The point nearest to the camera within a few pixels of (x, y), or null.
  pick(camera, size, x, y) {
    const toClip = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    this.object.updateMatrixWorld();
    const m = toClip.multiply(this.object.matrixWorld).elements;
    const { position, time, fact } = this.arrays;
    const shown = this.uniforms.sensors.value.image.data;
    const [cx, cy] = [(2 * x) / size.x - 1, 1 - (2 * y) / size.y];
    const [rx, ry] = [(2 * PICK_PX) / size.x, (2 * PICK_PX) / size.y];
    let best = -1;
    let least = Infinity;
    for (let i = 0; i < this.count; i += 1) {
      const [px, py, pz] = [position[3 * i], position[3 * i + 1], position[3 * i + 2]];
      const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
      if (w <= 0) continue;
      const dx = ((m[0] * px + m[4] * py + m[8] * pz + m[12]) / w - cx) / rx;
      const dy = ((m[1] * px + m[5] * py + m[9] * pz + m[13]) / w - cy) / ry;
      const off = dx * dx + dy * dy;
      if (off > 1 || time[i] < this.first || time[i] > this.last) continue;
      const sensor = fact[4 * i + 2] + 256 * fact[4 * i + 3];
      const rank = w * (1 + 0.2 * off);
      if (rank < least && shown[4 * sensor + 3]) [best, least] = [i, rank];
    }
    return best < 0 ? null : best;
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
