// Puts the picture and its controls together.

import { readArrays } from "lidarcfg/cloud";
import { readAbout } from "lidarcfg/data";
import { Changing, Missed, Vehicle, Worst, bounds, region, scenery, zones } from "lidarcfg/bodies";
import { grid, rings } from "lidarcfg/guides";
import { Evaluator, Handles } from "lidarcfg/handles";
import { listenToKeys } from "lidarcfg/keys";
import { Measure } from "lidarcfg/measure";
import { EvaluationSection, MissesSection, VerdictSection, check, colourSection, download, el, push, section, sensorSection, slide } from "lidarcfg/panel";
import { PointsCloud } from "lidarcfg/points";
import { RasterCloud } from "lidarcfg/raster";
import { RigSection } from "lidarcfg/rig";
import { Mount, axes } from "lidarcfg/sensors";
import { Stage } from "lidarcfg/stage";
import { TimeSection } from "lidarcfg/time";
import { Tracks, readTracks } from "lidarcfg/tracks";

const PLAY_MS = 100; // of a frame

export async function start() {
  const loading = document.getElementById("loading");
  try {
    const began = performance.now();
    const about = await readAbout();
    const stage = new Stage(about);
    const Cloud = stage.hasGpu ? PointsCloud : RasterCloud;
    const cloud = about.points && new Cloud(about, await readArrays(about));
    const view = build(about, stage, cloud, await readTracks(about));
    loading.hidden = true;
    window.lidarcfg = Object.assign(view, { began });
  } catch (error) {
    loading.textContent = `The page cannot be shown: ${error.message}`;
    throw error;
  }
}

function build(about, stage, cloud, poses) {
  const panel = document.getElementById("panel");
  const status = document.getElementById("status");
  const say = (text) => {
    status.textContent = text;
  };
  const view = { about, stage, cloud, say, transparent: false };
  view.tracks = poses && new Tracks(poses, about.timeline, stage.vehicle, stage);
  const help = push("help-open", "Keys", () => view.help.toggle());
  panel.append(el("h1", {}, "lidarcfg ", el("small", { textContent: about.version }), help));

  if (cloud) {
    stage.points = cloud;
    stage.scene.add(cloud.object);
  }
  stage.vehicle.add(axes(1));
  const mounts = about.rigs.flatMap((rig) => rig.mounts).map((mount) => {
    const { colour } = about.sensors.find(({ name }) => name === mount.name);
    return new Mount(mount, colour, stage);
  });
  for (const mount of mounts) stage.vehicle.add(mount.object);

  const sensors = sensorSection(about, (name, on) => {
    cloud?.show(name, on);
    mounts.filter((mount) => mount.name === name).forEach((mount) => {
      mount.object.visible = on;
    });
    stage.redraw();
  });
  if (sensors) panel.append(sensors);
  if (cloud) pointControls(view, panel);
  bodyControls(view, panel, mounts);
  if (view.tracks) timeControls(view, panel);
  if (about.study) studyControls(view, panel);
  if (about.rigs.length && about.live) rigControls(view, panel, mounts.slice(0, about.rigs[0].mounts.length));
  else if (about.rigs.length) panel.append(el("p", { className: "dim", textContent: "Served by lidarcfg view, this page has handles that move the rig." }));

  const targets = () => ({
    mounts: mounts.filter(({ object }) => object.visible),
    bodies: stage.bodies.filter((object) => object.visible),
  });
  view.measure = new Measure(stage, targets, say, (mount) => view.rig?.select(mount));
  cameraControls(view, panel);
  listenToKeys(view);
  return view;
}

function pointControls({ about, stage, cloud }, panel) {
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
}

