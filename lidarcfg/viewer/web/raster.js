// The cloud drawn by the processor, into an image with depths that takes its place in the scene as any surface does.
// Where WebGL itself runs on the processor this is ten times as fast as its points.

import { AlwaysDepth, DataTexture, FloatType, GLSL3, Mesh, PlaneGeometry, RedFormat, ShaderMaterial, Vector2 } from "three";
import { Cloud } from "lidarcfg/cloud";
import { DIFFUSE, SHADES, packed, rgb } from "lidarcfg/colours";

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

export class RasterCloud extends Cloud {
  constructor(about, arrays) {
    super(about, arrays);
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
  }

  // Draw at most so many points.
  draw(camera, size, ratio, limit) {
    this.rasterise(this.view(camera, size, ratio, limit));
    if (this.image?.length !== this.depths.length) this.newImage();
    this.shade();
    const { elements } = camera.projectionMatrix;
    this.uniforms.clip.value.set(-elements[10], elements[14]);
    this.uniforms.colours.value.needsUpdate = true;
    this.uniforms.depths.value.needsUpdate = true;
  }

  newImage() {
    const { width, height } = this;
    this.image = new Int32Array(width * height);
    const { colours, depths } = this.uniforms;
    colours.value.dispose();
    depths.value.dispose();
    colours.value = new DataTexture(new Uint8Array(this.image.buffer), width, height);
    depths.value = new DataTexture(this.depths, width, height, RedFormat, FloatType);
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
      sensor: (i) => this.sensorShades[(fact[4 * i + 2] + 256 * fact[4 * i + 3]) * SHADES + lightOf(i)],
      object: (i) => this.objectShades[thing[i] * SHADES + lightOf(i)],
      intensity: (i) => (fact[4 * i] > DIFFUSE ? retro : sample(fact[4 * i])),
      ring: (i) => sample(fact[4 * i + 1]),
      height: (i) => sample(position[3 * i + 2] + origin_m[2]),
      time: (i) => sample(time[i] * unit_s),
    }[mode];
    for (let at = 0; at < depths.length; at += 1) if (depths[at] !== 0) image[at] = colourOf(ids[at]);
  }
}
