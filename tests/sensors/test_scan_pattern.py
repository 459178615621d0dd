"""Scan patterns: tables of firings, beside sensors with beams that fire alike, Open3D's rays and plain loops."""

import math
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
import yaml

from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.errors import LidarcfgError
from lidarcfg.packets.families import timing
from lidarcfg.requirements.scenarios.file import load_scenario
from lidarcfg.requirements.scenarios.run import Rule, check_scenario
from lidarcfg.returns.beams import passing_beams
from lidarcfg.returns.counts import returns
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.scanners import PHASES, compiled, scanner
from lidarcfg.returns.target import Target
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.sensors.scan_pattern import load_scan_pattern
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.study.loading import load_study
from lidarcfg.vsr.cones import poses as sensor_poses
from lidarcfg.world.tracer import NO_OBSTACLES
from lidarcfg.world.vehicle import load_vehicle
from tests.capture_fixtures import no_warning
from tests.command_line import lidarcfg
from tests.naive import returns as naive
from tests.refusals import refused
from tests.returns_cases import at_place, box, lidars, mount, obstacles

ELEVATION_DEG = 9.0, -12.0, 3.0, -4.0
OFFSET_NS = 0, 20_000, 45_000, 90_000
STEP_NS = 200_000
STEPS = 500
FRAME_NS = 100_000_000
COLUMNS = "time_ns", "azimuth_deg", "elevation_deg", "channel"
TARGET = Target(box(1.8, 0.6, 1.75))
POSES = ((0.4, 0.1, 1.9), (3, 5, 170))


def write(folder, rows, frame_ms=100.0, name="own", suffix="csv", **sensor):
    """A sensor whose pattern has rows (F, 4), beside its file."""
    rows = np.asarray(rows, np.float64)
    if suffix == "csv":
        lines = [",".join(f"{value:.17g}" for value in row) for row in rows]
        (folder / f"{name}.csv").write_text("\n".join([",".join(COLUMNS), *lines, ""]))
    else:
        np.savez(folder / f"{name}.npz", **dict(zip(COLUMNS, rows.T, strict=True)))
    path = folder / f"{name}.yaml"
    values = {"name": name, "range": {"min_m": 0.5, "max_m": 60}} | sensor
    path.write_text(yaml.safe_dump(values | {"scan_pattern": {"file": f"{name}.{suffix}", "frame_ms": frame_ms}}))
    return path


def turning(frames):
    """What four lasers of a head that turns at 600 rpm fire, frame by frame a quarter of a step further."""
    rows = []
    for frame in range(frames):
        for step in range(STEPS):
            for laser, offset_ns in enumerate(OFFSET_NS):
                turned_ns = frame * STEP_NS / PHASES + step * STEP_NS + offset_ns
                when_ns = frame * FRAME_NS + step * STEP_NS + offset_ns
                rows.append((when_ns, turned_ns / FRAME_NS * 360 % 360, ELEVATION_DEG[laser], laser))
    return rows


def rosette(count, rng):
    """Firings of two channels anywhere in a cone ahead, and a little behind it."""
    around = rng.uniform(0, 2 * np.pi, count)
    away = 35 * np.sqrt(rng.uniform(0, 1, count))
    time_ns = np.sort(rng.integers(0, 3 * FRAME_NS, count))
    channel = np.arange(count) % 2
    return np.stack([time_ns, away * np.cos(around), away * np.sin(around), channel], axis=1)


@pytest.fixture
def twins(tmp_path):
    """A sensor with beams, and one whose pattern fires the same; four frames, or only the first."""
    beams = {"elevation_deg": list(ELEVATION_DEG)}
    head = {"name": "head", "beams": beams, "range": {"min_m": 0.5, "max_m": 60}}
    head["firing"] = {"sequence_ns": STEP_NS, "offset_ns": list(OFFSET_NS)}
    (tmp_path / "head.yaml").write_text(yaml.safe_dump(head))
    return tmp_path / "head.yaml", write(tmp_path, turning(4)), write(tmp_path, turning(1), name="one", suffix="npz")