// Points, vehicle and dynamic objects are shown at one time.
function timeControls(view, panel) {
  const { about, stage, cloud, tracks } = view;
  let last = 0;
  view.time = new TimeSection(
    about,
    (frame, from, to) => {
      cloud?.slice(from, to);
      tracks.go(frame);
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

// What can be switched on and off around the points.
function bodyControls(view, panel, mounts) {
  const { about, stage, tracks } = view;
  const { study, colours } = about;
  const rows = [];
  const toggled = (id, text, object, parent = stage.vehicle, on = true) => {
    object.visible = on;
    parent.add(object);
    if (object.isGroup && !["rings", "missed"].includes(id)) stage.bodies.push(object);
    rows.push(check(id, text, on, (shown) => {
      object.visible = shown;
      stage.redraw();
    }));
  };
  if (study) {
    toggled("region", study.excluded ? "region, and what it excludes" : "region", region(study, colours));
    if (study.bounds.length || study.base_area) {
      const limits = bounds(study, colours);
      view.bases = new Changing(colours.base, 0.9);
      limits.add(view.bases.object);
      toggled("bounds", "bounds of the sensors", limits);
    }
    if (study.zones.length) toggled("zones", "zones", zones(study, stage, colours));
    if (study.misses && (about.live || about.misses)) {
      view.missed = new Missed();
      toggled("missed", "what is missed on the ground", view.missed.object);
    }
    view.worst = new Worst(stage, colours);
    toggled("bodies", "worst subspaces", view.worst.object, stage.vehicle, about.shows_worst);
    if (about.evaluation.blind) {
      view.blind = new Changing(colours.blind, 0.22);
      toggled("blind", "what no sensor sees", view.blind.object, stage.vehicle, false);
    }
  }
  if (about.vehicle) {
    view.vehicle = new Vehicle(about.vehicle, colours);
    toggled("vehicle", "the vehicle's body", view.vehicle.object);
  }
  if (about.transparent) rows.push(check("transparent", "transparent: nothing is hidden", false, (on) => seeThrough(view, on)));
  if (about.scenes.length) {
    const objects = about.scenes.reduce((sum, scene) => sum + scene.objects, 0);
    toggled("scene", `scene: ${objects} objects`, scenery(about.scenes, colours, tracks), stage.scene);
  }
  toggled("grid", "grid of 5 m", grid(about.ground_m), stage.scene, false);
  toggled("rings", "range rings", rings(about.ground_m, stage, colours.excluded), stage.vehicle, false);
  if (mounts.length) {
    const long = (length) => mounts.forEach((mount) => {
      mount.cones.visible = length > 0;
      mount.cones.scale.setScalar(Math.max(length, 1e-3));
      stage.redraw();
    });
    rows.push(slide("cones", "beams", [0, 60, 0.5], 0, (value) => (value ? `${value} m` : "off"), long));
  }
  panel.append(section("Around them", ...rows));
}

function studyControls(view, panel) {
  const { about } = view;
  if (about.study.requirements.length && (about.live || about.verdict)) {
    view.verdict = new VerdictSection(about.study.requirements);
    panel.append(view.verdict.element);
    if (about.verdict) view.verdict.set(about.verdict);
  }
  if (view.missed) {
    view.misses = new MissesSection(about);
    panel.append(view.misses.element);
    if (about.misses) showMisses(view, about.misses);
  }
  view.figures = new EvaluationSection(about, (count) => {
    if (!view.worst.object.visible) document.getElementById("bodies").click();
    show(view, view.evaluation, count);
  });
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
  view.blind?.set(evaluation.blind?.mesh);
  view.bases?.set(evaluation.bases);
  view.stage.redraw();
}

function showMisses(view, found) {
  view.misses.set(found);
  view.missed.set(found.squares);
  view.stage.redraw();
}

function rigControls(view, panel, mounts) {
  const { stage, about } = view;
  const moved = () => {
    view.rig.show();
    view.rig.stale.hidden = !view.cloud;
    view.rates?.forget();
    view.verifier?.forget();
    view.evaluator?.ask();
    view.missing?.ask();
  };
  view.handles = new Handles(stage, mounts, about, moved, () => view.rig.count(), ({ message }) => view.say(message));
  if (about.study) evaluators(view);
  view.rig = new RigSection(view.handles, about, view.say);
  panel.append(view.rig.element);
}

// Max VSR and misses follow each move; detection rates and the verdict take longer and are asked for in pauses.
function evaluators(view) {
  const fail = (error) => {
    view.figures.violations.textContent = error.message;
  };
  const question = () => ({ poses: view.handles.poses, transparent: view.transparent });
  view.rates = new Evaluator("rates", question, (found) => view.figures.setRates(found), fail);
  const detects = view.about.study.detects;
  view.evaluator = new Evaluator("evaluate", () => ({ ...question(), worst: view.count }), (found) => {
    show(view, found, view.count);
    if (detects) {
      view.figures.staleRates();
      view.rates.askSoon();
    }
    view.verdict?.stale();
    view.verifier?.askSoon();
  }, fail);
  if (detects) view.rates.ask();
  if (view.misses) {
    view.missing = new Evaluator("misses", () => ({ poses: view.handles.poses }), (found) => showMisses(view, found), (error) => view.misses.fail(error));
    view.missing.ask();
  }
  if (!view.verdict) return;
  view.verifier = new Evaluator("verify", () => ({ poses: view.handles.poses }), (found) => view.verdict.set(found), (error) => view.verdict.fail(error));
  view.verifier.ask();
}

function cameraControls(view, panel) {
  const { stage, measure, say } = view;
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
  const fit = push("fit", "Zoom to fit", () => stage.fitShown());
  const follow = check("follow", "follow the vehicle", false, (on) => {
    view.tracks.following = on;
  });
  const save = push("save-picture", "Save picture", async () => download(await stage.picture(), "lidarcfg.png"));
  const parts = [el("div", { className: "row" }, ...looks), el("div", { className: "row" }, fit, button, save)];
  panel.querySelector("h1").after(section("Look", ...parts, view.about.timeline?.drives ? follow : null, text));
}
