"""Misses: against plain loops over every ray; places by another library's distances; intervals by scipy and by hand."""

import json
import math
from itertools import product

import numpy as np
import pytest
import shapely
from scipy.stats import binomtest, chisquare
from shapely import affinity

from lidarcfg.returns.misses import FRESH, SEARCH, MissesFound, ObjectMisses
from lidarcfg.returns.places import DRAWN_AT_A_TIME
from lidarcfg.world.meshes import read_mesh
from tests.command_line import lidarcfg
from tests.naive import misses as naive
from tests.returns_cases import FACES
from tests.studies import study_of
from tests.test_tools import ROOT

ELEVATIONS_DEG = [-48, -40, -33, -26, -20, -15, -11, -7, -3, 0]
STEP_DEG = 2.5
FOV_DEG = (260, 60)  # clockwise, past ahead
FRAME_NS = 50_000_000
FRAMES = 3
BODY = (-1.5, -0.8, 0.3), (1.5, 0.8, 1.3)
SENSOR = {"name": "turns", "beams": {"elevation_deg": ELEVATIONS_DEG}, "firing": {"step_deg": STEP_DEG}}
SCAN = {"name": "scans", "scan_pattern": {"file": "table.csv", "frame_ms": 50}}
RANGE = {"range": {"min_m": 0.5, "max_m": 5.5}}
STUDY = """region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.8], size_m: [3, 1.6, 1]}]}
sensors:
  - {name: a, model: turns.yaml, min: {position_m: [-1, -0.6, 1.4], rpy_deg: [-20, -20, -180]}, max: {position_m: [1, 0.6, 1.8], rpy_deg: [20, 20, 180]}}
  - {name: b, model: scans.yaml, min: {position_m: [1.6, -0.6, 0.5], rpy_deg: [-20, -20, -180]}, max: {position_m: [1.9, 0.6, 1], rpy_deg: [20, 20, 180]}}
  - {name: c, model: turns.yaml, azimuth_fov_deg: [260, 60], min: {position_m: [-1.9, -0.6, 0.5], rpy_deg: [-20, -20, -180]}, max: {position_m: [-1.6, 0.6, 1], rpy_deg: [20, 20, 180]}}
objective: {misses: MISSES}
"""
MISSES = "{objects: {post: 2, tyre: 1, dog: 0.5}, returns: 3, within_m: [0.1, 4]}"