def test_counts_are_those_of_a_head_that_turns(twins):
    """Phase by phase: the frames start where the revolutions' phases do."""
    rng = np.random.default_rng(5)
    far, angle, heading = rng.uniform((3, 0, 0), (25, 2 * np.pi, 2 * np.pi), (150, 3)).T
    places = np.stack([far * np.cos(angle), far * np.sin(angle), 0 * far, heading], axis=1)
    both = [mount(str(path), *POSES) for path in twins[:2]]
    scanners = compiled([scanner(one) for one in both])
    found = returns(places, TARGET, scanners, sensor_poses(lidars(both)))
    assert found.phases == (PHASES, PHASES)
    np.testing.assert_array_equal(found.counts[:, 0], found.counts[:, 1])
    assert found.counts.sum() > 5000
    for place in places[:3]:
        for phase in range(PHASES):
            head, still = (passing_beams(place, TARGET, one, phase, NO_OBSTACLES) for one in both)
            assert head.returns == still.returns
    single = mount(str(twins[2]), *POSES)
    alone = returns(places, TARGET, compiled([scanner(single)]), sensor_poses(lidars([single])))
    assert alone.phases == (1,)  # each frame is like the others
    np.testing.assert_array_equal(alone.counts[:, 0, 0], found.counts[:, 0, 0])


def test_points_are_those_of_a_head_that_turns(twins, tmp_path):
    """With noise, motion and a body of the vehicle in the way; frame by frame, from one csv and one npz."""
    (tmp_path / "scene.yaml").write_text(
        "name: wall\nground: {reflectivity: 30}\n"
        "boxes: [{name: wall, size_m: [1, 20, 6], center_m: [12, 0, 3], reflectivity: 50}]\n"
    )
    clouds = []
    for path in (twins[0], twins[2]):
        one = {"name": "a", "model": path.name, "position_m": [0.4, 0.1, 1.9], "rpy_deg": [3, 5, 170]}
        one["realism"] = {"seed": 7, "range_noise_m": 0.02, "dropout_fraction": 0.1}
        body = {"boxes": [{"name": "body", "size_m": [4, 1.8, 1.4], "center_m": [0, 0, 0.9]}]}
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"name": "one", "sensors": [one], "vehicle": body}))
        words = "export", "rig.yaml", "--scene", "scene.yaml", "--trajectory", "drive.yaml", "--duration", 0.25
        (tmp_path / "drive.yaml").write_text("arc: {speed_m_s: 5, yaw_rate_deg_s: 20}\n")
        lidarcfg(*words, "-o", "a.npz", cwd=tmp_path)
        clouds.append(load_cloud(tmp_path / "a.npz", no_warning))
    head, still = clouds
    lowest = np.argsort(np.argsort(ELEVATION_DEG))
    one, other = (np.lexsort((ring, cloud.time_ns)) for cloud, ring in ((head, head.ring), (still, lowest[still.ring])))
    assert len(head.time_ns) == len(still.time_ns) > 2000
    np.testing.assert_array_equal(head.time_ns[one], still.time_ns[other])
    np.testing.assert_array_equal(head.ring[one], lowest[still.ring[other]])
    np.testing.assert_array_equal(head.object[one], still.object[other])
    np.testing.assert_allclose(head.xyz[one], still.xyz[other], atol=1e-5)


def rows_of_phase(rows, frame_ns, phase):
    """The rows of the frame that starts phase / PHASES into a pattern, by a plain loop; the pattern repeats."""
    period_ns = (int(rows[-1][0]) // frame_ns + 1) * frame_ns
    start_ns = phase * period_ns // PHASES
    twice = [(when + again * period_ns, *rest) for again in (0, 1) for when, *rest in rows]
    return [row for row in twice if start_ns <= row[0] < start_ns + frame_ns]


def directions(rows):
    """(N, 3) the directions of rows in the sensor's frame: azimuths go clockwise."""
    azimuth, elevation = np.radians(np.array(rows)[:, 1:3]).T
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), -flat * np.sin(azimuth), np.sin(elevation)], axis=1)


