// Camera, drawing on demand, and how many points a moving picture can afford.

import {
  AmbientLight,
  DirectionalLight,
  OrbitControls,
  PerspectiveCamera,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { Labels } from "lidarcfg/labels";

const SETTLE_MS = 250; // after so long without a move everything is drawn
const FIELD_DEG = 60;
const LEAST = 50_000; // points that are drawn however long they take
const DIRECTIONS = { perspective: [-0.75, -0.45, 0.5], top: [-1e-4, 0, 1], front: [1, 0, 0], side: [0, -1, 0] };

// Names of renderers that run on the processor: Chromium's SwiftShader, Mesa's llvmpipe and softpipe, Windows' WARP.
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const NO_WEBGL =
  "this browser has no WebGL 2 to draw the scene with. Turn on hardware acceleration in its settings, or use another " +
  "browser. lidarcfg view --png FILE draws a picture without a browser.";

function rendererOf(canvas) {
  try {
    return new WebGLRenderer({ canvas, antialias: false, powerPreference: "high-performance" });
  } catch (cause) {
    throw new Error(NO_WEBGL, { cause });
  }
}

// Whether WebGL runs on a GPU; ?points=gpu and ?points=cpu in the page's address decide it regardless.
export function gpuDraws(gl) {
  const asked = new URLSearchParams(window.location.search).get("points");
  if (asked === "gpu" || asked === "cpu") return asked === "gpu";
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  return !SOFTWARE.test(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}

export class Stage {
  constructor(about) {
    this.about = about;
    this.canvas = document.getElementById("canvas");
    this.renderer = rendererOf(this.canvas);
    this.hasGpu = gpuDraws(this.renderer.getContext());
    this.renderer.setClearColor(about.colours.background);
    this.scene = new Scene();
    this.scene.add(new AmbientLight("white", 1.6));
    this.camera = new PerspectiveCamera(FIELD_DEG, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.camera.add(new DirectionalLight("white", 2));
    this.scene.add(this.camera);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    this.orbit.addEventListener("change", () => this.moved());
    this.labels = new Labels(document.getElementById("labels"));
    this.points = null;
    this.budgetMs = 50; // for the points of a frame while something moves
    this.limit = 1e6; // points in such a frame, found by how long the last ones took
    this.playing = false;
    this.movedAt = -Infinity;
    this.frames = 0;
    this.waiting = false;
    this.fieldDeg = about.camera?.field_deg ?? FIELD_DEG;
    new ResizeObserver(() => this.resize()).observe(this.canvas.parentElement);
    this.resize();
    if (about.camera) this.place(new Vector3(...about.camera.eye_m), new Vector3(...about.camera.target_m));
    else this.look("perspective");
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas.parentElement;
    this.size = new Vector2(Math.max(clientWidth, 1), Math.max(clientHeight, 1));
    this.renderer.setPixelRatio(window.devicePixelRatio);
    this.renderer.setSize(this.size.x, this.size.y, false);
    this.camera.aspect = this.size.x / this.size.y;
    const half = Math.tan((this.fieldDeg * Math.PI) / 360) / this.camera.aspect;
    this.camera.fov = (Math.atan(half) * 360) / Math.PI;
    this.camera.updateProjectionMatrix();
    this.redraw();
  }

  place(eye, target) {
    this.camera.position.copy(eye);
    this.orbit.target.copy(target);
    this.orbit.update();
    this.moved();
  }

  look(from) {
    const target = new Vector3(...this.about.center_m);
    const away = (1.15 * this.about.radius_m) / Math.tan((this.camera.fov * Math.PI) / 360) / 1.8;
    this.place(new Vector3(...DIRECTIONS[from]).normalize().multiplyScalar(away).add(target), target);
  }

  // As the command line's --camera has it.
  get cameraText() {
    const numbers = [...this.camera.position.toArray(), ...this.orbit.target.toArray(), this.fieldDeg];
    return numbers.map((value) => Number(value.toFixed(3))).join(",");
  }

  moved() {
    this.movedAt = performance.now();
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.draw());
  }

  drawPoints(moving) {
    const began = performance.now();
    this.points.draw(this.camera, this.size, this.renderer.getPixelRatio(), moving ? this.limit : Infinity);
    const spare = this.budgetMs / (performance.now() - began);
    if (moving) this.limit = Math.max(this.points.drawn * Math.min(Math.max(spare, 0.5), 2), LEAST);
  }

  draw() {
    this.waiting = false;
    const moving = this.playing || performance.now() - this.movedAt < SETTLE_MS;
    this.onFrame?.();
    const away = this.camera.position.distanceTo(this.orbit.target);
    this.camera.near = Math.max(away / 500, 0.01);
    this.camera.far = away + 20 * this.about.radius_m + 1000;
    this.camera.updateProjectionMatrix();
    if (this.points) this.drawPoints(moving);
    this.renderer.render(this.scene, this.camera);
    this.labels.update(this.camera, this.size.x, this.size.y);
    this.frames += 1;
    this.onDrawn?.();
    if (moving) this.redraw();
    else this.settledAt = this.frames;
  }
}
