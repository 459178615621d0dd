"""Scenarios: geometry and braking by hand, sight by a shadow's line, and frames as an export of the same drive has them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg import core
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.config.models import loads
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import transform
from lidarcfg.requirements.scenarios import run as scenario_run
from lidarcfg.requirements.scenarios.approach import COMFORT, EMERGENCY, Approach, Braking, VehicleExtent
from lidarcfg.requirements.scenarios.file import ScenarioFile, load_scenario, presets, scenario_of
from lidarcfg.requirements.scenarios.run import Rule, ScenarioRun, check_scenario, drive_of, needed
from lidarcfg.requirements.scenarios.sight import earliest_sight, places_within
from lidarcfg.returns.counts import LOW_M
from lidarcfg.returns.target import ObjectFile
from lidarcfg.sensors.rig import Rig
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.boxes import boxed_objects
from lidarcfg.world.vehicle import load_vehicle
from tests.naive import scenario as naive
from tests.naive.requirements import largest_cluster
from tests.returns_cases import mount

SEDAN = "data/vehicles/sedan.ply"
CAR = VehicleExtent(front_m=2.4, rear_m=-2.4, right_m=-0.95, left_m=0.95)  # 1.9 m wide


@pytest.fixture(scope="module")
def sedan():
    return load_vehicle(SEDAN)


def two(model="vlp-16", **more):
    return [
        replace(mount(model, (0.3, 0.5, 1.9), (-5, 3, 0), **more), name="left"),
        replace(mount(model, (2.45, -0.7, 0.6), (0, 0, 0), **more), name="bumper"),
    ]


def approach(name="cpnco", speed_km_h=30.0, impact=0.5, lead_s=6.0, extent=CAR):
    return Approach(load_scenario(name), extent, speed_km_h, impact, lead_s)


@pytest.mark.parametrize(
    ("speed_km_h", "distance_m"),
    [(10, 6.1), (20, 12.7), (30, 21.9), (40, 33.7), (50, 48.0), (60, 65.0), (80, 106.5)],
)
def test_the_distance_that_autoware_needs(speed_km_h, distance_m):
    """v t + v²/(2a) + offset with 1 s, 3 m/s² and 2 m, by hand."""
    assert COMFORT.distance_m(speed_km_h / 3.6) == pytest.approx(distance_m, abs=0.05)


def test_braking_by_hand():
    """60 km/h: 16.67 · 0.3 + 16.67² / 16 = 22.4 m; behind a walker at 5 km/h the closing speed counts."""
    assert EMERGENCY.distance_m(60 / 3.6) == pytest.approx(22.4, abs=0.05)
    assert EMERGENCY.distance_m(65 / 3.6, 5 / 3.6) == pytest.approx(EMERGENCY.distance_m(60 / 3.6))
    # Autoware's object brakes with 1 m/s², so it goes on for 1.389² / 2 = 0.96 m
    assert COMFORT.distance_m(60 / 3.6, 5 / 3.6) == pytest.approx(65.0 - 0.96, abs=0.05)


@pytest.mark.parametrize(("speed_km_h", "ahead_km_h"), [(10, 0), (60, 0), (30, 5)])
def test_the_last_moment_stops_just_in_time(speed_km_h, ahead_km_h):
    """A vehicle that is stepped forwards in time stops at the target, and not if it brakes a hundredth later."""
    one = approach("cpla" if ahead_km_h else "cpna", speed_km_h)
    braking = Braking(reaction_s=0.4, deceleration_m_s2=6.0, offset_m=0.5)
    by_steps = naive.last_moment(speed_km_h / 3.6, 0.4, 6.0, 0.5, ahead_km_h / 3.6)
    assert needed(one, braking) == pytest.approx(by_steps, abs=0.02)


@pytest.mark.parametrize("name", ["cpna", "cpfa", "cpnco"])
@pytest.mark.parametrize("impact", [0.25, 0.5])
def test_where_the_target_is(name, impact):
    """At any time, beside a walk that is stepped; and the scene's object is there, too."""
    one = approach(name, impact=impact)
    path = one.scenario.file.path
    inward = 1 if path.crosses_from == "right" else -1
    place_m = (impact - 0.5) * 1.9
    way_m = path.start_m + inward * place_m
    (target,) = (box for box in boxed_objects(one.scene) if box.name == "target")
    for seconds in (0.0, 1.3, 2.5, 2.9, 3.4, 4.5, 5.99):
        left_m = naive.walked(way_m, path.gain_m, path.speed_km_h / 3.6, 6.0 - seconds)
        wanted = [2.4 + 30 / 3.6 * 6.0, place_m - inward * left_m]
        np.testing.assert_allclose(one.target_m(seconds), wanted, atol=0.003)
        T = target.pose(seconds)
        np.testing.assert_allclose(T[:2, 3], one.target_m(seconds), atol=0.001)
        np.testing.assert_allclose(T[:3, :3] @ [1, 0, 0], [0, inward, 0], atol=1e-12)  # it looks where it walks