def test_counts_are_those_of_open3d_and_of_plain_loops(tmp_path):
    """Of a rosette of three frames, at any attitude and in a field of view; the vehicle's body stands in the way."""
    rows = rosette(2400, np.random.default_rng(4)).tolist()
    path = write(tmp_path, rows)
    one = mount(str(path), (1.0, 0.2, 1.6), (10, 5, 30), fov_deg=(330.0, 25.0))
    rng = np.random.default_rng(8)
    far, angle, heading = rng.uniform((4, -0.4, 0), (9, 1.4, 6), (12, 3)).T
    places = np.stack([far * np.cos(angle), far * np.sin(angle), 0 * far, heading], axis=1)
    body = box(1.0, 0.4, 0.7)
    body = body[0] + (2.5, 0.6, 0.9), body[1]
    way = obstacles(body)
    found = returns(places, TARGET, compiled([scanner(one)]), sensor_poses(lidars([one])), way)
    assert found.phases == (PHASES,)
    seen = []
    for phase in range(PHASES):
        some = [row for row in rows_of_phase(rows, FRAME_NS, phase) if (row[1] - 330) % 360 <= 55]
        ways = directions(some)
        turned = np.array([naive.turned(*one.rpy_rad, way) for way in ways])
        rays = np.concatenate([np.tile(one.position_m, (len(some), 1)), turned], axis=1)
        for p, place in enumerate(places):
            meshes = [at_place(TARGET.mesh, place), body]
            scene = o3d.t.geometry.RaycastingScene()
            for vertices, triangles in meshes:
                scene.add_triangles(np.float32(vertices), np.uint32(triangles))
            hits = scene.cast_rays(np.float32(rays))
            of_it = (hits["geometry_ids"].numpy() == 0) & (hits["t_hit"].numpy() >= 0.5)
            assert abs(found.counts[p, 0, phase] - of_it.sum()) <= 1  # rays in single precision
            seen.append(of_it.sum())
            if p < 2:
                corners = [vertices[triangles] for vertices, triangles in meshes]
                loops = sum(
                    0.5 <= naive.hit_m(ray[:3], ray[3:], corners[0]) < naive.hit_m(ray[:3], ray[3:], corners[1])
                    for ray in rays
                )
                assert found.counts[p, 0, phase] == loops
            beams = passing_beams(place, TARGET, one, phase, way)
            assert beams.returns == found.counts[p, 0, phase]
    assert sum(seen) > 300
    assert np.ptp(found.counts[:, 0], axis=1).max() > 0
    lowest = lowest_at(places, TARGET, [one], way, 1000, 1)
    np.testing.assert_array_equal(lowest.counts[:, 0], found.counts[:, 0].min(axis=1))


def test_frames_walk_through_a_pattern(tmp_path):
    rows = [(0, 0, 0, 0), (40, 1, 0, 0), (120, 2, 0, 0), (250, 3, 0, 0)]
    pattern = load_scan_pattern(write(tmp_path, rows).with_suffix(".csv"), 100)
    assert (pattern.frames, pattern.period_ns, pattern.channels) == (3, 300, 1)
    times_ns = [again * 300 + row[0] for again in range(4) for row in rows]
    for elapsed_ns in range(0, 1200, 7):
        assert pattern.count_before(elapsed_ns) == sum(when < elapsed_ns for when in times_ns)
    found_ns, found = pattern.walk(3, 10)
    assert found_ns.tolist() == times_ns[3:10]
    assert found.tolist() == [3, 0, 1, 2, 3, 0, 1]
    assert pattern.azimuth_fov_deg == pytest.approx((0.0, 3.0), abs=0.0101)
    around = write(tmp_path, [(n, n * 9, 0, 0) for n in range(40)], name="around").with_suffix(".csv")
    assert load_scan_pattern(around, 100).azimuth_fov_deg is None
    behind = write(tmp_path, [(n, 170.5 + n, 0, 0) for n in range(20)], name="behind").with_suffix(".csv")
    assert load_scan_pattern(behind, 100).azimuth_fov_deg == pytest.approx((170.5, 189.5), abs=0.0101)


def test_the_same_from_csv_and_npz(tmp_path):
    rows = rosette(300, np.random.default_rng(2))
    one, other = (load_sensor(write(tmp_path, rows, suffix=suffix)) for suffix in ("csv", "npz"))
    assert one.pattern == other.pattern
    assert one == load_sensor(write(tmp_path, rows, suffix="csv")).model_copy(update={"scan_pattern": one.scan_pattern})
    assert one.elevation_span_deg == pytest.approx((rows[:, 2].min(), rows[:, 2].max()))
    np.testing.assert_allclose(np.degrees(one.pattern.azimuth_rad), rows[:, 1], rtol=1e-12)


GOOD = [(0, 0, 0, 0), (10, 5, 1, 1), (20, 10, 2, 0)]


