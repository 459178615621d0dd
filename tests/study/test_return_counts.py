"""Detection by returns in studies: places, rates, maps, objectives, and what is not allowed."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg import inputs
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.report.describe import describe_object
from lidarcfg.report.inputs import report_inputs
from lidarcfg.report.results import evaluation_dict, to_json
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.search.optimize import optimize
from lidarcfg.study import return_counts as return_counts_module
from lidarcfg.study.criterion import Criterion, objective_of
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.study.return_counts import MissCounter, return_counts
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.cones import poses as sensor_poses
from lidarcfg.vsr.cones import rig_lidars
from tests.returns_cases import at_place, box, revolution, simulated, tracer_of
from tests.studies import study_of

ROOT = Path(__file__).parents[2]
STUDY = """
region:
  min_m: [-9, -6, 0]
  max_m: [9, 6, 2]
  cuboid_m: [0.5, 0.5, 0.5]
  exclude:
    - {min_m: [-3, -1.5, 0], max_m: [3, 1.5, 2]}
vehicle:
  boxes:
    - {name: body, center_m: [0, 0, 0.5], size_m: [4.5, 1.8, 1]}
sensors:
  - model: SENSOR
    count: 2
    min: {position_m: [-0.8, -0.5, 1.6], rpy_deg: [-5, -5, 0]}
    max: {position_m: [0.8, 0.5, 1.9], rpy_deg: [5, 5, 0]}
solver: {method: abc, bees: 5, cycles: 4, seed: 3}
objective: {OBJECTIVE}
detection:
  - {name: crate, size_m: [0.6, 0.4, 0.3], returns: 20, step_m: 1.5, headings_deg: [0, 60]}
  - {name: child, mesh: MESH, returns: 12, samples: 200}
  - {name: wall, size_m: [0.5, 0.5, 0.5], on_ground: true}
"""


def study(tmp_path, objective="max_vsr: 1", sensor="vlp-16", change=("", "")):
    mesh = str(ROOT / "data/objects/child.ply")
    text = STUDY.replace("OBJECTIVE", objective).replace("SENSOR", sensor).replace("MESH", mesh)
    return study_of(tmp_path, text.replace(*change))


def rig_of(loaded):
    return loaded.rig(loaded.space.poses(np.full((1, loaded.space.dimensions), 0.3))[0])


@pytest.mark.slow
def test_rates_are_those_of_the_simulator(tmp_path):
    """Each place's returns in each phase, and from them rate, worst and mean by plain sums."""
    loaded = study(tmp_path, change=("step_m: 1.5", "step_m: 3"))
    rig = rig_of(loaded)
    found = evaluate(loaded, rig)
    seen = found.return_counts["crate"]
    body = box(4.5, 1.8, 1.0)
    target = box(0.6, 0.4, 0.3)
    rate = []
    worst = []
    mean = []
    for place in seen.target.places:
        tracer = tracer_of([body, at_place(target, place)])
        by_sensor = []
        for s, one in enumerate(rig.mounts):
            by_sensor.append([simulated(one, s, revolution(one, phase, 4), tracer, 1) for phase in range(4)])
        rate.append(np.mean([a + b >= 20 for a in by_sensor[0] for b in by_sensor[1]]))
        worst.append(min(by_sensor[0]) + min(by_sensor[1]))
        mean.append(np.mean(by_sensor[0]) + np.mean(by_sensor[1]))
    assert seen.probability.tolist() == rate
    assert (seen.worst.tolist(), seen.mean.tolist()) == (worst, mean)
    had = found.detection["crate"]
    assert had.rate == pytest.approx(np.mean(rate), abs=1e-12)
    assert 0 < had.rate < 1
    assert (had.places, had.half_width) == (len(rate), 0)
    assert had.returns.rate_in_worst_phase == np.mean(np.array(worst) >= 20)
    assert had.returns.mean == pytest.approx(np.mean(mean))
    assert had.returns.mean_in_worst_phase == pytest.approx(np.mean(worst))


