"""Where numbers go wrong: labels against 50 digits, odd poses and places, rays that graze, captures far away.

tools/stress.py runs the same cases by the million.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.geometry import inverse, pose, transform
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.search.optimize import optimize
from lidarcfg.search.run import Budget, SearchRun
from lidarcfg.sensors.rig import Rig
from lidarcfg.solvers import SOLVERS
from lidarcfg.solvers.bee_colony import BeeColony
from lidarcfg.solvers.search import of_objectives
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.study.criterion import Criterion
from lidarcfg.study.loading import load_study
from lidarcfg.study.terms.term import TermContext
from lidarcfg.vsr.cones import Lidar, gaps_at
from lidarcfg.vsr.metric import max_vsr, vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import beam_gaps, segment
from tests import oracle
from tests.capture_fixtures import PLY, datagrams_of, mount, no_warning, room, scene
from tests.packets.velodyne.shaped import decode, firings, packet_period_ns, rays
from tests.search.solvers.test_solvers import begun
from tests.vsr.test_grid import check

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
FAN = tuple(np.arange(-15.0, 16.0, 2.0))


def labels_of(region, lidars):
    """The labels, which rows and the direct evaluation agree on."""
    label = check(region, lidars)
    assert np.array_equal(segment(region, lidars).label, label)
    return label


# Labels against 50 digits


def test_labels_of_random_rigs():
    rng = np.random.default_rng(1)
    tally = oracle.Tally()
    for _ in range(25):
        edge = 10 ** rng.uniform(-2, 1, 3)
        low = rng.uniform(-1, 1, 3) * 10 ** rng.uniform(0, 4)
        region = Region(low, low + (12, 10, 8) * edge, np.ones((12, 10, 8), bool))
        position = low + rng.uniform(-0.5, 1.5, 3) * (12, 10, 8) * edge
        known, exact = oracle.sensor(position, oracle.angles(rng), oracle.FANS[rng.integers(3)])
        tally.add(exact, oracle.points_of(region), beam_gaps(region, known).ravel())
    assert tally.wrong_outside == 0


def test_labels_within_1e_15_of_a_cone():
    """Rows and single points agree there; what is on the wrong side is nearer than a quarter of the band."""
    rng = np.random.default_rng(2)
    tally = oracle.Tally()
    for _ in range(60):
        known, exact, points, along = oracle.along_a_cone(rng)
        line = oracle.Line(points, along)
        digit = beam_gaps(line, known).ravel()
        assert np.array_equal(digit, gaps_at(points, known))
        labels_of(line, [known])
        tally.add(exact, points, digit)
    assert tally.near > 2000
    assert tally.wrong_outside == 0
    assert 0 < tally.worst < 2


def test_the_oracle_sees_a_label_that_is_wrong():
    known, exact = oracle.sensor((0, 0, 0), (0, 0, 0), (30.0,))
    points = np.array([[1.0, 0, np.tan(np.pi / 6)], [1.0, 0, 0.5774], [1.0, 0, 0.5773]])
    tally = oracle.Tally()
    tally.add(exact, points, gaps_at(points, known))
    assert (tally.pairs, tally.near, tally.wrong_outside) == (3, 1, 0)
    tally.add(exact, points, np.array([0, 0, 1]))
    assert tally.wrong_outside == 2


@pytest.mark.parametrize("far", [0.0, 2.0**20, 1e7])
def test_ties_belong_above(far):
    """A centre on a cone counts as above it. Ties without rounding: a level beam, ±90°, the apex.

    (With whole numbers there are no others: h / d = m / 2^k needs a square 4^k m' that is a sum of three squares of
    which not all are even, and squares are 0 or 1 modulo 4.)
    """
    region = Region(np.full(3, far), np.full(3, far + 5.0), np.ones((5, 5, 5), bool))
    for sign in (1.0, -1.0):
        known = Lidar(np.full(3, far + 2.5), np.array([0, 0, sign]), np.array([-1.0, -0.5, 0.0, 0.5, 1.0]))
        digit = beam_gaps(region, known)
        labels_of(region, [known])
        assert digit[2, 2, 2] == 5  # the apex
        assert digit[0, 1, 2] == digit[4, 4, 2] == 3  # level
        assert digit[2, 2, :2].tolist() == ([1, 1] if sign > 0 else [5, 5])  # on the axis, below
        assert digit[2, 2, 3:].tolist() == ([5, 5] if sign > 0 else [1, 1])
        assert digit.min() == 1  # nothing lies below a beam at −90°


# Poses


@pytest.mark.parametrize("place", oracle.PLACES)
def test_odd_poses(place):
    rng = np.random.default_rng(3)
    region = Region.from_boxes((0, 0, 0), (6, 4, 2), (1, 0.5, 0.25), (((2, 1, 0), (3, 2, 1)),))
    points = oracle.points_of(region)
    tally = oracle.Tally()
    for angle in oracle.ANGLES:
        rpy = np.roll([angle, rng.choice(oracle.ANGLES), 0.3], rng.integers(3))
        known, exact = oracle.sensor(oracle.PLACES[place], rpy, oracle.FANS[1])
        assert np.linalg.norm(known.axis) == pytest.approx(1, abs=4e-16)
        tally.add(exact, points, beam_gaps(region, known).ravel())
        other, _ = oracle.sensor((1.3, 2.7, 1.1), rpy[::-1], FAN)
        label = labels_of(region, [known, other])
        vsr = vsr_m(segment(region, [known, other]))
        assert len(vsr) == label.max() + 1
        assert (vsr > 0).all()
    assert tally.wrong_outside == 0


@pytest.mark.parametrize("beside", [5e-324, 1e-300, 1e-170])
def test_so_near_that_squares_vanish_is_the_apex(beside):
    region = Region(np.full(3, -2.5), np.full(3, 2.5), np.ones((5, 5, 5), bool))
    known, _ = oracle.sensor((beside, -beside, beside), (0.1, 0.2, 0.3), FAN)
    assert beam_gaps(region, known)[2, 2, 2] == 16
    labels_of(region, [known])


@pytest.mark.parametrize("angle", [a for a in oracle.ANGLES if abs(abs(a) - oracle.TURN) < 1])
def test_a_turn_is_no_turn(angle):
    """2π as a double is 2.4e-16 short of a turn: no label of this region is that near to a cone."""
    region = Region.from_boxes((0, 0, 0), (6, 4, 2), (1, 0.5, 0.25))
    still, turned = (oracle.sensor((1.3, 2.7, 1.1), rpy, FAN)[0] for rpy in ((0.2, 0.1, 0), (0.2 + angle, 0.1, angle)))
    assert np.abs(still.axis - turned.axis).max() < 3e-15
    assert np.array_equal(beam_gaps(region, still), beam_gaps(region, turned))


# Scale and place


def moved(region, lidars, scale=1.0, by=(0.0, 0.0, 0.0)):
    """A region and LiDARs scaled, then moved."""
    by = np.array(by)
    return (
        Region(region.min_m * scale + by, region.max_m * scale + by, region.included),
        [replace(one, position_m=one.position_m * scale + by) for one in lidars],
    )


def some_rig(rng, count=3):
    positions = rng.uniform((1, 1, 0.5), (7, 5, 2.5), (count, 3))
    return [oracle.sensor(np.round(p * 256) / 256, oracle.angles(rng), FAN)[0] for p in positions]


def boxes():
    return Region.from_boxes((0, 0, 0), (8, 6, 3), (0.5, 0.5, 0.25), (((3, 2, 0), (5, 4, 3)),))


@pytest.mark.parametrize("by", [(1e7, -1e7, 1e7), (500_000, 5_400_000, 300), (-0.5, 2.0**23, 1.0)])
@pytest.mark.parametrize("scale", [2.0**-10, 1.0, 2.0**10])
def test_moved_and_scaled_without_rounding(scale, by):
    """Coordinates that stay exact: the same labels, bit for bit, and the scaled VSR."""
    if scale < 1:
        by = np.multiply(by, scale)
    region = boxes()
    lidars = some_rig(np.random.default_rng(4))
    before = segment(region, lidars)
    after = segment(*moved(region, lidars, scale, by))
    assert np.array_equal(before.label, after.label)
    assert np.array_equal(before.gap, after.gap)
    assert (vsr_m(before) * scale).tolist() == vsr_m(after).tolist()


@pytest.mark.parametrize("by", [(1e7 / 3, -1e7, 9_999_999.7), (0.1, 0.2, 0.3)])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_moved_and_scaled_with_rounding(scale, by):
    """Labels may differ only where the shift's own rounding reaches the cone."""
    rng = np.random.default_rng(5)
    compared = 0
    for _ in range(10):
        known, exact = oracle.sensor(rng.uniform((1, 1, 0.5), (7, 5, 2.5)), oracle.angles(rng), FAN)
        region = boxes()
        far, (other,) = moved(region, [known], scale, by)
        before = beam_gaps(region, known).ravel()
        after = beam_gaps(far, other).ravel()
        labels_of(far, [other])
        points = oracle.points_of(region)
        ulp = max(np.spacing(np.abs(far.min_m).max()), np.spacing(np.abs(far.max_m).max())) / scale
        for n in np.flatnonzero(before != after):
            nearest = min(abs(exact.above(points[n], beam)) for beam in range(len(FAN)))
            assert nearest <= oracle.BAND + 4 * ulp / np.linalg.norm(points[n] - known.position_m)
        compared += (before == after).sum()
        if np.array_equal(before, after):
            cost = max_vsr(far, [other])
            assert cost == pytest.approx(max_vsr(region, [known]) * scale, rel=1e-9 + 100 * ulp)
    assert compared > 0.999 * 10 * region.included.size


