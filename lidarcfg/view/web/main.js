// Puts the picture and its controls together.

import { readArrays } from "lidarcfg/cloud";
import { MODES } from "lidarcfg/colours";
import { readAbout } from "lidarcfg/data";
import { Blind, Vehicle, Worst, bounds, region, scenery } from "lidarcfg/bodies";
import { Evaluator, Handles, saveRig } from "lidarcfg/handles";
import { Measure } from "lidarcfg/measure";
import { EvaluationSection, RigSection, TimeSection, check, colourSection, el, help, push, section, sensorSection, slide } from "lidarcfg/panel";
import { PointsCloud } from "lidarcfg/points";
import { RasterCloud } from "lidarcfg/raster";
import { Mount, axes } from "lidarcfg/sensors";
import { Stage } from "lidarcfg/stage";

const PLAY_MS = 100; // of a frame

export async function start() {
  const loading = document.getElementById("loading");
  try {
    const began = performance.now();
    const about = await readAbout();
    const stage = new Stage(about);
    const Cloud = stage.hasGpu ? PointsCloud : RasterCloud;
    const view = build(about, stage, about.points && new Cloud(about, await readArrays(about)));
    loading.hidden = true;
    window.lidarcfg = Object.assign(view, { began });
  } catch (error) {
    loading.textContent = `The page cannot be shown: ${error.message}`;
    throw error;
  }
}

function build(about, stage, cloud) {
  const { scene } = stage;
  const panel = document.getElementById("panel");
  const status = document.getElementById("status");
  const say = (text) => {
    status.textContent = text;
  };
  const view = { about, stage, cloud, transparent: false };
  panel.append(el("h1", {}, "lidarcfg ", el("small", { textContent: about.version })));

  if (cloud) {
    stage.points = cloud;
    scene.add(cloud.object);
  }
  scene.add(axes(1));
  const mounts = about.rigs.flatMap((rig) => rig.mounts).map((mount) => {
    const { colour } = about.sensors.find(({ name }) => name === mount.name);
    return new Mount(mount, colour, stage);
  });
  for (const mount of mounts) scene.add(mount.object);

  panel.append(
    sensorSection(about, (name, on) => {
      cloud?.show(name, on);
      mounts.filter((mount) => mount.name === name).forEach((mount) => {
        mount.object.visible = on;
      });
      stage.redraw();
    }),
  );
  if (cloud) pointControls(view, panel);
  bodyControls(view, panel, mounts);
  if (about.rigs.length && about.live) rigControls(view, panel, mounts.slice(0, about.rigs[0].mounts.length));
  else if (about.rigs.length) panel.append(el("p", { className: "dim", textContent: "Served by lidarcfg view, this page has handles that move the rig." }));

  const bodies = () => scene.children.filter((object) => object.isGroup && object.visible && !mounts.some((mount) => mount.object === object));
  view.measure = new Measure(stage, () => ({ mounts: mounts.filter(({ object }) => object.visible), bodies: bodies() }), say, (mount) => view.rig?.select(mount));
  cameraControls(view, panel, say);
  panel.append(help());
  keys(view);
  return view;
}

function pointControls(view, panel) {
  const { about, stage, cloud } = view;
  panel.append(
    colourSection(about, (mode) => {
      cloud.colourBy(mode);
      stage.redraw();
    }),
    slide("size", "point size", [1, 6, 0.5], 2, (value) => `${value} px`, (value) => {
      cloud.size = value;
      stage.redraw();
    }),
  );
  let last = 0;
  view.time = new TimeSection(
    about.points,
    (from, to) => {
      cloud.slice(from, to);
      stage.redraw();
    },
    (on) => {
      stage.playing = on;
      last = performance.now();
      stage.redraw();
    },
  );
  stage.onFrame = () => {
    const now = performance.now();
    if (!view.time.playing || now - last < PLAY_MS) return;
    last = now;
    view.time.go(view.time.at + 1);
  };
  panel.append(view.time.element);
}

