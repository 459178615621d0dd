// The cloud drawn by the GPU, as three.js's Points: the same places, sizes and colours as the rasteriser's.

import { BufferAttribute, BufferGeometry, DataTexture, GLSL3, IntType, Points, RedFormat, ShaderMaterial, Vector2, Vector3 } from "three";
import { Cloud, FULL_SIZE_M, LARGEST } from "lidarcfg/cloud";
import { DIFFUSE, MODES, SHADES, rgb } from "lidarcfg/colours";

const TABLE_WIDTH = 4096; // texels a row of the colour table

const VERTEX = `
in uvec4 fact;
in uint time, thing;
uniform highp sampler2D shown, table;
uniform highp uint first, last;
uniform int mode;
uniform vec2 span, resolution;
uniform vec3 retro;
uniform float side, unit;
flat out vec3 shade;

vec3 texel(int at) {
  return texelFetch(table, ivec2(at % ${TABLE_WIDTH}, at / ${TABLE_WIDTH}), 0).rgb;
}

vec3 sampled(float value) {
  return texel(int(floor(clamp((value - span.x) * 255.0 / (span.y - span.x), 0.0, 255.0) + 0.5)));
}

void main() {
  int intensity = int(fact.x);
  int sensor = int(fact.z + 256u * fact.w);
  int light = min(intensity, ${DIFFUSE});
  gl_PointSize = 1.0;
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0); // outside
  if (time < first || time > last || texelFetch(shown, ivec2(sensor % ${TABLE_WIDTH}, sensor / ${TABLE_WIDTH}), 0).r == 0.0) return;

  vec4 at = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  float size = clamp(floor(${FULL_SIZE_M.toFixed(1)} * side / at.w + 0.5), 1.0, max(floor(${LARGEST.toFixed(1)} * side + 0.5), 1.0));
  vec2 pixel = floor((at.xy / at.w * 0.5 + 0.5) * resolution) + (mod(size, 2.0) == 1.0 ? 0.5 : 0.0);
  gl_PointSize = size;
  gl_Position = vec4((pixel / resolution * 2.0 - 1.0) * at.w, at.zw);

  if (mode == 0) shade = texel(sensor * ${SHADES} + light);
  else if (mode == 1) shade = intensity > ${DIFFUSE} ? retro : sampled(float(intensity));
  else if (mode == 2) shade = sampled(float(fact.y));
  else if (mode == 3) shade = sampled(position.z);
  else if (mode == 4) shade = sampled(float(time) * unit);
  else shade = texel(int(thing) * ${SHADES} + light);
}`;
const FRAGMENT = `
flat in vec3 shade;
out vec4 colour;
void main() {
  colour = vec4(shade, 1.0);
}`;

export class PointsCloud extends Cloud {
  constructor(about, arrays) {
    super(about, arrays);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(arrays.position, 3));
    const integers = { fact: [arrays.fact, 4], time: [arrays.time, 1], thing: [arrays.thing ?? new Uint16Array(this.count), 1] };
    for (const [name, [array, width]] of Object.entries(integers)) {
      const attribute = new BufferAttribute(array, width);
      attribute.gpuType = IntType;
      geometry.setAttribute(name, attribute);
    }
    const value = (initial) => ({ value: initial });
    this.uniforms = {
      ...{ first: value(0), last: value(0), mode: value(0), side: value(1), unit: value(this.about.unit_s) },
      ...{ span: value(new Vector2()), resolution: value(new Vector2()) },
      ...{ retro: value(new Vector3(...rgb(this.colours.retro)).divideScalar(255)) },
      ...{ table: value(null), shown: value(texture(this.shown, 1, RedFormat)) },
    };
    const { uniforms } = this;
    const material = new ShaderMaterial({ glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms });
    this.tables = { sensor: this.sensorShades, object: this.objectShades };
    this.object = new Points(geometry, material);
    this.object.position.set(...this.about.origin_m);
    this.object.frustumCulled = false;
  }

  show(name, on) {
    super.show(name, on);
    this.uniforms.shown.value.image.data.set(this.shown);
    this.uniforms.shown.value.needsUpdate = true;
  }

  draw(camera, size, ratio) {
    const [[start, stop]] = this.view(camera, size, ratio, Infinity);
    this.object.geometry.setDrawRange(start, stop - start);
    const { uniforms, mode } = this;
    const [low, high] = this.about.spans[mode] ?? [0, 1];
    const shift = mode === "height" ? this.about.origin_m[2] : 0;
    uniforms.span.value.set(low - shift, high - shift);
    uniforms.resolution.value.set(this.width, this.height);
    Object.assign(uniforms.first, { value: this.first });
    Object.assign(uniforms.last, { value: this.last });
    Object.assign(uniforms.side, { value: this.side });
    Object.assign(uniforms.mode, { value: MODES.indexOf(mode) });
    if (this.tableOf === mode) return;
    this.tableOf = mode;
    uniforms.table.value?.dispose();
    uniforms.table.value = texture(new Uint8Array((this.tables[mode] ?? this.scale).buffer), 4);
  }

  // The GPU keeps no list of which point is where: the processor draws them once more.
  pick(x, y) {
    this.rasterise(this.ranges(Infinity));
    return super.pick(x, y);
  }
}

// Values of so many bytes each, in rows of TABLE_WIDTH.
function texture(bytes, width, format) {
  const rows = Math.max(Math.ceil(bytes.length / width / TABLE_WIDTH), 1);
  const data = new Uint8Array(rows * TABLE_WIDTH * width);
  data.set(bytes);
  const made = new DataTexture(data, TABLE_WIDTH, rows, format);
  made.needsUpdate = true;
  return made;
}