STUDY = """
region: {{min_m: [{x}, {y}, 0.1], max_m: [{x2}, {y2}, 3.1], cuboid_m: [0.6, 0.4, 0.2]}}
sensors:
  - {{elevation_deg: [-20, -8, 3, 12], count: 2, min: {{position_m: [{a}, {b}, 1.3], rpy_deg: [-20, -20, 0]}}, max: {{position_m: [{a}, {b}, 2.7], rpy_deg: [20, 20, 0]}}}}
solver: {{method: abc, bees: 6, cycles: 4, seed: 4}}
"""


def study_at(tmp_path, east, north):
    text = STUDY.format(x=east + 0.3, x2=east + 6.3, y=north + 0.7, y2=north + 4.7, a=east + 3.2, b=north + 2.6)
    path = tmp_path / "study.yaml"
    path.write_text(text)
    return load_study(path)


@pytest.mark.parametrize(("east", "north"), [(512_345, 5_412_345), (-9_999_999, 1e7)])
def test_a_study_at_utm_coordinates(tmp_path, east, north):
    """Corners that are no doubles there divide all the same, and the search goes the same way."""
    here = study_at(tmp_path, 0, 0)
    there = study_at(tmp_path, east, north)
    assert there.region.shape == here.region.shape == (10, 10, 15)
    assert there.region.cuboid_m == pytest.approx(here.region.cuboid_m, rel=1e-8)
    found = [optimize(one, threads=1) for one in (here, there)]
    assert found[1].objective == pytest.approx(found[0].objective, rel=1e-8)
    for a, b in zip(found[0].rig.mounts, found[1].rig.mounts, strict=True):
        assert np.subtract(b.position_m, a.position_m) == pytest.approx([east, north, 0], abs=1e-8)