@pytest.mark.parametrize(
    ("rows", "what"),
    [
        ([(0, 0, 0, 0), (20, 0, 0, 0), (10, 0, 0, 0)], "own.csv:4:1: time_ns: 10 comes after 20; allowed: ascending"),
        (
            [(-5, 0, 0, 0), (0, 0, 0, 0)],
            "own.csv:2:1: time_ns: -5 is not allowed; allowed: whole numbers from 0 to 1,0",
        ),
        ([(0.5, 0, 0, 0)], "own.csv:2:1: time_ns: 0.5 is not allowed; allowed: whole numbers from 0 to"),
        ([(0, math.nan, 0, 0)], "own.csv:2:1: azimuth_deg: nan is not allowed; allowed: -360 to 360"),
        (
            [(0, 0, 91, 0)] * 1000,
            "own.csv:2:1: elevation_deg: 91 is not allowed; allowed: -90 to 90; so are 1,000 rows",
        ),
        ([(0, 0, math.inf, 0)], "own.csv:2:1: elevation_deg: inf is not allowed"),
        ([(0, 0, 0, 0), (1, 0, 0, 2)], "own.csv: channel: 1 has no firings; allowed: channels 0 to 2, each with some"),
        ([(0, 0, 0, 256)], "own.csv:2:1: channel: 256 is not allowed; allowed: whole numbers from 0 to 255"),
        (np.empty((0, 4)), "own.csv: has 0 firings; allowed: 1 to 10,000,000"),
    ],
)
def test_rows_that_are_refused(tmp_path, rows, what):
    """At the key that names the table, with the line; as an .npz with the index."""
    path = write(tmp_path, rows)
    with refused(f"scan_pattern.file: {tmp_path / what}", at=r"own.yaml:\d+:\d+: "):
        load_sensor(path)
    if ":1: " in what:
        row = int(what.split(":")[1]) - 2
        key = what.split(": ")[1]
        with refused(f"{tmp_path}/own.npz: {key}[{row}]: {what.split(': ', 2)[2]}"):
            load_sensor(write(tmp_path, rows, suffix="npz"))


@pytest.mark.parametrize(
    ("table", "what"),
    [
        ("time_ns,azimuth_deg,channel\n0,0,0\n", "own.csv: missing: elevation_deg; allowed: the columns time_ns, az"),
        (
            "time_ns,azimuth_deg,elevation_deg,channel\n0,0,0\n",
            "own.csv:2:1: '0,0,0' is no firing; allowed: a number for",
        ),
        ("time_ns,azimuth_deg,elevation_deg,channel\n0,0,0,0\n\n1,0,0,0\n", "own.csv:3:1: '' is no firing"),
        ("time_ns,azimuth_deg,elevation_deg,channel\n0,0,up,0\n", "own.csv:2:1: '0,0,up,0' is no firing"),
        ("", "own.csv: missing: time_ns, azimuth_deg, elevation_deg, channel"),
        (b"\xff\xfe\x00", "own.csv: not text in UTF-8"),
        (None, "own.csv: no such file or directory"),
    ],
)
def test_tables_that_are_refused(tmp_path, table, what):
    path = write(tmp_path, GOOD)
    if table is None:
        (tmp_path / "own.csv").unlink()
    else:
        (tmp_path / "own.csv").write_bytes(table if isinstance(table, bytes) else table.encode())
    with refused(f"scan_pattern.file: {tmp_path / what}"):
        load_sensor(path)


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"scan_pattern": {"file": "own.txt", "frame_ms": 100}}, "own.txt: is no scan pattern; allowed: .csv, .npz"),
        ({"scan_pattern": {"file": "own.csv", "frame_ms": 0}}, "scan_pattern.frame_ms: 0 is too small; allowed: at least 0.1"),
        ({"scan_pattern": {"file": "own.csv"}}, "scan_pattern.frame_ms: missing"),
        ({"beams": {"elevation_deg": [1]}}, "beams: conflicts with scan_pattern"),
        ({"rotation": {"rpm_min": 300, "rpm_max": 600}}, "rotation: conflicts with scan_pattern"),
        ({"firing": {"step_deg": 1}}, "firing: conflicts with scan_pattern"),
    ],
)  # fmt: skip
def test_files_that_are_refused(tmp_path, values, what):
    path = write(tmp_path, GOOD)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | values))
    with refused(what):
        load_sensor(path)


def test_arrays_that_are_refused(tmp_path):
    path = write(tmp_path, GOOD, suffix="npz")
    table = tmp_path / "own.npz"
    columns = dict(np.load(table))
    for changed, what in (
        ({"channel": np.zeros(2)}, "own.npz: channel: has 2 values; time_ns has 3"),
        (
            {"azimuth_deg": np.zeros((3, 1))},
            "own.npz: azimuth_deg: has 2 axes of float64; allowed: one axis of numbers",
        ),
        ({"azimuth_deg": np.array(["a"] * 3)}, "own.npz: azimuth_deg: has 1 axes of <U1"),
    ):
        np.savez(table, **columns | changed)
        with refused(what):
            load_sensor(path)
    table.write_text("time_ns,azimuth_deg\n")
    with refused("own.npz: not a whole npz file"):
        load_sensor(path)


def test_a_codec_of_beams_is_refused(tmp_path):
    sensor = load_sensor(write(tmp_path, GOOD, codec="velodyne", velodyne={}))
    with pytest.raises(LidarcfgError, match="sensor 'own' has no beams, which codec velodyne needs"):
        timing(sensor)


