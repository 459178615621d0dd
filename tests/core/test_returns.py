"""Returns from an object: the core on a small sensor, and what it refuses."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from lidarcfg.core import returns, world
from tests.core.records import replaced
from tests.naive.returns import hit_m

SIDE = np.array([[[0, -1, 0], [0, 1, 0], [0, 1, 2]], [[0, -1, 0], [0, 1, 2], [0, -1, 2]]], float)
LOW = np.array([0.0, -1, 0])
HIGH = np.array([0.0, 1, 2])
R = np.eye(3)[None]
T = np.array([[0.0, 0, 1]])
FIRINGS = np.radians([-10.0, 0.0, 10.0])


def bvh(triangles):
    """Of triangles (T, 3, 3)."""
    shapes = np.asarray(triangles, float).reshape(-1, 9)
    number = np.arange(len(shapes), dtype=np.int32)
    return world.Bvh(shapes, np.zeros(len(shapes), np.uint8), number, number)


def obstacles(triangles=(), ground_m=math.inf):
    """Triangles and the ground."""
    tree = bvh(triangles)
    return world.Obstacles(tree, world.boxes_of(tree), np.zeros(3), ground_m)


def scanner(phases=4, step_deg=1.0, **changes):
    """Three beams at -10°, 0° and 10°, every degree."""
    heads = np.radians(np.arange(0, 360, step_deg / phases))
    none = np.zeros(3)
    given = {
        "cos_head": np.cos(heads), "sin_head": np.sin(heads), "start_rad": 0.0,
        "step_rad": math.radians(step_deg / phases), "phases": phases, "lag_rad": none, "gating_rad": none,
        "offset_rad": none, "elevation_rad": FIRINGS, "start_m": np.zeros((3, 3)),
        "phase": np.empty(0, np.int32), "range_m": (0.5, 100.0), "fov_rad": (0.0, 2 * math.pi),
    }  # fmt: skip
    return returns.Scanner(**given | changes)


TARGET = returns.TargetShape(bvh(SIDE), LOW, HIGH)
PLACES = np.array([[5.0, 0, 0, 0], [50, 0, 0, 0], [0, 5, 0, math.pi / 2], [-5, 0, 0, math.pi]])


def counted(one, places=PLACES, around=None, target=TARGET):
    """(P, phases) the returns at places."""
    counts = np.zeros((len(places), 1, one.phases), np.int32)
    returns.count_returns(places, np.arange(len(places)), [one], R, T, target, around or obstacles(), counts)
    return counts[:, 0]


@pytest.mark.parametrize("phases", [1, 3, 4])
def test_a_wall_by_hand(phases):
    """At 5 m all three beams reach its 2 m of height; at 50 m the level one; 2 m of width are ±11.3° and ±1.15°."""
    found = counted(scanner(phases))
    by_head = [math.atan(1 / far) for far in (5, 50)]
    for place, (beams, reach) in enumerate(zip((3, 1), by_head, strict=True)):
        heads = np.radians(np.arange(-180 * phases, 180 * phases) / phases)
        each = [(abs(heads[phase::phases]) <= reach).sum() for phase in range(phases)]
        assert found[place].tolist() == [beams * count for count in each]
    assert found[3].sum() == found[0].sum()
    assert abs(int(found[2].sum()) - int(found[0].sum())) <= 6


def test_ranges_fields_of_view_and_what_stands_before():
    assert counted(scanner(range_m=(0.5, 4.9))).sum() == 0
    assert counted(scanner(fov_rad=(math.radians(30), math.radians(300))))[0].sum() == 0
    ahead = counted(scanner(fov_rad=(math.radians(300), math.radians(120))))
    assert ahead[0].tolist() == counted(scanner())[0].tolist()
    assert ahead[3].sum() == 0
    assert counted(scanner(), around=obstacles((SIDE - (0, 0, 1)) * 3 + (2, 0, 1)))[:2].sum() == 0
    low = counted(scanner(), around=obstacles(ground_m=0.5))[0]
    assert low.sum() == counted(scanner())[0].sum() * 2 / 3
    assert counted(scanner(), target=returns.TargetShape(bvh([]), LOW, HIGH)).sum() == 0
    assert counted(scanner(), places=np.array([[math.nan, 0, 0, 0]])).sum() == 0
    assert counted(scanner(), places=np.empty((0, 4))).shape == (0, 4)
    around = returns.TargetShape(bvh(SIDE), LOW - 9, HIGH + 9)  # whose bounding box the sensor is in
    assert np.array_equal(counted(scanner(), target=around), counted(scanner()))


def known(scanners=None, places=PLACES, ends=(4,)):
    """Of the wall at places; those between two ends are an object's."""
    walls = [TARGET] * len(ends)
    return returns.KnownReturns(scanners or [scanner()], walls, places, np.array(ends), obstacles())