def test_parked_cars_by_hand():
    """Of CPNCO: sides 1 m from the vehicle's, the small one's front 1 m before the child's nearer side."""
    one = approach(speed_km_h=10)
    line = 2.4 + 10 / 3.6 * 6
    small, large = (one.car_m(car) for car in one.scenario.file.cars)
    np.testing.assert_allclose(small, [line - 0.149 - 1 - 4.316 / 2, -0.95 - 1 - 1.79 / 2, 1.48 / 2])
    np.testing.assert_allclose(large, [line - 0.149 - 1 - 4.316 - 1 - 4.418 / 2, -0.95 - 1 - 1.82 / 2, 1.533 / 2])


def test_a_target_ahead_is_touched_at_its_nearer_end():
    """A car of 4.023 m at rest, whose middle is half its length beyond the front at the impact; behind: mirrored."""
    assert approach("ccrs", 36.0).target_m(1.0).tolist() == pytest.approx([2.4 + 60 + 4.023 / 2, 0.0])
    ahead = approach("cpla", 36.0)
    assert ahead.target_m(6.0)[0] - ahead.target_m(5.0)[0] == pytest.approx(5 / 3.6)
    assert ahead.gap_m(4.0) == pytest.approx((10 - 5 / 3.6) * 2)
    behind = approach("cpra-child", 3.6)
    assert behind.target_m(0.0).tolist() == pytest.approx([-2.4 - 6 - 0.711 / 2, 0.0])
    assert behind.motion.velocity_m_s == pytest.approx((-1.0, 0.0, 0.0))


def test_when_the_child_shows():
    """By the line from an eye at the front's far end over the parked car's corner to the child's leading face.

    In the middle of the child's width it shows at 6.0 m at 10 km/h and at 29 m at 60 km/h; its far edge a little earlier.
    """

    def by_hand(speed_km_h, beyond_m):
        corner_m = 1.149 + beyond_m
        return naive.shows(speed_km_h / 3.6, 5 / 3.6, 0.3555, (beyond_m, corner_m), 1.95, 0.95, 4.0, 1.0)

    assert by_hand(10, 0.0) == pytest.approx(6.0, abs=0.05)
    assert by_hand(60, 0.0) == pytest.approx(29.0, abs=0.2)
    front = places_within([(np.array([2.4, -0.95, 0.3]), np.array([2.4, 0.95, 1.2]))])
    for speed_km_h in (10, 30, 60):
        one = approach(speed_km_h=speed_km_h)
        seen = earliest_sight(one, 6.0 - needed(one, EMERGENCY), front, None)
        assert one.gap_m(seen.seconds) == pytest.approx(by_hand(speed_km_h, 0.149), abs=0.12)
        assert (seen.places, seen.points) == (len(front), 88)


def test_a_walker_in_the_open_is_seen_from_the_start(sedan):
    roof = places_within([(np.array([-0.6, -0.5, 1.65]), np.array([0.6, 0.5, 1.9]))], sedan)
    one = approach("cpna")
    assert earliest_sight(one, 4.0, roof, sedan).seconds == 0.0
    inside = places_within([(np.array([0.0, 0.0, 0.8]), np.array([0.0, 0.0, 0.8]))], sedan)
    assert earliest_sight(one, 4.0, inside, sedan).seconds is None  # no place is left


def run_of(returns, needed_s=0.45, demanded=10):
    """A run of frames of 0.1 s to an impact after a second."""
    one = replace(approach("cpna"), lead_s=1.0)
    return ScenarioRun(one, 0, (), 0.1, needed_s, demanded, np.array(returns))