# Beams, LiDARs and cuboids


def test_a_thousand_beams():
    """1e-9 degrees apart, through a region's middle; and over all elevations."""
    region = boxes()
    for fan in (np.arange(-500, 500) * 1e-9 + 3.0, np.linspace(-90, 90, 1000)):
        known, exact = oracle.sensor((4, 3, 1), (0.1, -0.2, 0), fan)
        tally = oracle.Tally()
        tally.add(exact, oracle.points_of(region), beam_gaps(region, known).ravel())
        assert tally.wrong_outside == 0
        labels_of(region, [known, some_rig(np.random.default_rng(1), 1)[0]])


def test_twenty_lidars():
    lidars = some_rig(np.random.default_rng(6), 20)
    label = labels_of(boxes(), lidars)
    assert len(np.unique(label)) > 1000
    assert max_vsr(boxes(), lidars) == vsr_m(segment(boxes(), lidars)).max()


@pytest.mark.parametrize("edges", [(1, 1e-3, 1), (1e-3, 1, 1e-3), (1e3, 1, 1), (1, 1, 1e3)])
def test_cuboids_a_thousand_times_longer_than_wide(edges):
    region = Region(np.zeros(3), np.array((9, 8, 7)) * edges, np.ones((9, 8, 7), bool))
    rng = np.random.default_rng(7)
    for _ in range(5):
        known, exact = oracle.sensor(rng.uniform(0, 8, 3) * edges, oracle.angles(rng), FAN)
        labels_of(region, [known])
        tally = oracle.Tally()
        tally.add(exact, oracle.points_of(region), beam_gaps(region, known).ravel())
        assert tally.wrong_outside == 0