def test_known_returns_say_where_an_object_is_missed():
    (near, far, _, _), one = counted(scanner()), np.zeros(1, np.int64)
    whole = known()
    assert whole.missed(one, R, T, 0, int(near.min()), math.inf) == 1.0
    assert whole.missed(one, R, T, 0, 1000, math.inf) == 4.0
    assert whole.missed(one, R, T, 0, 0, math.inf) == 0.0
    some = known(ends=(1, 1, 4))
    enough = int(far.max())
    assert some.missed(one, R, T, 1, enough, math.inf) == 0.0
    assert some.missed(one, R, T, 2, enough, math.inf) == (far < enough).mean()
    assert some.missed_among(one, R, T, 2, enough, 3) == (far < enough).mean()
    assert some.missed_among(one, R, T, 2, enough, 0) == 0.0
    for n in range(5000):  # more poses than are kept
        assert some.missed(one, R, T + n * 1e-9, 0, enough, math.inf) == 0.0
    two = known([scanner(), scanner(3)])
    both = np.arange(2), np.repeat(R, 2, axis=0), np.repeat(T, 2, axis=0)
    twice = int(2 * far.max())
    assert 0.0 < two.missed(*both, 0, twice, math.inf) <= 1.0
    assert two.missed(both[0][1:], R, T, 0, twice, math.inf) >= two.missed(*both, 0, twice, math.inf)
    same = np.zeros(2, np.int64)  # two sensors that fire alike
    assert two.missed(same, *both[1:], 0, int(near.min()) * 2, math.inf) == 1.0
    assert two.traced > 0


def test_misses_are_the_weighted_mean_of_shares():
    """Of a wall at one place, near; and of another at the three places left, of which it is seen at one by few returns."""
    one = np.zeros(1, np.int64)
    near, far, behind, beside = counted(scanner())
    some = known(ends=(1, 4))
    enough = int(far.max())
    shares = [(near < enough).mean(), np.mean([(row < enough).mean() for row in (far, behind, beside)])]
    assert some.misses(one, R, T, np.array([1.0, 1.0]), enough, math.inf) == np.mean(shares)
    assert some.misses(one, R, T, np.array([1.0, 3.0]), enough, math.inf) == (shares[0] + 3 * shares[1]) / 4
    assert 0.1 <= some.misses(one, R, T, np.array([1.0, 3.0]), enough, 0.1) <= (shares[0] + 3 * shares[1]) / 4
    missed = np.empty(3)
    some.probabilities(one, R, T, 1, np.array([2, 0, 1]), enough, missed)
    assert missed.tolist() == [(row < enough).mean() for row in (beside, far, behind)]


def test_what_is_known_takes_so_much_memory():
    each = 8 + 4 * 4  # bytes at a place, in four phases
    assert known().memory_bytes == 4096 * 4 * each
    assert known([scanner(), scanner(3)]).memory_bytes == 2 * 4096 * 4 * each
    many = np.tile(PLACES, (2**17, 1))
    assert known(places=many, ends=(2**19,)).memory_bytes == 21 * 2**19 * each  # poses, in 256 MB
    assert known([scanner()] * 9, places=many, ends=(2**19,)).memory_bytes == 16 * 9 * 2**19 * each


def test_threads_share_what_is_known():
    rng = np.random.default_rng(2)
    one = np.zeros(1, np.int64)
    places = np.column_stack([rng.uniform(-20, 20, (60, 2)), np.zeros(60), rng.uniform(0, 7, 60)])
    poses = [T + 0.1 * n for n in range(5)]
    shared = known(places=places, ends=(60,))

    def missed(n, known):
        if n % 3 == 0:
            known.missed_among(one, R, poses[n % 5], 0, 8, 30)
        if n % 7 == 0:
            lowest = np.empty((60, 1), np.int32)
            known.lowest(one, R, poses[n % 5], 0, np.arange(60), 20, 1, lowest, np.empty((60, 1), np.int8))
        return known.missed(one, R, poses[n % 5], 0, 8, math.inf)

    alone = [missed(n, known(places=places, ends=(60,))) for n in range(5)]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(missed, range(200), [shared] * 200)) == alone * 40
    assert 0 < min(alone) < max(alone) < 60


def test_probabilities():
    counts = np.array([[[3, 5], [2, 9]], [[0, 0], [9, 0]]], np.int32)
    assert returns.detection_probabilities(counts, np.array([2, 1]), 6).tolist() == [0.5, 1.0]
    assert returns.detection_probabilities(counts, np.array([2, 2]), 9).tolist() == [0.5, 0.5]
    assert returns.detection_probabilities(counts[:0], np.array([2, 2]), 9).tolist() == []