@pytest.mark.parametrize(
    ("returns", "detected_s", "margin_s", "shortfall"),
    [
        ([0, 0, 10, 12, 15, 0, 0, 0, 0, 0], 0.3, 0.25, 0.0),  # frames end at 0.1 …; the last moment is at 0.55
        ([10, 10, 10, 9, 15, 0, 0, 0, 0, 0], 0.5, 0.05, 0.0),  # a gap starts it anew
        ([10] * 10, 0.1, 0.45, 0.0),
        ([10, 10, 10, 10, 9, 9, 9, 10, 9, 9], 0.8, -0.25, 0.25 / 0.45),  # too late
        ([10, 10, 10, 10, 9, 9, 9, 9, 9, 9], None, -0.45, 1.0),  # never, once it matters
    ],
)
def test_the_frames_that_count(returns, detected_s, margin_s, shortfall):
    one = run_of(returns)
    assert one.detected_s == (pytest.approx(detected_s) if detected_s else None)
    assert one.margin_s == pytest.approx(margin_s)
    assert one.shortfall == pytest.approx(shortfall)


def exported(one, mounts, vehicle, duration_ns, frame_ns):
    """(frames, sensors) the records of the target in an export of the drive."""
    records = []
    drive = drive_of(one, mounts, vehicle)
    streams = simulated_packets(
        Rig("r", tuple(mounts)), one.scene, drive.trajectory, duration_ns, on_truth=records.append, vehicle=vehicle
    )
    assert sum(len(some.records) for some in in_time_order(streams)) > 0
    truth = np.concatenate(records)
    truth = truth[truth["object"] == one.scene.names.index("target")]
    number = (truth["time_ns"] - START_NS) // frame_ns
    counts = np.zeros((duration_ns // frame_ns, len(mounts)), int)
    np.add.at(counts, (number[number < len(counts)], truth["sensor"][number < len(counts)]), 1)
    return counts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "models", "speed_km_h", "rpms"),
    [
        ("cpnco", ("vlp-16", "vlp-16"), 50.0, (600.0, 1200.0)),
        ("cpnco", ("pandar-xt32", "os1-32"), 60.0, (600.0, 600.0)),
        ("cpra-child", ("helios-16p", "vlp-32c"), 8.0, (600.0, 600.0)),
    ],
)
def test_frames_are_an_exports(name, models, speed_km_h, rpms, sedan):
    """The same counts of the target in every frame, sensor by sensor, at two starts; clusters no more than all."""
    where = ((0.3, 0.5, 1.9), (-5, 3, 0)), ((-2.5 if "cpra" in name else 2.45, -0.7, 0.6), (0, 0, 0))
    mounts = [
        replace(mount(model, *place, rpm=rpm), name=f"s{n}", host=f"192.168.1.{n + 1}")
        for n, (model, place, rpm) in enumerate(zip(models, where, rpms, strict=True))
    ]
    scenario = load_scenario(name)
    scenario = replace(scenario, file=scenario.file.model_copy(update={"before_impact_s": 2.4, "from_m": None}))
    found = check_scenario(scenario, mounts, sedan, speeds_km_h=[speed_km_h], losses=(0, 1))
    (case,) = found.cases
    for run in case.runs:
        if run.start in (0, 3) and len(run.lost) == 1:
            kept = [n for n in range(2) if n not in run.lost]
            counts = exported(run.approach, mounts, sedan, 23 * SECOND_NS // 10, SECOND_NS // 10)[:22]
            assert counts[:, kept].sum() > 20
            np.testing.assert_array_equal(run.returns[:22], counts[:, kept].sum(axis=1))
    whole = [run for run in case.runs if not run.lost and run.start == 3]
    np.testing.assert_array_equal(whole[0].returns[:22], counts.sum(axis=1))
    clustered = check_scenario(scenario, mounts, sedan, speeds_km_h=[speed_km_h], rule=Rule(10, 0.15))
    for run in clustered.cases[0].runs:
        (plain,) = (other for other in case.runs if other.start == run.start and not other.lost)
        assert (run.returns <= plain.returns).all()
    assert clustered.shortfall >= found.shortfall or found.shortfall > 0


@pytest.mark.slow
def test_skipping_beams_changes_nothing(sedan, monkeypatch):
    """All beams are fired: the same returns."""
    scenario = load_scenario("cpnco")
    scenario = replace(scenario, file=scenario.file.model_copy(update={"before_impact_s": 2.0}))
    few = check_scenario(scenario, two(), sedan, speeds_km_h=[40])
    everything = lambda approach, range_m, frame, middle_s, frame_ns: np.arange(len(frame.starts_m))  # noqa: E731
    monkeypatch.setattr(scenario_run, "_may_hit", everything)
    whole = check_scenario(scenario, two(), sedan, speeds_km_h=[40])
    for one, other in zip(few.cases[0].runs, whole.cases[0].runs, strict=True):
        np.testing.assert_array_equal(one.returns, other.returns)
        assert one.returns.sum() > 100


def test_clusters():
    """Three in a chain, one apart; low ones are none; beside a search point by point."""
    chain = np.array([[0, 0, 0.5], [0.1, 0, 0.5], [0.2, 0, 0.5], [0.5, 0, 0.5]])
    assert core.returns.largest_cluster(chain, 0.15, LOW_M) == 3
    assert core.returns.largest_cluster(chain * [1, 1, 0.1], 0.15, LOW_M) == 0
    rng = np.random.default_rng(5)
    for _ in range(20):
        points = rng.uniform(0, 0.8, (rng.integers(1, 60), 3))
        assert core.returns.largest_cluster(points, 0.15, LOW_M) == largest_cluster(points.tolist(), 0.15, LOW_M)
    for rows_m in (0.14, 0.16, 0.2):  # scan lines, dense along and sparse across
        lines = [rng.uniform(0, 1.2, 130).cumsum() * 0.003 for _ in range(4)]
        points = np.concatenate([np.stack([x, 0 * x, 0 * x + n * rows_m], axis=1) for n, x in enumerate(lines)])
        points += rng.uniform(-0.01, 0.01, points.shape)
        assert core.returns.largest_cluster(points, 0.15, LOW_M) == largest_cluster(points.tolist(), 0.15, LOW_M)


def test_points_are_on_the_target(sedan, monkeypatch):
    """What clusters are made of lies on the box's surface, where the target is when each beam is fired."""
    kept = []
    monkeypatch.setattr(
        scenario_run.TargetReturns,
        "add",
        lambda self, frame, sensor, points: kept.append((self, frame, sensor, points)),
    )
    scenario = load_scenario("cpnco")
    scenario = replace(scenario, file=scenario.file.model_copy(update={"before_impact_s": 1.5}))
    found = check_scenario(scenario, two(), sedan, speeds_km_h=[20])
    ways = {id(hits): None for hits, *_ in kept}
    (first, *_) = ways
    one = found.cases[0].runs[0].approach
    checked = 0
    for hits, frame, _, points in kept:
        if id(hits) == first and len(points):
            middle = one.target_m((frame + 0.5) * 0.1)
            apart = abs(points - [*middle, 1.154 / 2]) - np.array([0.298, 0.711, 1.154]) / 2
            assert (apart.max(axis=1) < 0.05 * 5 / 3.6 + 1e-6).all()
            assert (apart.max(axis=1) > -0.05 * 5 / 3.6 - 1e-6).all()
            checked += len(points)
    assert checked > 1000


@pytest.mark.slow
def test_all_presets_are_whole(sedan, request):
    """Each is read, says where it is from, and is checked at a speed: ahead and behind always, all by night."""
    names = set(presets())
    assert {"cpna", "cpfa", "cpnco", "cpla", "ccrs", "cpra-adult", "cpra-child"} <= names
    rear = [replace(mount("vlp-16", (x, 0.0, 0.6), (0, 0, 0)), name=f"s{x}") for x in (-2.5, 2.5)]
    for name in names:
        scenario = load_scenario(name)
        assert "ee7aa11" in scenario.file.source
        assert scenario.file.about
        if name not in ("cpna", "cpra-adult") and not request.config.getoption("nightly"):
            continue
        speed = 8.0 if scenario.file.backwards else 60.0
        quick = scenario.file.model_copy(update={"impacts": (0.5,)})
        found = check_scenario(replace(scenario, file=quick), rear, sedan, speeds_km_h=[speed])
        assert found.worst.sight_margin_s > 0
        assert found.worst.worst.margin_s <= found.worst.sight_margin_s


@pytest.mark.slow
def test_a_mesh_is_a_target(sedan):
    """The child of data/objects instead of the box, which is larger: fewer returns, at the same place."""
    scenario = load_scenario("cpra-child")
    mesh = scenario_of(scenario.file, ObjectFile(name="child"), Path())
    rear = [mount("vlp-16", (-2.5, 0.0, 0.6), (0, 0, 0))]
    box, child = (check_scenario(one, rear, sedan, speeds_km_h=[8]) for one in (scenario, mesh))
    runs = box.cases[0].runs[0], child.cases[0].runs[0]
    assert 0 < runs[1].returns.sum() < runs[0].returns.sum()
    scene = runs[1].approach.scene
    corners = scene.vertices_m[scene.triangles[scene.triangle_object == scene.names.index("target")]].reshape(-1, 3)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert corners[:, 0].max() == pytest.approx(runs[1].approach.contact_m, abs=1e-6)
    own = transform(np.eye(4), corners)
    assert own[:, 1].min() == pytest.approx(-own[:, 1].max(), abs=1e-6)


FILE = "name: s\nspeeds_km_h: [30]\ntarget: child\npath: {crosses_from: right, speed_km_h: 5, start_m: 4}\n"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("[30]", "[0]"), "s.yaml:2:15: speeds_km_h[0]: 0 is too small; allowed: above 0"),
        (("[30]", "[1000]"), "1000 is too large; allowed: at most 300"),
        (("[30]", "[]"), "speeds_km_h: has 0 values; allowed: at least 1"),
        (("target: child\n", ""), "s.yaml:1:1: target: missing"),
        (("target: child", "target: {size_m: [1, 1, 0]}"), "too small; allowed: above 0"),
        (("target: child", "target: {name: child, size_m: [1, 1, 1]}"), "size_m: conflicts with name"),
        (("speed_km_h: 5, ", ""), "speed_km_h: missing; a target that crosses moves"),
        (("crosses_from: right, ", ""), "start_m: is for targets that cross; give crosses_from"),
        (("right", "above"), "'above' is not allowed; allowed: 'right' or 'left'"),
        (("name: s", "name: s\nimpacts: [2]"), "impacts[0]: 2 is too large; allowed: at most 1"),
        (("name: s", "name: s\nfrom_m: 10\nbefore_impact_s: 5"), "from_m: conflicts with before_impact_s"),
    ],
)
def test_wrong_files(wrong, said):
    assert loads(FILE, ScenarioFile, "s.yaml")
    with pytest.raises(ConfigError) as caught:
        loads(FILE.replace(*wrong), ScenarioFile, "s.yaml")
    assert said in str(caught.value)