def test_places_are_a_grid_inside_the_region_and_free(tmp_path):
    """1.5 m apart, symmetric about the middle; its box, rotated, neither leaves the region nor enters the exclusion."""
    one = study(tmp_path).detection_targets[0]
    expected = set()
    for i in range(12):
        for j in range(8):
            for heading in (0.0, math.radians(60)):
                x, y = (i - 5.5) * 1.5, (j - 3.5) * 1.5
                corners = np.array([[a * 0.3, b * 0.2] for a in (-1, 1) for b in (-1, 1)])
                turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
                around = corners @ turn.T + (x, y)
                inside = (abs(around) <= (9, 6)).all()
                beyond = (around[:, 0].min() >= 3) | (around[:, 0].max() <= -3)
                beyond |= (around[:, 1].min() >= 1.5) | (around[:, 1].max() <= -1.5)
                if inside and beyond:  # of an upright exclusion that no corner cuts, far from all of these
                    expected.add((round(x, 9), round(y, 9), 0.0, heading))
    assert {tuple(round(v, 9) if k < 2 else v for k, v in enumerate(p)) for p in one.places.tolist()} == expected


@pytest.mark.slow
def test_maps_and_rings_add_up(tmp_path):
    loaded = study(tmp_path)
    rig = rig_of(loaded)
    found = evaluate(loaded, rig)
    shown = report_inputs(loaded, rig, found)
    for name in ("crate", "child"):
        rings = shown.rings[name]
        seen = found.return_counts[name]
        assert rings.detected.sum() == pytest.approx(seen.probability.sum())
        assert rings.places.sum() == len(seen.probability)
    at = shown.detection_maps["crate"]
    assert at.detected.sum() == pytest.approx(found.return_counts["crate"].probability.sum())
    assert at.places.max() == 2
    assert (at.low_m.tolist(), at.high_m.tolist()) == ([-9, -6], [9, 6])
    place = found.return_counts["crate"].target.places[0]
    cell = tuple(((place[:2] - at.low_m) / 1.5).astype(int))
    first = found.return_counts["crate"].target.part == found.return_counts["crate"].target.part[0]
    assert at.detected[cell] == pytest.approx(found.return_counts["crate"].probability[first].sum())
    assert "child" not in shown.detection_maps


@pytest.mark.slow
def test_drawn_places_have_an_interval_that_holds_the_rate_of_many(tmp_path):
    few = evaluate(loaded := study(tmp_path), rig_of(loaded)).detection["child"]
    many = evaluate(loaded := study(tmp_path, change=("samples: 200", "samples: 6400")), rig_of(loaded)).detection[
        "child"
    ]
    assert 0 < few.half_width < 0.2
    assert abs(few.rate - many.rate) < 1.5 * few.half_width
    assert many.half_width < few.half_width


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crate", "child"])
def test_the_objective_is_one_minus_the_rate_and_refutes_exactly(tmp_path, name):
    loaded = study(tmp_path, f"detection: {{{name}: 2}}")
    poses = loaded.space.poses(np.full((1, loaded.space.dimensions), 0.3))[0]
    value = objective_of(loaded, poses)
    assert value == 1.0 - evaluate(loaded, loaded.rig(poses)).detection[name].rate
    one = next(one for one in loaded.detection_targets if one.item.name == name)
    lidars = lidars_at(loaded.slots, poses)
    numbers = range(len(lidars))
    counter = MissCounter(one, loaded.rig(poses).mounts, loaded.obstacles)
    at = sensor_poses(lidars)
    for limit in (0.2 * value, value, np.nextafter(value, 0), np.nextafter(value, 1), 1.5 * value):
        found = counter.rate(numbers, at, limit)
        assert found >= limit if value >= limit else found == value
        trial = Trial(loaded.region, lidars, loaded.visibility)
        assert Criterion.of_study(loaded).of(trial, limit) == (math.inf if value >= limit else value)
        assert not trial.is_cut


@pytest.mark.parametrize("name", ["crate", "child"])
@pytest.mark.parametrize("limit", [1.0, np.nextafter(1.0, 2.0), 1.8091036796430564, 2.0, 1e300, math.inf])
def test_a_limit_that_no_rate_reaches_refutes_nothing(tmp_path, name, limit):
    """Of a mean of several terms a limit of one of them may be above 1; 48 places, and 1.8…, once took forever."""
    loaded = study(tmp_path, f"detection: {{{name}: 2}}")
    one = next(one for one in loaded.detection_targets if one.item.name == name)
    some = np.linspace(0, len(one.places) - 1, 48).astype(int)
    one = replace(one, places=one.places[some], part=one.part[some])
    rig = rig_of(loaded)
    scanners = scanners_of(rig.mounts)
    lidars = rig_lidars(rig)
    (seen,) = return_counts([one], scanners, lidars, loaded.obstacles)
    counter = MissCounter(one, rig.mounts, loaded.obstacles)
    found = counter.rate(range(len(lidars)), sensor_poses(lidars), limit)
    assert 0 < found < 1
    assert found == 1.0 - seen.detection.rate