function bodyControls(view, panel, mounts) {
  const { about, stage } = view;
  const rows = [];
  const toggled = (id, text, object, on = true) => {
    object.visible = on;
    stage.scene.add(object);
    rows.push(check(id, text, on, (shown) => {
      object.visible = shown;
      stage.redraw();
    }));
  };
  if (about.study) {
    toggled("region", "region, and what it excludes (the vehicle)", region(about.study, about.colours));
    if (about.study.bounds.length) toggled("bounds", "bounds of the sensors", bounds(about.study, about.colours));
    view.worst = new Worst(stage, about.colours);
    toggled("bodies", "worst subspaces", view.worst.object);
    if (about.evaluation.blind) {
      view.blind = new Blind(about.colours);
      toggled("blind", "what no sensor sees", view.blind.object, false);
    }
    if (about.vehicle) {
      view.vehicle = new Vehicle(about.vehicle, about.colours);
      toggled("vehicle", "the vehicle's body", view.vehicle.object);
    }
    if (about.transparent) rows.push(check("transparent", "transparent: nothing is hidden", false, (on) => seeThrough(view, on)));
  }
  if (about.scenes.length) {
    const objects = about.scenes.reduce((sum, { objects }) => sum + objects, 0);
    toggled("scene", `scene: ${objects} objects`, scenery(about.scenes, about.colours));
  }
  if (mounts.length) {
    const long = (length) => mounts.forEach((mount) => {
      mount.cones.visible = length > 0;
      mount.cones.scale.setScalar(Math.max(length, 1e-3));
      stage.redraw();
    });
    rows.push(slide("cones", "beams", [0, 60, 0.5], 0, (value) => (value ? `${value} m` : "off"), long));
  }
  if (rows.length) panel.append(section("Around them", ...rows));
  if (!about.study) return;
  view.figures = new EvaluationSection(about, (count) => show(view, view.evaluation, count));
  panel.append(view.figures.element);
  show(view, about.evaluation, Math.min(about.worst, about.evaluation.worst.length));
}

// Evaluate as if nothing hid anything, or again with the bodies.
function seeThrough(view, on) {
  view.transparent = on;
  if (view.vehicle) view.vehicle.transparent = on;
  if (view.evaluator) view.evaluator.ask();
  else show(view, on ? view.about.transparent : view.about.evaluation, view.count);
  view.stage.redraw();
}

// The latest evaluation, with so many of the worst subspaces drawn.
function show(view, evaluation, count) {
  if (view.evaluator && evaluation.worst.length < count) view.evaluator.ask();
  Object.assign(view, { evaluation, count });
  view.figures.set(evaluation, count);
  view.worst.set(evaluation.worst.slice(0, count));
  view.blind?.set(evaluation.blind);
  view.stage.redraw();
}

function rigControls(view, panel, mounts) {
  const { stage, about } = view;
  const stale = () => {
    view.rig.show();
    view.rig.stale.hidden = !view.cloud;
    view.evaluator?.ask();
  };
  view.handles = new Handles(stage, mounts, stale);
  if (about.study) {
    const fail = (error) => {
      view.figures.violations.textContent = error.message;
    };
    view.evaluator = new Evaluator(() => ({ poses: view.handles.poses, worst: view.count, transparent: view.transparent }), (found) => show(view, found, view.count), fail);
  }
  view.rig = new RigSection(view.handles, {
    onSave: () => saveRig(view.handles.poses),
    onReset: () => view.handles.reset(),
  });
  panel.append(view.rig.element);
}

function cameraControls(view, panel, say) {
  const { stage, measure } = view;
  const looks = ["perspective", "top", "front", "side"].map((from) => push(`look-${from}`, from, () => stage.look(from)));
  const text = el("code", { id: "camera" });
  stage.onDrawn = () => {
    text.textContent = `--camera=${stage.cameraText}`;
  };
  view.measuring = (on) => {
    measure.on = on;
    button.ariaPressed = on;
    if (!on) measure.clear();
    say(on ? "click the first point" : "");
  };
  const button = push("measure", "Measure", () => view.measuring(!measure.on));
  panel.append(section("Look", el("div", { className: "row" }, ...looks), el("div", { className: "row" }, button), text));
}

function keys(view) {
  const { stage, time, rig, measure } = view;
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|BUTTON|SUMMARY)$/.test(event.target.tagName)) return;
    const mode = MODES[event.key - 1];
    const choice = document.getElementById("colour");
    if (mode && [...(choice?.options ?? [])].some(({ value }) => value === mode)) {
      choice.value = mode;
      choice.dispatchEvent(new Event("change"));
    } else if (event.key === " ") time?.play(!time.playing);
    else if (event.key === "ArrowRight") time?.go(time.at + 1);
    else if (event.key === "ArrowLeft") time?.go(time.at - 1);
    else if (event.key === "m") view.measuring(!measure.on);
    else if (event.key === "t") rig?.mode("translate");
    else if (event.key === "r") rig?.mode("rotate");
    else if (event.key === "Escape") {
      view.measuring(false);
      rig?.select(null);
    } else return;
    event.preventDefault();
    stage.redraw();
  });
}