def test_what_cannot_be_checked(sedan, tmp_path):
    """One line each: where, what, what is allowed."""

    def refused(call):
        with pytest.raises(ConfigError) as caught:
            call()
        assert "\n" not in str(caught.value)
        return str(caught.value)

    known = "ccrs, cpfa, cpla, cpna, cpnco, cpra-adult, cpra-adult-walking, cpra-child, cpra-child-walking"
    said = refused(lambda: load_scenario("cpxy"))
    assert said == f"no scenario is called 'cpxy'; allowed: {known}, or the path of a .yaml"
    (tmp_path / "s.yaml").write_text(FILE.replace("target: child", "target: giraffe"))
    assert "s.yaml:3:1: target: no object is called 'giraffe'; allowed: car, child" in refused(
        lambda: load_scenario("s.yaml", tmp_path)
    )
    nobody = refused(lambda: check_scenario(load_scenario("cpna"), two(), None))
    assert nobody == "a scenario needs the vehicle's body, whose front reaches the target; give vehicle"
    assert "has no speeds of its own; give speeds_km_h" in refused(
        lambda: check_scenario(load_scenario("ccrs"), two(), sedan)
    )
    assert "at 5 km/h: the target moves away as fast; allowed: more than 5" in refused(
        lambda: check_scenario(load_scenario("cpla"), two(), sedan, speeds_km_h=[5])
    )
    late = Braking(deceleration_m_s2=0.5)
    assert "braking begins" in refused(
        lambda: check_scenario(load_scenario("cpna"), two(), sedan, speeds_km_h=[60], braking=late)
    )
    assert "there is no sensor" in refused(lambda: check_scenario(load_scenario("cpna"), [], sedan))