@pytest.mark.slow
def test_skipping_and_threads_change_no_search(tmp_path):
    loaded = study(tmp_path, "max_vsr: 1, detection: {crate: 1, child: 0.5}")
    found = [optimize(loaded, threads, skip=skip) for threads, skip in ((1, True), (3, True), (1, False))]
    assert found[0].objective == found[1].objective == found[2].objective
    assert found[0].rig.mounts[0].position_m == found[1].rig.mounts[0].position_m == found[2].rig.mounts[0].position_m


def test_results_and_words(tmp_path):
    loaded = study(tmp_path)
    rig = rig_of(loaded)
    found = evaluate(loaded, rig)
    written = json.loads(to_json(evaluation_dict(loaded, rig, found)))
    assert written["detection"]["crate"] == found.detection["crate"].rate
    assert written["detection_returns"]["crate"]["mean"] == found.detection["crate"].returns.mean
    assert set(written["detection_returns"]) == {"crate", "child"}
    assert describe_object(loaded.detection[0]) == (
        "0.6 × 0.4 × 0.3 m, on the ground, every 1.5 m, heading 0°, 60°; detected by 20 returns or more in a revolution"
    )


FAULTS = [
    (("returns: 20", "returns: 0"), ":19:44: detection[0].returns: 0 is too small; allowed: at least 1"),
    (("returns: 20", "returns: -3"), "detection[0].returns: -3 is too small"),
    (
        ("returns: 20", "returns: 20, threshold: 2"),
        "detection[0].threshold: conflicts with returns; give only one of them",
    ),
    (("returns: 20", "returns: 20, on_ground: false"), "detection[0].on_ground: false is not allowed beside returns"),
    (("[0, 60]", "[0, 361]"), "detection[0].headings_deg[1]: 361 is too large; allowed: at most 360"),
    (("[0, 60]", "[-1]"), "detection[0].headings_deg[0]: -1 is too small; allowed: at least 0"),
    (("[0, 60]", "[]"), "detection[0].headings_deg: has 0 values; allowed: at least 1"),
    (("step_m: 1.5", "step_m: 0"), "detection[0].step_m: 0 is too small; allowed: at least 0.01"),
    (("size_m: [0.6, 0.4, 0.3], returns", "returns"), "detection[0]: missing; give size_m or mesh"),
    (
        ("size_m: [0.6, 0.4, 0.3], ret", "mesh: a.ply, size_m: [1, 1, 1], ret"),
        "detection[0].mesh: conflicts with size_m",
    ),
    (("samples: 200", "samples: 200, step_m: 1"), "detection[1].step_m: conflicts with samples"),
    (
        ("[0.5, 0.5, 0.5], on_ground", "[0.5, 0.5, 0.5], headings_deg: [0], on_ground"),
        "headings_deg: is for objects that",
    ),
    (("[0.6, 0.4, 0.3], r", "[14, 0.4, 0.3], r"), "detection[0]: crate: at heading 60 its 12.3244 m"),
    (
        ("[0.6, 0.4, 0.3], r", "[0.6, 0.4, 3], r"),
        "detection[0]: crate: at heading 0 its 3 m is more than the region's 2",
    ),
    (("size_m: [0.6, 0.4, 0.3], r", "mesh: none.ply, r"), "none.ply: no such file or directory"),
    (
        ("size_m: [0.6, 0.4, 0.3], r", "mesh: open.ply, r"),
        "open.ply: is not closed: 3 of its edges bound an odd number",
    ),
    (("size_m: [0.6, 0.4, 0.3], r", "mesh: empty.ply, r"), "empty.ply: no triangles that Open3D can read"),
    (("size_m: [0.6, 0.4, 0.3], r", "size_m: [18, 12, 0.3], samples: 99, r"), "conflicts with samples"),
    (("step_m: 1.5", "step_m: 0.01"), "crate: 4,320,000 places; allowed: at most 1,000,000; give a larger step_m"),
    (("samples: 200", "samples: 4000000"), "child: 4,000,000 places; allowed: at most 1,000,000; give fewer samples"),
    (("model: SENSOR", "elevation_deg: [-1, 1]"), "sensors[0]: lidar_0: sensor 'custom' has no codec"),
    (("model: SENSOR", "model: fan-4"), "sensors[0]: lidar_0: sensor 'fan-4' has no codec, which would say where"),
]
HEAD = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n"
)
OPEN = HEAD.format(3) + "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"


