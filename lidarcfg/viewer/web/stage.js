// Camera, drawing on demand, and how many points a moving picture can afford.

import {
  AmbientLight,
  DirectionalLight,
  Group,
  OrbitControls,
  PerspectiveCamera,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { Labels } from "lidarcfg/labels";
import { placed } from "lidarcfg/tracks";

const SETTLE_MS = 250; // after so long without a move everything is drawn
const FIELD_DEG = 60;
const MARGIN = 1.12; // around what is to be shown whole
const LEAST = 50_000; // points that are drawn however long they take
const CORNERS_DEG = [180, 90, 270, 0]; // of four quarters to look from, those behind the vehicle first
const TURNS_DEG = [25, 35, 45, 55, 65]; // from these on
const RISE = 0.57; // of the camera, over a metre to the side
const DIRECTIONS = {
  perspective: CORNERS_DEG.flatMap((corner) =>
    TURNS_DEG.map((turn) => ((corner + turn) * Math.PI) / 180).map((at) => [Math.cos(at), Math.sin(at), RISE]),
  ),
  top: [[-1e-4, 0, 1]],
  front: [[1, 0, 0]],
  side: [[0, -1, 0]],
};

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

const corners = (low, high) => [0, 1, 2, 3, 4, 5, 6, 7].map((i) => new Vector3(...[0, 1, 2].map((axis) => ((i >> axis) & 1 ? high : low)[axis])));

// From where places reach as far to one side of the picture as to the other: across at depths ahead.
function centred(across, depths) {
  let [low, high] = [Math.min(...across), Math.max(...across)];
  for (let step = 0; step < 50; step += 1) {
    const middle = (low + high) / 2;
    const slopes = across.map((value, i) => (value - middle) / depths[i]);
    if (Math.max(...slopes) + Math.min(...slopes) > 0) low = middle;
    else high = middle;
  }
  return low;
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
    this.vehicle = new Group(); // and all that travels along
    this.scene.add(this.vehicle);
    this.bodies = []; // what can be switched on and off
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

  // The vehicle and the worst subspaces, or what there is instead of them, from a side: that nearest to the vehicle.
  look(from) {
    const places = this.about.opening.map((at) => placed(this.vehicle, new Vector3(...at)));
    const towards = (away) => new Vector3(...away).transformDirection(this.vehicle.matrixWorld).negate();
    const views = DIRECTIONS[from].map((away) => this.framing(places, towards(away)));
    const far = views.map(([eye]) => eye.distanceTo(this.vehicle.position));
    this.place(...views[far.indexOf(Math.min(...far))]);
  }

  // All points and bodies that are shown, from where the camera looks now.
  fitShown() {
    const places = this.points?.object.visible ? this.points.bounds() : [];
    const collect = (object) => {
      if (!object.visible || object.isEndless) return;
      if (object.geometry) {
        object.geometry.computeBoundingBox();
        const { min, max } = object.geometry.boundingBox;
        places.push(...corners(min.toArray(), max.toArray()).map((at) => placed(object, at)));
      }
      object.children.forEach(collect);
    };
    [this.vehicle, ...this.bodies.filter(({ parent }) => parent !== this.vehicle)].forEach(collect);
    if (places.length) this.place(...this.framing(places, this.orbit.target.clone().sub(this.camera.position)));
  }

  // Eye and target of the camera so near that all places are just in the picture, looking along a direction.
  framing(places, direction) {
    const forward = direction.clone().normalize();
    const right = new Vector3().crossVectors(forward, this.camera.up).normalize();
    const up = new Vector3().crossVectors(right, forward);
    const middle = places.reduce((sum, at) => sum.add(at), new Vector3()).divideScalar(places.length);
    const slopes = [this.camera.aspect, 1].map((aspect) => (aspect * Math.tan((this.camera.fov * Math.PI) / 360)) / MARGIN);
    const depths = places.map((at) => at.dot(forward));
    const along = [right, up].map((axis) => places.map((at) => at.dot(axis)));
    const back = along.map((across, i) => {
      const low = Math.max(...across.map((value, n) => value - slopes[i] * depths[n]));
      const high = Math.min(...across.map((value, n) => value + slopes[i] * depths[n]));
      return (high - low) / (2 * slopes[i]);
    });
    const depth = Math.min(...back, Math.min(...depths) - 0.1);
    const place = forward.clone().multiplyScalar(depth);
    [right, up].forEach((axis, i) => place.addScaledVector(axis, centred(along[i], depths.map((value) => value - depth))));
    return [place, place.clone().addScaledVector(forward, Math.max(middle.dot(forward) - depth, 0.5))];
  }

  // Move the camera as the vehicle moved: from one place to another, and turned about the vertical.
  carry(from, to, angle) {
    const along = (at) => at.clone().sub(from).applyAxisAngle(this.camera.up, angle).add(to);
    this.place(along(this.camera.position), along(this.orbit.target));
  }

  // As the command line's --camera has it.
  get cameraText() {
    const numbers = [...this.camera.position.toArray(), ...this.orbit.target.toArray(), this.fieldDeg];
    return numbers.map((value) => Number(value.toFixed(3))).join(",");
  }

  // A PNG of what is shown, with its labels.
  picture() {
    this.draw(); // the browser keeps it only until it has shown it
    const { width, height } = this.canvas;
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d");
    context.drawImage(this.canvas, 0, 0);
    const ratio = this.renderer.getPixelRatio();
    context.scale(ratio, ratio);
    this.labels.draw(context);
    return new Promise((resolve) => canvas.toBlob(resolve));
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
    this.camera.far = 20 * away + 2000;
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