def rows():
    """A scan pattern's firings: three frames that differ, in 0.1 s."""
    rng = np.random.default_rng(5)
    count = 3600
    time_ns = np.arange(count) * (FRAMES * FRAME_NS // count)
    azimuth = np.round(rng.uniform(0, 360, count), 2)
    elevation = np.round(rng.uniform(-50, 5, count), 2)
    return list(zip(time_ns.tolist(), azimuth.tolist(), elevation.tolist(), strict=True))


def study(folder, misses=MISSES, text=STUDY):
    for name, values in (("turns", SENSOR), ("scans", SCAN)):
        (folder / f"{name}.yaml").write_text(json.dumps(values | RANGE))
    lines = ["time_ns,azimuth_deg,elevation_deg,channel", *(f"{t},{a},{e},0" for t, a, e in rows())]
    (folder / "table.csv").write_text("\n".join(lines) + "\n")
    return study_of(folder, text.replace("MISSES", misses))


def random_rigs(loaded, count, seed=3):
    return loaded.space.poses(np.random.default_rng(seed).random((count, loaded.space.dimensions)))


def box(low, high):
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    return corners[FACES]


def by_hand(name, places, poses, kept=(0, 1, 2), body=BODY):
    """The returns (place, sensor, phase) of an object."""
    vertices, triangles = read_mesh(ROOT / f"data/objects/{name}.ply")
    table = rows()
    fired = [
        [naive.revolution(ELEVATIONS_DEG, STEP_DEG, phase) for phase in range(4)],
        [naive.frame(table, FRAME_NS, FRAMES, phase) for phase in range(4)],
        [naive.revolution(ELEVATIONS_DEG, STEP_DEG, phase, FOV_DEG) for phase in range(4)],
    ]
    ways = {s: [naive.directions(rays, poses[s, 3:]) for rays in fired[s]] for s in kept}
    found = []
    for place in places:
        thing = naive.standing(vertices, triangles, place)
        found.append(
            [[naive.returned(one, poses[s, :3], (0.5, 5.5), thing, box(*body)) for one in ways[s]] for s in kept]
        )
    return found


@pytest.mark.slow
def test_misses_are_those_of_plain_loops(tmp_path):
    """At ten places of three objects for two rigs, of three sensors, two and one; and their weighted mean."""
    loaded = study(tmp_path)
    known = loaded.misses.known(10)
    seen = set()
    for poses in random_rigs(loaded, 2):
        mounts = loaded.rig(poses).mounts
        counts = [
            by_hand(name, one.places, poses) for name, one in zip(("post", "tyre", "dog"), known.objects, strict=True)
        ]
        for kept in ((0, 1, 2), (1, 2), (0,)):
            rig = known.rig(mounts).left(kept)
            for returns in (1, 3, 8):
                wanted = [[naive.missed([place[s] for s in kept], returns) for place in one] for one in counts]
                for number, one in enumerate(wanted):
                    assert known.miss_probability(rig, number, returns).tolist() == one
                    assert known.missed(rig, number, returns) == sum(one)
                    seen.update(one)
                value = naive.mean(wanted, (2, 1, 0.5))
                assert known.misses(rig, loaded.misses.weights, returns) == pytest.approx(value, rel=1e-14)
                if value > 0:
                    assert known.misses(rig, loaded.misses.weights, returns, 0.6 * value) >= 0.6 * value
        found = loaded.misses.found_at(known, mounts)
        wanted = [[naive.missed(place, 3) for place in one] for one in counts]
        assert [one.probability.tolist() for one in found.objects] == wanted
        assert found.mean == pytest.approx(naive.mean(wanted, (2, 1, 0.5)), rel=1e-14)
    assert {0.0, 1.0} < seen  # and places where the phases decide


@pytest.mark.slow
def test_what_hides_is_the_body(tmp_path):
    """Places at which the plain loops find fewer returns with the body than without it: the engine agrees with both."""
    loaded = study(tmp_path, "{objects: {tyre: 1}, returns: 3, within_m: [0.1, 2]}")
    known = loaded.misses.known(24)
    poses = random_rigs(loaded, 1)[0]
    poses[0] = 0.0, 0.0, 1.7, 0.0, 0.0, 0.0
    rig = known.rig(loaded.rig(poses).mounts).left((0,))
    with_body = by_hand("tyre", known.objects[0].places, poses, (0,))
    without = by_hand("tyre", known.objects[0].places, poses, (0,), ((90, 90, 90), (91, 91, 91)))
    missed = [naive.missed(place, 3) for place in with_body]
    assert known.miss_probability(rig, 0, 3).tolist() == missed
    assert sum(missed) > sum(naive.missed(place, 3) for place in without) + 2


SEDAN = """region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
vehicle: {meshes: [{name: body, file: ROOT/data/vehicles/sedan.ply}]}
sensors: [{model: vlp-16, min: {position_m: [0, 0, 1.8], rpy_deg: [0, 0, 0]}, max: {position_m: [0, 0, 2], rpy_deg: [0, 0, 0]}}]
objective: {misses: MISSES}
""".replace("ROOT", str(ROOT))


def outline(path):
    """The union of a mesh's triangles from above, holes filled, by shapely."""
    vertices, triangles = read_mesh(path)
    flat = shapely.polygons(vertices[triangles][:, :, :2])
    whole = shapely.union_all(shapely.buffer(flat[shapely.area(flat) > 1e-9], 1e-6, quad_segs=1))
    return shapely.unary_union([shapely.Polygon(part.exterior) for part in shapely.get_parts(whole)])


@pytest.mark.slow
@pytest.mark.parametrize("within_m", [(0.1, 20.0), (0.0, 0.5), (3.0, 3.2)])
def test_places_are_within_distances_of_the_body_s_outline(tmp_path, within_m):
    """The distance of two outlines, turned and moved by shapely."""
    loaded = study(tmp_path, f"{{objects: {{cyclist: 1, dog: 1}}, within_m: {list(within_m)}}}", SEDAN)
    body = outline(ROOT / "data/vehicles/sedan.ply")
    for one in loaded.misses.objects:
        thing = outline(ROOT / f"data/objects/{one.name}.ply")
        for purpose in (SEARCH, FRESH):
            places = one.places(300, purpose)
            assert places.shape == (300, 4)
            for x, y, z, heading in places:
                there = affinity.translate(affinity.rotate(thing, heading, origin=(0, 0), use_radians=True), x, y)
                assert within_m[0] - 3e-6 < there.distance(body) < within_m[1] + 3e-6
                assert z == 0
            assert not within_m[0] or min(np.bincount((places[:, 3] // (math.pi / 2)).astype(int), minlength=4)) > 50


@pytest.mark.parametrize(("length_m", "most_m"), [(0.8, 5.0), (2.0, 5.0), (2.1, 20.0)])
def test_around_a_robot_objects_are_nearer_than_around_a_car(tmp_path, length_m, most_m):
    """By shapely's distance of the outlines: places lie up to the limit, and none beyond."""
    text = STUDY.replace("size_m: [3, 1.6, 1]", f"size_m: [{length_m}, 0.6, 0.4]")
    loaded = study(tmp_path, "{objects: {post: 1}}", text)
    half = length_m / 2
    body = shapely.box(-half, -0.3, half, 0.3)
    thing = outline(ROOT / "data/objects/post.ply")
    away = [affinity.translate(thing, x, y).distance(body) for x, y, *_ in loaded.misses.objects[0].places(400, FRESH)]
    assert loaded.misses.within_m == (0.1, most_m)
    assert 0.95 * most_m < max(away) < most_m + 0.1  # the post is turned, too


@pytest.mark.slow
def test_places_of_a_sector_are_in_it(tmp_path):
    """By the angle from the middle of the outline's bounds: a sector that has the rear in it."""
    loaded = study(tmp_path, "{objects: {post: 1}, sector_deg: [135, 225]}", SEDAN)
    low_x, low_y, high_x, high_y = outline(ROOT / "data/vehicles/sedan.ply").bounds
    places = loaded.misses.objects[0].places(500, FRESH)
    angle = np.degrees(np.arctan2(places[:, 1] - (low_y + high_y) / 2, places[:, 0] - (low_x + high_x) / 2)) % 360
    assert ((angle > 135 - 1e-3) & (angle < 225 + 1e-3)).all()
    assert np.ptp(angle) > 85


@pytest.mark.slow
def test_places_are_uniform_in_area_and_heading(tmp_path):
    """As counts in cells of distance, side and heading of points drawn by numpy and kept by shapely; by chi square.

    The same test refuses places that are as frequent at every distance.
    """
    loaded = study(tmp_path, "{objects: {post: 1}, within_m: [0.1, 8]}")
    body = shapely.box(-1.5, -0.8, 1.5, 0.8)

    def cells(x, y, heading, d):
        ring = np.digitize(d, [1, 2, 3.5, 5, 6.5])
        side = (x > 0) * 2 + (y > 0)
        return np.bincount(ring * 16 + side * 4 + (heading // (math.pi / 2)).astype(int), minlength=96)

    rng = np.random.default_rng(11)
    x, y = rng.uniform(-10, 10, (2, 400_000))
    d = (
        shapely.distance(body, shapely.points(x, y)) - 0.05
    )  # a post is 0.1 m wide: the margin is small beside the cells
    kept = (d > 0.1) & (d < 8)
    wanted = cells(x[kept], y[kept], rng.uniform(0, 2 * math.pi, kept.sum()), d[kept])
    places = loaded.misses.objects[0].places(4096, FRESH)
    of_places = shapely.distance(body, shapely.points(places[:, :2])) - 0.05
    found = cells(*places[:, [0, 1, 3]].T, of_places)
    expected = wanted * (found.sum() / wanted.sum())
    assert chisquare(found, expected).pvalue > 0.01
    even = rng.choice(kept.sum(), 4096, p=(1 / (d[kept] + 1)) / (1 / (d[kept] + 1)).sum())
    other = cells(x[kept][even], y[kept][even], rng.uniform(0, 2 * math.pi, 4096), d[kept][even])
    assert chisquare(other, expected).pvalue < 1e-9


def test_fewer_places_are_the_first_of_more_and_fresh_ones_are_others(tmp_path):
    """Beyond the number that is drawn at a time, too."""
    loaded = study(tmp_path, "{objects: {post: 1, tyre: 1}}")
    drawn = {}
    for one, purpose in product(loaded.misses.objects, (SEARCH, FRESH)):
        places = one.places(2 * DRAWN_AT_A_TIME, purpose)
        for count in (1, 64, DRAWN_AT_A_TIME):
            np.testing.assert_array_equal(one.places(count, purpose), places[:count])
        drawn[one.name, purpose] = set(map(tuple, places[:, [0, 1, 3]].tolist()))
        assert len(drawn[one.name, purpose]) == 2 * DRAWN_AT_A_TIME
    names = list(drawn)
    assert not any(drawn[a] & drawn[b] for n, a in enumerate(names) for b in names[:n])
    standing = [one.places for one in loaded.misses.known(64).objects]
    np.testing.assert_array_equal(standing[1], loaded.misses.objects[1].places(64, SEARCH))
    assert {tuple(row) for row in loaded.misses.fresh.objects[1].places[:, [0, 1, 3]].tolist()} <= drawn["tyre", FRESH]


def found(shares, weights=None):
    """What is missed with these probabilities (objects, places)."""
    weights = weights or [1.0] * len(shares)
    objects = [
        ObjectMisses(f"{n}", weight, np.zeros((len(one), 4)), np.asarray(one, float))
        for n, (one, weight) in enumerate(zip(shares, weights, strict=True))
    ]
    return MissesFound(tuple(objects), 3, (0.1, 20.0))


@pytest.mark.parametrize(("missed", "count"), [(0, 64), (1, 64), (17, 64), (64, 64), (123, 4096)])
def test_the_interval_of_an_object_is_wilson_s(missed, count):
    """By scipy; that of the mean of one object is the same."""
    wanted = binomtest(missed, count).proportion_ci(method="wilson")
    one = found([[1.0] * missed + [0.0] * (count - missed)])
    np.testing.assert_allclose(one.objects[0].interval, (wanted.low, wanted.high), atol=1e-12)
    np.testing.assert_allclose(one.interval, (wanted.low, wanted.high), atol=1e-12)


def test_the_interval_of_the_mean_by_hand():
    """Zou and Donner: of Σ w p, the ends of each share's interval, their distances from it squared, weighted and summed."""
    both = found([[1] * 5 + [0] * 95, [1] * 40 + [0] * 160], [3, 1])
    one, other = (binomtest(*counts).proportion_ci(method="wilson") for counts in ((5, 100), (40, 200)))
    mean = 0.75 * 0.05 + 0.25 * 0.2
    low = mean - math.sqrt((0.75 * (0.05 - one.low)) ** 2 + (0.25 * (0.2 - other.low)) ** 2)
    high = mean + math.sqrt((0.75 * (one.high - 0.05)) ** 2 + (0.25 * (other.high - 0.2)) ** 2)
    assert both.mean == pytest.approx(mean)
    np.testing.assert_allclose(both.interval, (low, high), atol=1e-12)


@pytest.mark.parametrize("probabilities", [(0.02, 0.3, 0.0), (0.005, 0.004, 0.15, 0.0, 0.01, 0.0)])
def test_intervals_cover_the_truth_as_often_as_they_say(probabilities):
    """Of independent places with known probabilities, in 95 of 100 draws, or a little more where hardly any is missed."""
    rng = np.random.default_rng(2)
    truth = np.mean(probabilities)
    draws = 1500
    hits = 0
    for _ in range(draws):
        low, high = found([rng.random(256) < p for p in probabilities]).interval
        hits += low <= truth <= high
    assert 0.935 < hits / draws < 0.99


def test_two_rigs_compared_by_hand():
    """Mean and standard error of the differences at common places, weighted."""
    rng = np.random.default_rng(4)
    a = [rng.random(50), rng.random(80)]
    b = [rng.random(50), rng.random(80)]
    change, error = found(a, [1, 3]).compared(found(b, [1, 3]))
    first, second = b[0] - a[0], b[1] - a[1]
    assert change == pytest.approx(0.25 * first.mean() + 0.75 * second.mean())
    variance = sum(
        w**2 * ((d - d.mean()) ** 2).sum() / (len(d) - 1) / len(d) for w, d in ((0.25, first), (0.75, second))
    )
    assert error == pytest.approx(math.sqrt(variance))
    same, none = found(a).compared(found(a))
    assert same == 0
    assert none == 0


PLAIN = """region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
VEHICLE
sensors: [{model: SENSOR, min: {position_m: [0, 0, 1.5], rpy_deg: [0, 0, 0]}, max: {position_m: [0, 0, 2], rpy_deg: [0, 0, 0]}}]
objective: {misses: MISSES}
solver: {method: auto, evaluations: 1, seed: 1}
"""
VEHICLE = "vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4]}]}"


@pytest.mark.parametrize(
    ("misses", "said"),
    [
        ("{objects: {horse: 1}}", "objective.misses: no object is called 'horse'; allowed: car, child"),
        ("{objects: {}}", "objective.misses.objects: "),
        ("{objects: {child: 0}}", "objective.misses.objects.child: 0 is too small; allowed: at least 1e-09"),
        ("{objects: {child: -1}}", "objective.misses.objects.child: -1 is too small; allowed: at least 1e-09"),
        ("{objects: {child: .nan}}", "objective.misses.objects.child: "),
        ("{returns: 0}", "objective.misses.returns: 0 is too small; allowed: at least 1"),
        ("{returns: 1.5}", "objective.misses.returns: 1.5 "),
        ("{returns: 1001}", "objective.misses.returns: 1001 is too large; allowed: at most 1000"),
        ("{within_m: [5, 1]}", "objective.misses.within_m[1]: 1 is not above 5"),
        ("{within_m: [-1, 1]}", "objective.misses.within_m[0]: -1 is too small"),
        ("{within_m: [1]}", "objective.misses.within_m"),
        ("{sector_deg: [30, 30]}", "objective.misses.sector_deg[1]: 30 is not above 30"),
        ("{sector_deg: [0, 400]}", "objective.misses.sector_deg[1]: 400 is too large"),
        ("{weight: 0}", "objective.misses.weight: 0 is too small; allowed: at least 1e-09"),
        ("{places: 3}", "objective.misses.places: unknown key"),
        ("3", "objective.misses: "),
    ],
)
def test_a_bad_value_is_one_line(misses, said, tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(PLAIN.replace("MISSES", misses).replace("VEHICLE", VEHICLE).replace("SENSOR", "vlp-16"))
    refused_in_one_line(path, said, "validate")


def refused_in_one_line(path, said, *words):
    done = lidarcfg(*words, path, code=2)
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith(f"lidarcfg: {path}:"), done.stderr
    assert said in done.stderr, done.stderr


def test_without_a_vehicle_there_is_nothing_to_miss_around(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(PLAIN.replace("MISSES", "{}").replace("VEHICLE\n", "").replace("SENSOR", "vlp-16"))
    refused_in_one_line(path, "objective.misses: ", "validate")


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ("", "sensor 'bare' has no codec, which would say where its lasers fire; add firing to its file"),
        ("firing: {step_deg: 1}\n", "sensor 'bare' has no range facts"),
    ],
)
def test_a_sensor_that_lacks_facts_is_refused(tmp_path, facts, said):
    """Its file has beams, and no more or no range."""
    (tmp_path / "bare.yaml").write_text(f"name: bare\nbeams: {{elevation_deg: [-10, 0]}}\n{facts}")
    path = tmp_path / "study.yaml"
    path.write_text(PLAIN.replace("MISSES", "{}").replace("VEHICLE", VEHICLE).replace("SENSOR", "bare.yaml"))
    done = lidarcfg("optimize", path, "-o", tmp_path / "out", "--evaluations", 1, code=2)
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert said in done.stderr


def test_a_zone_without_room_says_what_to_widen(tmp_path):
    """A sliver in which no place of two million is."""
    path = tmp_path / "study.yaml"
    misses = "{objects: {post: 1}, within_m: [0.1, 0.1000001], sector_deg: [0, 0.0001]}"
    path.write_text(PLAIN.replace("MISSES", misses).replace("VEHICLE", VEHICLE).replace("SENSOR", "vlp-16"))
    done = lidarcfg("optimize", path, "-o", tmp_path / "out", "--evaluations", 1, code=2)
    assert "post: hardly a place in the zone is free; widen within_m or sector_deg" in done.stderr