@pytest.mark.parametrize(("change", "message"), FAULTS)
def test_what_is_not_allowed_is_said_in_one_line(tmp_path, change, message):
    (tmp_path / "open.ply").write_text(OPEN + "3 0 1 2\n3 0 1 3\n3 0 2 3\n")
    (tmp_path / "empty.ply").write_text(HEAD.format(0) + "end_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n")
    path = tmp_path / "s.yaml"
    mesh = str(ROOT / "data/objects/child.ply")
    text = STUDY.replace(*change).replace("OBJECTIVE", "max_vsr: 1").replace("SENSOR", "vlp-16").replace("MESH", mesh)
    path.write_text(text)
    with pytest.raises(ConfigError) as raised:
        load_study(path)
    said = str(raised.value)
    assert "\n" not in said
    assert said.startswith(f"{path}:")
    assert message in said


@pytest.mark.slow
def test_objects_that_look_alike_are_counted_once_and_are_what_each_is_alone(tmp_path, monkeypatch):
    """Beside studies that have one of them; of a different step, size or mesh nothing is shared."""
    items = [
        "size_m: [0.6, 0.4, 0.3], returns: 400, step_m: 2",
        "size_m: [0.6, 0.4, 0.3], returns: 5, step_m: 2",
        "size_m: [0.6, 0.4, 0.3], returns: 5, step_m: 3",
        "size_m: [0.4, 0.6, 0.3], returns: 5, step_m: 2",
    ]
    alone = []
    before = STUDY[STUDY.index("  - {name: crate") :]
    for item in items:
        loaded = study(
            tmp_path,
            change=(before.replace("MESH", str(ROOT / "data/objects/child.ply")), f"  - {{name: a, {item}}}\n"),
        )
        alone.append(evaluate(loaded, rig_of(loaded)).return_counts["a"])
    every = "".join(f"  - {{name: {name}, {item}}}\n" for name, item in zip("abcd", items, strict=True))
    loaded = study(tmp_path, change=(before.replace("MESH", str(ROOT / "data/objects/child.ply")), every))
    counted = []
    told = []
    real = return_counts_module.returns
    monkeypatch.setattr(
        return_counts_module, "returns", lambda places, *a, **k: counted.append(len(places)) or real(places, *a, **k)
    )
    found = evaluate(loaded, rig_of(loaded), on_progress=told.append).return_counts
    assert list(found) == list("abcd")
    for one, other in zip(found.values(), alone, strict=True):
        assert one.detection == other.detection
        for name in ("worst", "mean", "probability"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
    assert found["a"].detection.rate < found["b"].detection.rate
    assert counted == [len(found[name].target.places) for name in "acd"]
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert len(told) == sum(-(-count // 64) for count in counted)


def test_more_places_than_memory_holds_are_refused_with_the_figure(tmp_path, monkeypatch):
    """By hand: 36 × 24 places at two headings; then what of them is free, to two sensors in four phases."""
    step = ("step_m: 1.5", "step_m: 0.5")
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 36 * 24 * 2 * 150 - 1.0)
    with pytest.raises(LidarcfgError, match=r"crate, with 1,728 places, needs .* memory; .*; give a larger step_m"):
        study(tmp_path, change=step)
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 36 * 24 * 2 * 150 + 1.0)
    loaded = study(tmp_path, change=step)
    rig = rig_of(loaded)
    one = loaded.detection_targets[0]
    sensors = scanners_of(rig.mounts)
    lidars = rig_lidars(rig)
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 8 * 2 * 4 * len(one.places) - 1.0)
    with pytest.raises(LidarcfgError, match=r"counting the returns at 1,\d+ places to 2 sensors needs .* memory"):
        return_counts_module.return_counts([one], sensors, lidars, loaded.obstacles)
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 8 * 2 * 4 * len(one.places) + 1.0)
    assert len(return_counts_module.return_counts([one], sensors, lidars, loaded.obstacles)) == 1
