"""Shadows on paper and beside Open3D's rays; and that no thin part of a body hides an object or a post unseen."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import shapely

from lidarcfg.geometry import pose, transform
from lidarcfg.requirements.object_judge import ObjectJudge, ObjectRequirement
from lidarcfg.requirements.post import PostJudge, PostRequirement
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.places import Stand, StandZone
from lidarcfg.returns.post_visibility import STEP_M, PostPlaces
from lidarcfg.returns.reach import reached
from lidarcfg.returns.silhouettes import MOST, Core, Silhouettes, centres_of
from lidarcfg.returns.target import box_target
from lidarcfg.search.optimize import optimize
from lidarcfg.study.loading import load_study
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.meshes import join_meshes
from lidarcfg.world.scene import build_scene
from lidarcfg.world.scene_file import SceneFile
from lidarcfg.world.tracer import NO_OBSTACLES, build_bvh, obstacles_of
from tests.requirements.cases import AROUND, BODY
from tests.returns_cases import at_place, box, mount
from tests.simulate.test_returns import obstacles

AHEAD, BEHIND = (265.0, 95.0), (90.0, 270.0)  # fields of view
AREA = shapely.box(-10, -10, 10, 10)


@pytest.fixture(scope="module")
def fan(tmp_path_factory):
    """A sensor that has beams every so many degrees, from 14° up to 42° down, in steps of so many degrees of azimuth."""

    def made(between_deg, step_deg, position_m, rpy_deg=(0, 0, 0), fov_deg=None, folder=None):
        path = (folder or tmp_path_factory.mktemp("fan")) / "fan.yaml"
        elevation_deg = np.arange(14.0, -42.0, -between_deg).round(3).tolist()
        facts = {"beams": {"elevation_deg": elevation_deg}, "range": {"min_m": 0.1, "max_m": 60}}
        path.write_text(json.dumps({"name": "fan", **facts, "firing": {"step_deg": step_deg}}))
        return mount(str(path), tuple(map(float, position_m)), rpy_deg, 600.0, fov_deg)

    return made


def bar(at_m, size_m, rpy_rad):
    """A box with its middle at a point."""
    corners, faces = box(*size_m)
    return transform(pose(at_m, rpy_rad), corners - (0, 0, size_m[2] / 2)), faces


def requirement(size_m, within_m, **changes):
    """A box around BODY."""
    target = box_target(size_m)
    stand = Stand(StandZone(Footprint.of(BODY), within_m), Footprint.of(target.mesh), np.zeros(1), 0.0)
    return ObjectRequirement(
        **{"name": "box", "target": target, "stand": stand, "returns": 3, "obstacles": AROUND} | changes
    )


def barred(rng, fan):
    """Dense sensors ahead, each with a bar that may just hide an object, and a coarse one behind; more bars at random."""
    count = int(rng.integers(1, 4))
    turn_deg = rng.uniform(0, 360)
    low, high = (-0.9, -0.4, 1.8), (0.9, 0.4, 2.2)
    mounts = [fan(1.2, 0.45, rng.uniform(low, high), (0, 0, turn_deg), BEHIND)]
    for n in range(count):
        roll, pitch = rng.uniform(-8, 8, 2) * rng.integers(0, 2)
        one = fan(0.5, (0.1, 0.15, 0.2)[n], rng.uniform(low, high), (roll, pitch, turn_deg), AHEAD)
        mounts.append(replace(one, name=f"s{n}"))
    width_m, height_m, least_m = rng.uniform((0.06, 0.6, 5.0), (0.15, 1.1, 9.0))
    azimuth = math.radians(turn_deg) + rng.uniform(-1.2, 1.2)
    at_m = np.array([math.cos(azimuth), math.sin(azimuth)]) * (least_m + 1.8)
    bars = []
    for one in mounts[1:]:
        start_m = np.array(one.position_m)
        way_m = at_m + rng.normal(0, 0.01, 2) - start_m[:2]
        share = rng.uniform(0.35, 1.5) / np.linalg.norm(way_m)
        thick_m = width_m * share * rng.uniform(1.02, 1.6)
        middle_m = (*(start_m[:2] + share * way_m), start_m[2] + share * (0.5 - start_m[2]))
        leaning = rng.choice([0.0, rng.uniform(-0.25, 0.25)])
        size_m = (thick_m, rng.choice([thick_m, rng.uniform(0.1, 0.4)]), rng.uniform(0.8, 1.4))
        bars.append(bar(middle_m, size_m, (0.0, leaning, math.atan2(way_m[1], way_m[0]))))
    for _ in range(int(rng.integers(0, 4))):
        size_m = (*[rng.uniform(0.005, 0.02)] * 2, rng.uniform(0.3, 1.2))
        bars.append(bar(rng.uniform((-1.2, -0.8, 1.3), (1.2, 0.8, 2.0)), size_m, rng.uniform(0, math.pi, 3)))
    around = obstacles(join_meshes([BODY, *bars]))
    item = requirement((width_m, width_m, height_m), (least_m, least_m + 2.0), obstacles=around)
    return item, mounts, around


def brute_force(item, mounts, around, step_m):
    """The least count, up to 20, at all places of a grid in the zone."""
    reach_m = 3 + item.stand.zone.within_m[1]
    ticks = np.arange(-reach_m, reach_m, step_m)
    places = item.stand.standing(np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2))
    lowest = lowest_at(places, item.target, mounts, around, 20, 9)
    return int(reached(lowest.counts, item.lost, item.sensors).min())


def open3d_hides(mesh, origin_m, points_m):
    """Which points (n, 3) a mesh hides from a place."""
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(mesh[0].astype(np.float32), mesh[1].astype(np.uint32))
    rays = np.concatenate([np.broadcast_to(origin_m, points_m.shape), points_m - origin_m], axis=1)
    return caster.test_occlusions(o3d.core.Tensor(rays.astype(np.float32)), tnear=1e-6, tfar=1.0).numpy()


def difference_m2(shadow, *corners_m):
    """The area by which a shadow differs from a polygon."""
    return shadow.symmetric_difference(shapely.Polygon(corners_m)).area


def test_a_plates_shadow_on_paper():
    """An upright plate 1 m off, 0.4 m wide, from 1 m to 1.5 m high. From 2 m, its shadow on the ground is from 2 m to 4 m
    off, two to four times as wide; at 1.2 m it begins at the plate; from 1.25 m it has no end."""
    plate = np.array([[1.0, y, z] for y in (-0.2, 0.2) for z in (1.0, 1.5)]), np.array([[0, 2, 3], [0, 3, 1]])
    seen = Silhouettes(obstacles(plate))
    high_m, low_m = np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.25])
    ground = seen.shadow(high_m, 0.0, AREA.bounds)
    assert difference_m2(ground, (2, -0.4), (2, 0.4), (4, 0.8), (4, -0.8)) < 1e-3
    upper = seen.shadow(high_m, 1.2, AREA.bounds)
    assert difference_m2(upper, (1, -0.2), (1, 0.2), (1.6, 0.32), (1.6, -0.32)) < 1e-3
    endless = seen.shadow(low_m, 0.0, AREA.bounds)
    assert difference_m2(endless, (5, -1), (5, 1), (10, 2), (10, -2)) < 1e-3


def box_and_bars():
    """BODY and bars in any direction."""
    rng = np.random.default_rng(3)
    bars = [bar(rng.uniform((-1, -1, 1), (1, 1, 2)), (0.03, 0.05, 1.0), rng.uniform(0, 3, 3)) for _ in range(5)]
    mesh = join_meshes([BODY, *bars])
    return mesh, obstacles(mesh)


def sphere_and_cylinder():
    """Bodies that are no triangles, and close facets."""
    sphere = {"name": "sphere", "reflectivity": 9, "center_m": (0.8, 0.9, 1.0), "radius_m": 0.4}
    cylinder = {"name": "pole", "reflectivity": 9, "base_m": (-1.3, 0.2, 0.1), "radius_m": 0.1, "height_m": 1.6}
    scene = build_scene(SceneFile(name="round", spheres=(sphere,), cylinders=(cylinder,)), Path())
    around_m = np.array([1.0, 2.0, 3.0])
    return scene.mesh(1e-4), obstacles_of(build_bvh(scene, np.ones(2, bool), around_m), around_m)


@pytest.mark.parametrize("bodies", [box_and_bars, sphere_and_cylinder])
def test_shadows_are_open3ds(bodies):
    """From above and from below, and on planes just below a sensor; but for points within 3 mm of the outline."""
    mesh, around = bodies()
    seen = Silhouettes(around)
    rng = np.random.default_rng(4)
    wrong = hidden_in_all = 0
    for n in range(15):
        origin_m = rng.uniform((-1.5, -1.5, 0.3), (1.5, 1.5, 2.2))
        z_m = (rng.uniform(0.1, 1.2), rng.uniform(1.2, 3.0), origin_m[2] - 0.01)[n % 3]
        shadow = seen.shadow(origin_m, z_m, AREA.bounds)
        at_m = rng.uniform(-10, 10, (4000, 2))
        near = shapely.dwithin(shadow.boundary, shapely.points(at_m), 3e-3)
        points_m = np.column_stack([at_m, np.full(len(at_m), z_m)])[~near]
        hidden = open3d_hides(mesh, origin_m, points_m)
        wrong += int((shapely.contains_xy(shadow, *points_m[:, :2].T) != hidden).sum())
        hidden_in_all += int(hidden.sum())
    assert wrong == 0
    assert hidden_in_all > 1000


def antenna(fan):
    """An antenna 2 cm thick, 1.2 m ahead of a dense sensor; a coarse one sees what is behind it."""
    mast = bar((1.2, 0.26, 1.9), (0.02, 0.022, 0.8), (0, 0, 0))
    mounts = (fan(0.5, 0.1, (0, 0.26, 1.9), fov_deg=AHEAD), fan(1.2, 0.45, (0, 0.26, 1.9), fov_deg=BEHIND))
    return mounts, join_meshes([BODY, mast])


def test_an_antenna_hides_an_object(fan):
    """None of the base grid's places is hidden, and one in the antenna's shadow is: by Open3D, at all azimuths."""
    mounts, mesh = antenna(fan)
    judge = ObjectJudge(requirement((0.1, 0.1, 1.0), (6, 12), obstacles=obstacles(mesh)))
    assert judge.reach.measured(mounts, 100).values.min() > 0
    found = judge.judge(mounts)
    assert found.reached == 0
    assert not found.passed
    assert "in the middle of narrow shadows" in found.sampling.text
    post = at_place(box(0.1, 0.1, 1.0), (found.worst.x_m, found.worst.y_m, 0.0, 0.0))
    azimuth = math.atan2(found.worst.y_m - 0.26, found.worst.x_m) + np.radians(np.arange(-2, 2, 0.002))
    elevation = np.radians(np.arange(14.0, -42.0, -0.5))[:, None]
    ways = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation) + 0 * azimuth]
    rays = np.concatenate(
        [np.full((azimuth.size * elevation.size, 3), (0, 0.26, 1.9)), np.stack(ways, -1).reshape(-1, 3)], 1
    )
    for bodies, hits in (([post, mesh], False), ([post], True)):
        caster = o3d.t.geometry.RaycastingScene()
        for vertices, triangles in bodies:
            caster.add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
        first = caster.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["geometry_ids"].numpy()
        assert (first == 0).any() == hits


def test_an_antenna_hides_posts_between_the_azimuths(fan):
    """By brute force along azimuths 0.05° apart, for longer than along whole degrees."""
    mounts, mesh = antenna(fan)
    posts = PostPlaces.around(
        Footprint.of(BODY), 0.0, (2.0, 9.0), StandZone(Footprint.of(BODY), sector_rad=(-0.5, 0.5))
    )
    item = PostRequirement("post", posts, 1.0, None, 0.3, obstacles(mesh))
    fine = posts.along(np.arange(-1.0, 5.0, 0.05) % 360)
    longest_m = {}
    for name, some in (("even", posts), ("fine", fine)):
        counts = lowest_at(some.counted, item.target, mounts, item.obstacles, 1, 3).counts
        longest_m[name] = longest_gap_m(some, (counts > 0).any(axis=1))
    found = PostJudge(item).judge(mounts)
    assert longest_m["fine"] > longest_m["even"] + 0.5
    assert found.reached == pytest.approx(longest_m["fine"], abs=2 * STEP_M)
    assert "in a narrow shadow between the azimuths" in found.notes[0]


def longest_gap_m(posts, seen):
    """Of some posts that count, those that are seen: the longest row of others beyond the first 0.5 m of seen ones;
    inf: there are none along some azimuth."""
    flags = np.zeros(posts.counts.shape, bool)
    flags[posts.counts] = seen
    longest = 0
    for row, counts in zip(flags, posts.counts, strict=True):
        told = "".join("+" if one else "-" for one in row[counts])
        begin = told.find("+" * 10)
        if told and begin < 0:
            return math.inf
        longest = max([longest, *(len(gap) for gap in told[max(begin, 0) :].split("+"))])
    return longest * STEP_M


def beside_brute_force(rigs, seed, fan):
    """Of random barred rigs: how many reach 0 by brute force, but not on the base grid; and those whose verdict misses a
    0, or is more than 1 above."""
    rng = np.random.default_rng(seed)
    between = 0
    wrong = []
    for number in range(rigs):
        item, mounts, around = barred(rng, fan)
        least = brute_force(item, mounts, around, 0.04)
        judge = ObjectJudge(item)
        between += least == 0 and judge.reach.measured(mounts, 20).values.min() > 0
        got = judge.judge(mounts).reached
        if got > least + 1 or (least == 0 and got > 0):
            wrong.append((number, least, got))
    return between, wrong


@pytest.mark.slow
def test_beside_brute_force(fan):
    between, wrong = beside_brute_force(5, 2, fan)
    assert between >= 2
    assert wrong == []


@pytest.mark.nightly
def test_beside_brute_force_on_100_rigs(fan):
    between, wrong = beside_brute_force(100, 2, fan)
    assert between >= 30
    assert len(wrong) <= 2


def posts_beside_brute_force(rigs, seed, fan):
    """Of random barred rigs: how many have longer gaps along azimuths 0.2° apart than along whole degrees; and those
    whose verdict misses 0.2 m or more of these."""
    rng = np.random.default_rng(seed)
    between = 0
    wrong = []
    for number in range(rigs):
        item, mounts, around = barred(rng, fan)
        limit_m = item.stand.zone.within_m[1]
        posts = PostPlaces.around(Footprint.of(BODY), 0.0, (limit_m - 4, limit_m))
        post = PostRequirement("post", posts, float(item.target.size_m[2]), None, 0.3, around)
        even_m, fine_m = (
            longest_gap_m(some, (lowest_at(some.counted, post.target, mounts, around, 1, 9).counts > 0).any(axis=1))
            for some in (posts, posts.along(np.arange(0, 360, 0.2)))
        )
        between += fine_m > even_m + 0.2
        got_m = PostJudge(post).judge(mounts).reached
        if got_m < fine_m - 0.2:
            wrong.append((number, even_m, fine_m, got_m))
    return between, wrong


@pytest.mark.slow
def test_posts_beside_brute_force(fan):
    between, wrong = posts_beside_brute_force(3, 5, fan)
    assert between >= 2
    assert wrong == []


@pytest.mark.nightly
def test_posts_beside_brute_force_on_50_rigs(fan):
    between, wrong = posts_beside_brute_force(50, 6, fan)
    assert between >= 15
    assert len(wrong) <= 1


def test_a_plain_body_adds_few_places(fan):
    """All around a box its shadow is wide; what is narrow are places where the shadows of two sensors cross, if any."""
    item = requirement((0.4, 0.4, 1.0), (0.3, 8.0))
    seen = Silhouettes(obstacles(BODY))
    for count in (1, 2, 3):
        mounts = [fan(1.2, 0.45, (0.4 * n - 0.4, 0.2 * n, 1.5)) for n in range(count)]
        core = Core.of(0.4, 1.0, 0.0)
        places = seen.places(centres_of(mounts), core, item.stand.area, item.stand.far_step_m)
        assert len(places) < len(item.stand.base) / 10


def test_nothing_throws_no_shadow():
    places = Silhouettes(NO_OBSTACLES).places(np.array([[0.0, 0.0, 2.0]]), Core.of(0.4, 1.0, 0.0), AREA, 0.5)
    assert places.shape == (0, 2)


@pytest.mark.slow
def test_a_fence_adds_no_more_than_the_most():
    """60 pickets throw thousands of narrow shadows."""
    pickets = [bar((0.03 * n + 1.0, y, 1.0), (0.01, 0.01, 1.0), (0, 0, 0)) for n in range(30) for y in (0.0, 0.5)]
    centres_m = np.array([[0.0, -1.0, 1.4], [1.0, -1.2, 1.3]])
    seen = Silhouettes(obstacles(join_meshes(pickets)))
    places = seen.places(centres_m, Core.of(0.05, 0.6, 0.0), AREA, 0.25)
    assert len(np.unique(places, axis=0)) == MOST
    assert shapely.contains_xy(AREA, *places.T).all()


STUDY = """
region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
vehicle:
  boxes:
    - {name: body, center_m: [0, 0, 0.6], size_m: [2, 1, 1.2]}
    - {name: antenna, center_m: [1.2, 0.26, 1.9], size_m: [0.02, 0.022, 0.8]}
sensors:
  - {model: fan.yaml, min: {position_m: [0, 0.25, 1.9], rpy_deg: [0, 0, 0]}, max: {position_m: [0, 0.27, 1.9], rpy_deg: [0, 0, 0]}}
requirements:
  - {name: post, object: {size_m: [0.1, 0.1, 1.0]}, within_m: [6, 8], sector_deg: [-20, 20], headings_deg: [0], returns: 1}
solver: {method: annealing, evaluations: 30, seed: 1}
"""


@pytest.mark.slow
def test_a_search_learns_of_places_in_shadows(fan, tmp_path):
    """All its rigs meet the requirement at the base grid's places, and none in the antenna's shadow."""
    fan(0.5, 0.1, (0, 0, 0), folder=tmp_path)
    (tmp_path / "study.yaml").write_text(STUDY)
    study = load_study(tmp_path / "study.yaml")
    found = optimize(study, threads=1)
    (judge,) = Verifier(study.requirements).judges
    assert judge.reach.measured(found.rig.mounts, 100).values.min() > 0
    assert not found.verdict.passed
    assert found.verdict.requirements[0].reached == 0
    assert any("joined those that count" in remark for remark in found.remarks)