@pytest.mark.parametrize("edge", [1e-9, 1.0, 1e7])
def test_one_cuboid(edge):
    """Its VSR is abc / 2(ab + bc + ca) = a / 6, whatever looks at it."""
    region = Region(np.zeros(3), np.full(3, edge), np.ones((1, 1, 1), bool))
    lidars = [oracle.sensor(np.full(3, share * edge), (0.1, 0, 0), FAN)[0] for share in (0.5, 0.0, 7.0)]
    assert labels_of(region, lidars).tolist() == [[[0]]]
    assert max_vsr(region, lidars) == pytest.approx(edge / 6, rel=1e-14)


@pytest.mark.parametrize(
    ("region", "what"),
    [
        ("{min_m: [0, 0, 0], max_m: [1e-9, 1, 1], cuboid_m: [1e-10, 1, 1]}", "1e-10 is too little"),
        ("{min_m: [1e8, 0, 0], max_m: [1e8, 1, 1], cuboid_m: [1, 1, 1]}", "is not above min_m's"),
        ("{min_m: [99999999.9999, 0, 0], max_m: [1e8, 1, 1], cuboid_m: [0.00001, 1, 1]}", "1e-05 is too little for coordinates up to 1e+08; allowed: at least 0.0001"),
        ("{min_m: [0, 0, 0], max_m: [1e9, 1, 1], cuboid_m: [1e9, 1, 1]}", "at most 100000000"),
    ],
)  # fmt: skip
def test_cuboids_that_coordinates_cannot_tell_apart(tmp_path, region, what):
    path = tmp_path / "study.yaml"
    path.write_text(f"region: {region}\nsensors: [{{model: fan-4, min: {{position_m: [0, 0, 0]}}, max: {{position_m: [1, 0, 0]}}}}]\n")  # fmt: skip
    with pytest.raises(ConfigError, match=what.replace("+", r"\+")):
        load_study(path)


# Skipping


@pytest.mark.parametrize("method", ["abc", "annealing", "auto"])
def test_skipping_changes_nothing_whatever_searches(tmp_path, method):
    """Far from the origin, with pairs, a constraint, fixed coordinates and a LiDAR outside the region."""
    path = tmp_path / "s.yaml"
    path.write_text(f"""
region: {{min_m: [500000, 5000000, 0], max_m: [500008, 5000006, 3], cuboid_m: [1, 0.5, 0.25]}}
sensors:
  - {{elevation_deg: [-20, -8, 0, 12], count: 2, mirror_y_m: 5000003, min: {{position_m: [500002, 5000001, 1], rpy_deg: [-180, -90, 0]}}, max: {{position_m: [500006, 5000003, 2.5], rpy_deg: [180, 90, 0]}}}}
  - {{elevation_deg: [0, 1.0e-9, 90], min: {{position_m: [499990, 5000003, 1], rpy_deg: [0, 0, 0]}}, max: {{position_m: [500001, 5000003, 1], rpy_deg: [0, 10, 0]}}}}
constraints: {{max_tilt_deg: 120, min_distance_m: 0.5}}
solver: {{method: {method}, evaluations: 500, seed: 3{', bees: 10, limit: 5' if method == 'abc' else ''}}}
""")  # fmt: skip
    study = load_study(path)
    runs_ = [optimize(study, threads=threads, skip=skip) for threads, skip in ((1, False), (2, True))]
    assert runs_[0].rig == runs_[1].rig
    assert [(c.evaluations, c.best, c.mean) for c in runs_[0].history] == [
        (c.evaluations, c.best, c.mean) for c in runs_[1].history
    ]


# Solvers


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("wrong", [math.nan, -math.inf])
def test_what_is_no_cost_is_an_error(name, wrong):
    for phases in (0, 3):
        solver = begun(name, 2, 1)
        for _ in range(phases):
            solver.tell(of_objectives(np.arange(1.0, len(solver.ask().x) + 1)))
        cost = np.ones(len(solver.ask().x))
        cost[1] = wrong
        with pytest.raises(LidarcfgError, match=r"the cost of trial 1 of \d+ is (nan|-inf); allowed: numbers, and inf"):
            solver.tell(of_objectives(cost))