def still(**changes):
    """Three beams ahead at -10°, 0° and 10°, of two frames: the highest is in the second."""
    given = {"cos_head": np.ones(2), "sin_head": np.zeros(2), "step_rad": 0.0, "phase": np.array([0, 0, 1], np.int32)}
    return scanner(2, **given | changes)


@pytest.mark.parametrize("turned_deg", [0, 360, -720, -5, 355, 5])
def test_heads_that_stand_still(turned_deg):
    """The wall, 2 m high and 5 m ahead, is in all beams from 1 m; 50 m ahead only in the level one, if that is straight.

    All are in nothing behind and beside.
    """
    aside = np.full(3, math.radians(turned_deg))
    counts = np.zeros((4, 1, 2), np.int32)
    returns.count_returns(
        PLACES, np.arange(4), [still(lag_rad=aside, gating_rad=aside)], R, T, TARGET, obstacles(), counts
    )
    assert counts[:, 0].tolist() == [[2, 1], [int(turned_deg % 360 == 0), 0], [0, 0], [0, 0]]


@pytest.mark.parametrize("side", [1, -1])
def test_a_plate_around_the_axis(side):
    """A level square of 2 m, 3 m above or below the sensor: what hits it is told by where beams are at that height."""
    rng = np.random.default_rng(5)
    count = 5000
    elevation, azimuth = rng.uniform(-1.5, 1.5, count), rng.uniform(0, 2 * math.pi, count)
    phase = rng.integers(2, size=count).astype(np.int32)
    none = np.zeros(count)
    one = still(
        lag_rad=azimuth, gating_rad=azimuth, offset_rad=none, elevation_rad=elevation,
        start_m=np.zeros((count, 3)), phase=phase,
    )  # fmt: skip
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    plate = returns.TargetShape(bvh(corners[[[0, 1, 2], [0, 2, 3]]]), corners[0], corners[2])
    found = counted(one, np.array([[0.0, 0, 1 + 3 * side, 0]]), target=plate)
    aside_m = np.where(side * elevation > 0, 3 / np.tan(abs(elevation)), np.inf)
    with np.errstate(invalid="ignore"):
        hits = (abs(aside_m * np.cos(azimuth)) <= 1) & (abs(aside_m * np.sin(azimuth)) <= 1)
    assert found.tolist() == [[int((hits & (phase == n)).sum()) for n in range(2)]]
    assert found.min() > 20