def rig_with(folder, sensor, **keys):
    one = {"name": "front", "model": str(sensor), "position_m": [2, 0, 1], **keys}
    (folder / "rig.yaml").write_text(yaml.safe_dump({"name": "own", "sensors": [one]}))
    return folder / "rig.yaml"


def test_mounts(tmp_path):
    """They have no head that turns; written and read back they are the same."""
    path = write(tmp_path, GOOD)
    for key, value in (("rpm", 600), ("phase_deg", 10)):
        with refused(f"sensors[0].{key}: own has a scan pattern and does not turn; remove the key"):
            load_rig(rig_with(tmp_path, path, **{key: value}))
    rig = load_rig(rig_with(tmp_path, path))
    assert rig.mounts[0].frame_ns == FRAME_NS
    save_rig(rig, tmp_path / "again.yaml")
    assert replace(load_rig(tmp_path / "again.yaml").mounts[0], settings=rig.mounts[0].settings) == rig.mounts[0]


STUDY = {"region": {"min_m": [0, -4, 0], "max_m": [12, 4, 2], "cuboid_m": [1, 1, 1]}}
BOUNDS = {"position_m": [1.8, 0, 1], "rpy_deg": [0, 0, -20]}, {"position_m": [2, 0, 1], "rpy_deg": [0, 20, 20]}
CHILD = {"name": "child", "size_m": [0.6, 0.6, 1.1], "step_m": 2, "returns": 5}
BY_CONES = {"name": "crate", "size_m": [1, 1, 1]}
PATTERN_HINT = "instead, detect objects by returns"


def study_with(folder, sensor, **keys):
    sensors = [{"model": str(sensor), "min": BOUNDS[0], "max": BOUNDS[1]}]
    (folder / "study.yaml").write_text(yaml.safe_dump(STUDY | {"sensors": sensors} | keys))
    return folder / "study.yaml"


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ({}, "objective: is max_vsr of cones of beams, and own has a scan pattern"),
        ({"objective": {"max_vsr": 1}}, "objective.max_vsr: is of cones of beams, and own has a scan pattern"),
        ({"objective": {"inscribed_radius": 1}}, "objective.inscribed_radius: is of cones of beams"),
        ({"detection": [BY_CONES]}, "detection[0]: counts subspaces of cones of beams, and own has a scan pattern"),
    ],
)
def test_what_needs_cones_says_what_to_use_instead(tmp_path, keys, what):
    own = write(tmp_path, GOOD)
    with refused(what, at=PATTERN_HINT):
        load_study(study_with(tmp_path, own, **keys))
    study_with(tmp_path, "vlp-16", **keys)
    rig_with(tmp_path, own)
    result = lidarcfg("evaluate", "study.yaml", "rig.yaml", cwd=tmp_path, code=2)
    assert PATTERN_HINT in result.stderr


def test_from_study_to_verdict(tmp_path):
    """By returns and by requirements; evaluated and verified."""
    rows = rosette(3000, np.random.default_rng(1))
    own = write(tmp_path, rows, suffix="npz")
    keys = {"objective": {"detection": {"child": 1}}, "detection": [CHILD], "solver": {"evaluations": 12, "seed": 1}}
    placement = optimize(study_with(tmp_path, own, **keys))
    save_rig(placement.rig, tmp_path / "found.yaml")
    said = lidarcfg("evaluate", "study.yaml", "found.yaml", cwd=tmp_path).stdout
    assert f"detection of child {1 - placement.objective:.4f}" in " ".join(said.split())
    assert "max VSR" not in said
    near = {"name": "near", "object": "child", "within_m": [5, 5.2], "sector_deg": [-2, 2], "returns": 1}
    body = {"boxes": [{"name": "body", "size_m": [1, 1, 0.6], "center_m": [1, 0, 0.4]}]}
    study_with(tmp_path, own, requirements=[near], vehicle=body)
    assert "PASS" in lidarcfg("verify", "study.yaml", "found.yaml", cwd=tmp_path).stdout


def test_a_scenario_is_that_of_a_head_that_turns(twins):
    """Frame by frame of a run the same points of the target."""
    sedan = load_vehicle("data/vehicles/sedan.ply")
    runs = []
    for path in (twins[0], twins[2]):
        one = mount(str(path), (0.4, 0.1, 1.9), (0, 3, 0))
        found = check_scenario(load_scenario("cpnco"), [one], sedan, speeds_km_h=[20], rule=Rule(returns=3))
        runs.append([(case.worst.start, case.worst.returns.tolist()) for case in found.cases])
    assert runs[0] == runs[1]
    assert all(sum(counts) > 20 for _, counts in runs[0])