class Pairs:
    """Answers a search with the costs of one criterion."""

    def __init__(self, bounded):
        self.bounded = bounded

    def costs(self, poses, source, source_poses, upper_bound, smoothing):
        return of_objectives(self.bounded.costs(poses, source, source_poses, upper_bound[:, 1], smoothing))


@pytest.mark.parametrize("objective", ["max_vsr: 1, inscribed_radius: 1", "inscribed_radius: 2"])
def test_nan_from_an_objective_is_no_result(tmp_path, objective):
    class Broken(Criterion):
        def of(self, subspaces, upper_bound=math.inf):
            return math.nan

    path = tmp_path / "s.yaml"
    path.write_text(STUDY.format(x=0, x2=6, y=0, y2=4, a=3, b=2) + f"objective: {{{objective}}}\n")
    study = load_study(path)
    parts = TermContext(study.region, study.detection, (), None, None, None, ())
    broken = Broken(study.objective, parts)
    run = SearchRun(study, BeeColony(study.space.dimensions, 5, 100, 1))
    lidars = [slot.lidar for slot in study.slots]
    with (
        BoundedCosts(study.region, lidars, threads=1, criterion=broken) as bounded,
        pytest.raises(LidarcfgError, match="is nan; allowed: numbers, and inf"),
    ):
        run.step(Pairs(bounded), Budget(5, None, math.inf, math.inf))


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("objective", ["flat", "infinite", "half infinite", "huge"])
def test_objectives_without_a_slope(name, objective):
    solver = begun(name, 2, 1)
    asked = 0
    while asked < 1500:
        x = solver.ask().x
        assert ((x >= 0) & (x <= 1)).all()
        first = asked + np.arange(len(x))
        cost = {
            "flat": np.ones(len(x)),
            "infinite": np.full(len(x), np.inf),
            "half infinite": np.where(first % 2, np.inf, x.sum(axis=1)),
            "huge": 1e300 * (1 + x[:, 0]),
        }[objective]
        solver.tell(of_objectives(cost))
        asked += len(x)


@pytest.mark.parametrize("method", ["abc", "annealing", "auto"])
def test_bounds_one_ulp_apart(tmp_path, method):
    """One coordinate may be either of two doubles, all others are fixed."""
    low, high = 1.3, math.nextafter(1.3, 2)
    path = tmp_path / "s.yaml"
    path.write_text(f"""
region: {{min_m: [0, 0, 0], max_m: [6, 4, 3], cuboid_m: [0.5, 0.5, 0.25]}}
sensors: [{{elevation_deg: [-5, 5], min: {{position_m: [3, 2, {low}], rpy_rad: [0, 0, 0]}}, max: {{position_m: [3, 2, {high}], rpy_rad: [0, 0, 0]}}}}]
solver: {{method: {method}, evaluations: 60{", bees: 5" if method == "abc" else ""}}}
""")
    study = load_study(path)
    assert study.space.free.sum() == 1
    found = optimize(study, threads=1)
    assert found.rig.mounts[0].position_m in ((3, 2, low), (3, 2, high))
    assert set(study.space.poses(np.linspace(0, 1, 101)[:, None])[:, 0, 2]) == {low, high}


def test_equal_bounds_leave_nothing_to_do(tmp_path):
    study = study_at(tmp_path, 0, 0)
    with pytest.raises(ConfigError, match="every bound is equal"):
        optimize(replace(study, slots=tuple(replace(slot, upper=slot.lower) for slot in study.slots)))