def anywhere(rng):
    """A sensor's R and t, near the origin, turned by any angles."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    R = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array([R]), rng.uniform(-1, 1, (1, 3))


@pytest.mark.parametrize("apart_m", [0.0, 0.3])
def test_scattered_beams_of_any_pose_are_those_of_plain_loops(apart_m):
    """An open box of 1 m, also around the sensor, at it, above, below and behind it; beams start beside the axis or not."""
    rng = np.random.default_rng(7)
    count = 1500
    azimuth, elevation = rng.uniform(-math.pi, 3 * math.pi, count), rng.uniform(-1.57, 1.57, count)
    phase = rng.integers(2, size=count).astype(np.int32)
    start_m = rng.uniform(-apart_m, apart_m, (count, 3))
    one = still(
        lag_rad=azimuth, gating_rad=azimuth, offset_rad=np.zeros(count), elevation_rad=elevation, start_m=start_m,
        phase=phase, range_m=(0.2, 5.0), fov_rad=(math.radians(200), math.radians(300)),
    )  # fmt: skip
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    faces = corners[[[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6]]]
    target = returns.TargetShape(bvh(faces), corners[0], corners[7])
    x, y = np.cos(azimuth), -np.sin(azimuth)
    way = np.stack([np.cos(elevation) * x, np.cos(elevation) * y, np.sin(elevation)], axis=1)
    starts = np.stack([start_m[:, 0] * x - start_m[:, 1] * y, start_m[:, 0] * y + start_m[:, 1] * x, start_m[:, 2]], 1)
    inside = (np.degrees(azimuth) - 200) % 360 <= 300
    total = 0
    for at in [(0, 0, -0.5), (0.6, 0, -0.5), (-2, 0.01, 0), (0, 0, 2), (0, 0, -3), (3, -3, 1), (0, 4, -1)]:
        R, t = anywhere(rng)
        heading = rng.uniform(-4, 4)
        c, s = math.cos(heading), math.sin(heading)
        placed = faces @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + at
        expected = [0, 0]
        for n in np.flatnonzero(inside):
            expected[phase[n]] += 0.2 <= hit_m(R[0] @ starts[n] + t[0], R[0] @ way[n], placed) <= 5.0
        counts = np.zeros((1, 1, 2), np.int32)
        returns.count_returns(
            np.array([[*at, heading]]), np.zeros(1, np.int64), [one], R, t, target, obstacles(), counts
        )
        assert counts[0, 0].tolist() == expected
        total += sum(expected)
    assert total > 200


def count_with(**changes):
    """A call of count_returns with some arguments changed."""
    given = {
        "places": PLACES, "which": np.arange(4), "scanners": [scanner()], "R": R, "t": T, "target": TARGET,
        "obstacles": obstacles(), "counts": np.zeros((4, 1, 4), np.int32),
    }  # fmt: skip
    return lambda: returns.count_returns(**given | changes)


def missed_with(scanners=(0,), R=R, t=T, object=0, enough=1):
    """A call of missed with some arguments changed."""
    return lambda: known().missed(np.array(scanners, np.int64), R, t, object, enough, 1.0)


def lowest_with(**changes):
    """A call of lowest with some arguments changed."""
    given = {
        "scanners": np.zeros(1, np.int64), "R": R, "t": T, "object": 0, "which": np.arange(4), "cap": 5, "wanted": 1,
        "counts": np.zeros((4, 1), np.int32), "phases": np.zeros((4, 1), np.int8),
    }  # fmt: skip
    return lambda: known().lowest(**given | changes)


COUNTS = np.zeros((1, 2, 2), np.int32)
TWO = np.array([2, 2])


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: scanner(phases=4, lag_rad=np.zeros(2)), "gating_rad"),
        (lambda: scanner(offset_rad=np.zeros(2)), "offset_rad"),
        (lambda: scanner(elevation_rad=np.zeros(4)), "elevation_rad"),
        (lambda: scanner(start_m=np.zeros((3, 2))), "start_m"),
        (lambda: scanner(sin_head=np.zeros(2)), "sin_head"),
        (lambda: scanner(step_rad=1e-9), "step_rad"),
        (lambda: scanner(phase=np.zeros(3, np.int32)), "phase"),
        (lambda: scanner(step_rad=0.0), "cos_head"),
        (lambda: still(phase=np.zeros(2, np.int32)), "phase"),
        (lambda: still(phase=np.array([0, 1, 2], np.int32)), "phase"),
        (lambda: still(phase=np.array([0, -1, 1], np.int32)), "phase"),
        (lambda: scanner(step_rad=math.nan), "step_rad"),
        (lambda: scanner(range_m=(1.0,)), "range_m"),
        (lambda: scanner(lag_rad=np.array([0, math.nan, 0])), "lag_rad"),
        (lambda: scanner(fov_rad=(0.0, math.inf)), "fov_rad"),
        (lambda: returns.TargetShape(None, LOW, HIGH), "bvh"),
        (lambda: returns.TargetShape(bvh(SIDE), LOW[:2], HIGH), "low_m"),
        (count_with(places=PLACES[:, :3].copy()), "places"),
        (count_with(which=np.array([4])), "which"),
        (count_with(which=np.array([-1])), "which"),
        (count_with(scanners=[None]), "scanners"),
        (count_with(R=np.eye(3)), "R"),
        (count_with(t=np.zeros((2, 3))), "t"),
        (count_with(counts=np.zeros((4, 1, 3), np.int32)), "counts"),
        (count_with(counts=np.zeros((3, 1, 4), np.int32)), "counts"),
        (count_with(counts=np.zeros((4, 1, 4))), "counts"),
        (lambda: replaced(obstacles(), origin_m=np.zeros(2)), "origin_m"),
        (lambda: known(ends=(3,)), "ends"),
        (lambda: known(ends=()), "ends"),
        (lambda: known(ends=(5, 4)), "ends"),
        (missed_with(scanners=(1,)), "scanners"),
        (missed_with(scanners=(-1,)), "scanners"),
        (missed_with(R=np.zeros((2, 3, 3))), "R"),
        (missed_with(object=1), "object"),
        (missed_with(enough=-1), "enough"),
        (lambda: known().misses(np.zeros(1, np.int64), R, T, np.ones(2), 1, 1.0), "weights"),
        (lowest_with(which=np.array([4])), "which"),
        (lowest_with(cap=0), "cap"),
        (lowest_with(counts=np.zeros((4, 2), np.int32)), "counts"),
        (lowest_with(phases=np.zeros((3, 1), np.int8)), "phases"),
        (lambda: returns.detection_probabilities(COUNTS, TWO[:1], 1), "phases"),
        (lambda: returns.detection_probabilities(COUNTS, TWO + 1, 1), "phases"),
        (lambda: returns.detection_probabilities(COUNTS - 1, TWO, 1), "counts"),
        (lambda: returns.detection_probabilities(COUNTS, TWO, -1), "enough"),
    ],
)
def test_what_is_refused_is_named(call, named):
    with pytest.raises((TypeError, ValueError), match=named):
        call()