# Meshes


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("m.ply", PLY.format(n=3, m=1) + "0 0 0\n1 0 0\nnan 1 0\n3 0 1 2\n"),
        ("m.ply", PLY.format(n=3, m=1) + "0 0 0\n1 0 0\n-inf 1 0\n3 0 1 2\n"),
        ("m.ply", PLY.format(n=3, m=1) + "0 0 0\n1 0 0\n1e39 1 0\n3 0 1 2\n"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n"),
        ("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1e400 0\nf 1 2 3\n"),
        ("m.off", "OFF\n3 1 0\n0 0 0\n1 0 0\nnan 1 0\n3 0 1 2\n"),
        ("m.stl", "solid m\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex nan 1 0\nendloop\nendfacet\nendsolid m\n"),
    ],
)  # fmt: skip
def test_numbers_in_meshes_that_are_none(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    try:
        loaded = scene(tmp_path, f"meshes: [{{name: m, file: {name}, position_m: [0, 0, 0], reflectivity: 7}}]")
    except ConfigError as error:
        message = str(error)
    else:  # a reader may make a number of it
        message = f"{name} read"
        assert np.isfinite(loaded.vertices_m).all()
    assert name in message
    assert "\n" not in message


# Captures far away


def walls(origins, way, centre, size=(30.0, 20.0, 8.0)):
    """How far rays from inside the room get: exactly, but for rounding."""
    with np.errstate(divide="ignore"):
        low, high = np.subtract(centre, np.array(size) / 2), np.add(centre, np.array(size) / 2)
        return np.where(way > 0, (high - origins) / way, (low - origins) / way).min(axis=-1)


@pytest.mark.parametrize(
    ("vehicle", "position"),
    [
        ((0.0, 0.0, 0.0), (0.5, -0.25, 1.5)),
        ((1e7, -1e7, 100.0), (0.5, -0.25, 1.5)),
        ((0.0, 0.0, 0.0), (512_345.67, 5_412_345.89, 303.1)),
        ((0.0, 0.0, 0.0), (1e7, -1e7, 1e7)),
        ((-1e7, 1e7, 0.0), (1e7 + 0.1, -1e7 - 0.2, 1.5)),
    ],
)
def test_what_is_decoded_far_from_the_origin(tmp_path, vehicle, position):
    """Range within half a step, time within 1 µs, azimuth within 0.005°, and 0.014° in the very last block."""
    T_world_vehicle = pose(vehicle, (0.0, 0.0, 0.2))
    sensor_mount = mount(0, position, (4.0, -3.0, 20.0))
    rig = Rig("far", (sensor_mount,))
    sensor = sensor_mount.sensor
    T = T_world_vehicle @ sensor_mount.T_vehicle_sensor
    centre = T[:3, 3] + (1.0, -2.0, 0.5)
    count = 80
    duration = count * packet_period_ns(sensor)
    streams = simulated_packets(rig, room(tmp_path, centre), T_world_vehicle, duration, start_ns=10**18)
    write_pcap(tmp_path / "far.pcap", in_time_order(streams))
    data = [d for d in datagrams_of(tmp_path / "far.pcap") if len(d.payload) == PACKET.itemsize]
    packets = np.frombuffer(b"".join(d.payload for d in data), PACKET)
    returns = decode(sensor, packets, np.array([d.time_ns for d in data]))

    fired = firings(sensor, 600.0, 10**18, range(count))
    origins, way = (a.reshape(-1, 3) for a in rays(sensor, fired))
    truth = walls(transform(T, origins), way @ T[:3, :3].T, centre)
    assert len(truth) == len(returns.range_m) == count * 384
    step = sensor.range.resolution_m
    assert abs(returns.range_m - truth).max() <= step / 2 + 1e-7  # of coordinates up to 1e7 m
    assert abs(returns.time_ns - fired.time_ns.ravel()).max() <= 1000
    error = np.degrees(abs((returns.azimuth_rad - fired.azimuth_rad.ravel() + np.pi) % (2 * np.pi) - np.pi))
    assert error[:-32].max() <= 0.005
    assert error.max() <= 0.014

    cloud = concatenate(list(decode_pcap(tmp_path / "far.pcap", no_warning, rig=rig)))
    there = transform(inverse(sensor_mount.T_vehicle_sensor), cloud.xyz)
    slack = 4 * np.spacing(np.abs(position).max())
    np.testing.assert_allclose(there, returns.xyz_m, atol=1e-9 + slack)


@pytest.mark.parametrize(
    ("names", "line", "rows"),
    [
        ("poses random cuboids", "pairs of sensors in odd places, turned by odd angles | 166,656 | 0 |", 5),
        pytest.param(
            "rays",
            "a ray and a triangle in exact arithmetic: grazing | 200 | 0 |",
            17,
            marks=pytest.mark.nightly,  # tests/world/test_tracer.py has the same briefly
        ),
    ],
)
def test_the_long_run_in_small(names, line, rows, tool, capsys):
    """It runs, and fails nothing."""
    stress = tool("stress")
    with pytest.raises(SystemExit) as ended:
        stress.main(["--quick", *names.split()])
    assert not ended.value.code
    told = capsys.readouterr().out
    assert f"| {line}" in told
    assert told.count("\n| ") == rows
    with pytest.raises(SystemExit, match="2"):
        stress.main(["pose"])
    assert "no case is called pose; allowed: random, poses, near" in capsys.readouterr().err
