"""The tracer against loops over all triangles, Open3D, half-spaces and closed forms; whatever travels together."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import directions, rotation
from lidarcfg.world.tracer import Tracer
from tests import ray_cases
from tests.capture_fixtures import scene
from tests.naive import rays as naive
from tests.ray_cases import soup, unit

TEXT = """
ground: {z_m: -1, reflectivity: 12}
boxes: [{name: box, center_m: [10, 0, 0], size_m: [2, 2, 1.5], reflectivity: 30}]
spheres: [{name: sphere, center_m: [0, 20, 0], radius_m: 3, reflectivity: 40}]
cylinders: [{name: post, base_m: [0, -20, -1], radius_m: 0.5, height_m: 3, reflectivity: 50}]
"""
HERE = np.zeros(3)


def of_mesh(vertices, triangles):
    """A tracer of a mesh alone."""
    return Tracer(ray_cases.mesh_scene(vertices, triangles), np.mean(vertices, axis=0))


def test_by_hand(tmp_path):
    tracer = Tracer(scene(tmp_path, TEXT), HERE)
    way = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], unit(np.array([3.0, 4, -1])), [0, -1, 0]])
    hits = tracer.cast(np.zeros((6, 3)), way)
    np.testing.assert_allclose(hits.range_m, [9, 17, np.inf, np.inf, np.sqrt(26), 19.5], atol=1e-12)
    assert hits.object.tolist() == [1, 2, -1, -1, 0, 3]
    assert (hits.triangle >= 0).tolist() == [True, False, False, False, False, False]
    normals = [[1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 1, 0]]
    np.testing.assert_allclose(abs(hits.normal), normals, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-3, 0.3, 3.0])
def test_first_hits_are_those_of_all_triangles(size):
    rng = np.random.default_rng(1)
    vertices, triangles = soup(rng, 3000, size)
    tracer = of_mesh(vertices, triangles)
    aims = vertices[triangles[rng.integers(len(triangles), size=4000)]].mean(axis=1)
    origins = rng.uniform(-8, 8, (4000, 3))
    way = unit(aims - origins)
    hits = tracer.cast(origins, way)
    range_m, which = naive.first_triangle(vertices, triangles, origins, way)
    assert np.isfinite(range_m).mean() > 0.99
    assert np.array_equal(hits.triangle, which)
    np.testing.assert_allclose(hits.range_m, range_m, rtol=1e-9)


@pytest.mark.slow
def test_first_hits_are_open3ds():
    """But for float32: where they differ by more than a millimetre, the loop over all triangles shows Open3D's error."""
    rng = np.random.default_rng(2)
    away = np.array([1000.0, -2000, 0])  # where float32 has steps of a tenth of a millimetre
    vertices, triangles = soup(rng, 5000, 0.1)
    vertices = vertices + away
    origins = rng.uniform(-8, 8, (100_000, 3)) + away
    way = unit(rng.normal(size=(100_000, 3)))
    theirs = ray_cases.open3d_scene(vertices, triangles)
    found = ray_cases.differences(of_mesh(vertices, triangles), theirs, origins, way)
    assert 10 < len(found.rays) < 2000
    np.testing.assert_allclose(found.mine, found.truth, rtol=1e-9)


# A large sphere has many triangles: always at the origin and farthest out.
AIMED = [
    pytest.param(
        name, place, marks=[pytest.mark.nightly] * (name == "large sphere" and place in ray_cases.BODIES_PLACES[1:3])
    )
    for name in ray_cases.BODIES
    for place in ray_cases.BODIES_PLACES
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "place"), AIMED)
def test_rays_at_vertices_and_edges_do_not_slip_through(tmp_path, name, place):
    large = name == "large sphere"  # finer in tools/stress.py
    rng = np.random.default_rng(4)
    body = ray_cases.body_at(tmp_path, name, place, 0.01 if large else 0.001)
    for inside in (True, False):
        aimed = ray_cases.aimed(body, inside, rng, 100 if large else 1000)
        assert len(aimed.way) > 50
        assert ray_cases.cast_aimed(aimed).max() < ray_cases.off_m(place)


def test_nothing_leaves_a_closed_body():
    """A hull with needles; rays from within to its vertices, along its edges, and anywhere."""
    rng = np.random.default_rng(6)
    points = unit(rng.normal(size=(2000, 3))) * (3.0, 2.0, 0.01) + (8, 3, 1)
    faces = ConvexHull(points).simplices.astype(np.int64)
    corners = points[faces]
    aims = np.concatenate([points, (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2, corners.mean(axis=1)])
    way = np.concatenate([unit(aims - (8, 3, 1)), unit(rng.normal(size=(20_000, 3))), np.eye(3), -np.eye(3)])
    tracer = of_mesh(points, faces)
    assert np.isfinite(tracer.cast(np.tile([8.0, 3, 1], (len(way), 1)), way).range_m).all()


def test_a_packet_does_not_change_its_rays():
    """Bit for bit the same alone, in any order, and beside any others."""
    rng = np.random.default_rng(7)
    tracer = of_mesh(*soup(rng, 5000, 0.2))
    azimuth = np.linspace(0, 2 * np.pi, 3000)
    way = directions(azimuth, np.full(3000, 0.03))
    origins = np.tile([0.1, 0.2, 0.3], (3000, 1)) + 1e-3 * azimuth[:, None]
    together = tracer.cast(origins, way)
    order = rng.permutation(3000)
    shuffled = tracer.cast(origins[order], way[order])
    alone = [tracer.cast(origins[n : n + 1], way[n : n + 1]) for n in range(0, 3000, 7)]
    for key in ("range_m", "object", "triangle", "normal"):
        assert np.array_equal(getattr(shuffled, key), getattr(together, key)[order])
        assert np.array_equal(np.concatenate([getattr(one, key) for one in alone]), getattr(together, key)[::7])


def test_a_limit_only_drops_what_is_beyond():
    rng = np.random.default_rng(8)
    tracer = of_mesh(*soup(rng, 5000, 0.2))
    origins = rng.uniform(-5, 5, (5000, 3))
    way = unit(rng.normal(size=(5000, 3)))
    free = tracer.cast(origins, way)
    limited = tracer.cast(origins, way, limit_m=2.0)
    near = free.range_m < 2
    assert near.any()
    assert np.array_equal(limited.range_m, np.where(near, free.range_m, np.inf))
    assert np.array_equal(limited.triangle, np.where(near, free.triangle, -1))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ray_cases.KINDS)
def test_exact_arithmetic_agrees(kind):
    """Up to 1e8 m from the origin: the range, and whether there is a hit."""
    rng = np.random.default_rng(5)
    found = [ray_cases.settled(ray_cases.case(rng, kind)) for _ in range(300)]
    assert not any(map(ray_cases.wrong, found))
    assert any(one.hit for one in found) or kind == "without area"
    assert min(one.sine for one in found) < (1e-8 if kind == "grazing" else 0.1)


def test_rays_along_axes(tmp_path):
    """Where a direction has zeros, also in the planes of boxes of the tree."""
    boxes = ", ".join(
        f"{{name: b{i}, center_m: [{x}, {y}, 0], size_m: [1, 1, 1], reflectivity: 9}}"
        for i, (x, y) in enumerate((x, y) for x in (-2, 0, 2) for y in (-2, 0, 2))
    )
    stage = scene(tmp_path, f"boxes: [{boxes}]")
    tracer = Tracer(stage, HERE)
    for axis in range(2):
        for sign in (1.0, -1.0):
            across = np.linspace(-3, 3, 601)
            origins = np.zeros((601, 3))
            way = np.zeros((601, 3))
            origins[:, axis] = -10 * sign
            origins[:, 1 - axis] = across
            way[:, axis] = sign
            range_m = tracer.cast(origins, way).range_m
            beside = abs(across - 2 * np.rint(across / 2))  # from the middle of the nearest row of boxes
            assert (range_m[beside < 0.5 - 1e-9] == 7.5).all()
            assert np.isinf(range_m[beside > 0.5 + 1e-9]).all()


def test_rays_that_start_on_a_surface(tmp_path):
    """They hit it at once or what is beyond it: never anything behind."""
    tracer = Tracer(
        scene(tmp_path, "boxes: [{name: b, center_m: [0, 0, 0], size_m: [2, 2, 2], reflectivity: 9}]"), HERE
    )
    rng = np.random.default_rng(8)
    origins = np.concatenate([np.full((5000, 1), 1.0), rng.uniform(-1, 1, (5000, 2))], axis=1)
    way = unit(rng.normal(size=(5000, 3)))
    hit = tracer.cast(origins, way).range_m
    out = way[:, 0] > 0
    assert (np.isinf(hit[out]) | (hit[out] < 1e-12)).all()
    with np.errstate(divide="ignore"):
        far = np.where(way > 0, (1 - origins) / way, (-1 - origins) / way).min(axis=1)
    assert ((hit[~out] < 1e-12) | (abs(hit[~out] - far[~out]) < 1e-12)).all()


def test_triangles_without_area_hide_nothing():
    vertices = np.array([[5.0, -1, -1], [5, 1, -1], [5, 0, 1], [3, 0, 0], [4, 0, 0]])
    tracer = of_mesh(vertices, [[0, 1, 2], [3, 3, 3], [3, 4, 4], [3, 4, 3], [0, 0, 2]])
    way = unit(np.array([[1.0, 0, 0], [5, 0.1, 0.1], [5, 3, 3]]))
    np.testing.assert_allclose(tracer.cast(np.zeros((3, 3)), way).range_m, [5, 5 / way[1, 0], np.inf], rtol=1e-12)


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3, 9e7])
def test_spheres_of_any_size(tmp_path, radius):
    """A ray that passes the centre at distance d enters sqrt(r² - d²) before the nearest point; and from inside."""
    stage = scene(
        tmp_path, f"spheres: [{{name: s, center_m: [0, {radius + 5}, 0], radius_m: {radius}, reflectivity: 9}}]"
    )
    tracer = Tracer(stage, HERE)
    d = np.linspace(0, min(radius, 1.0), 21)[:-1]
    origins = np.stack([d, 0 * d, 0 * d], axis=1)
    range_m = tracer.cast(origins, np.tile([0.0, 1, 0], (20, 1))).range_m
    height = [float(Fraction(x) ** 2 / (Fraction(radius) + Fraction(float(np.sqrt(radius**2 - x**2))))) for x in d]
    np.testing.assert_allclose(range_m, np.add(5, height), rtol=1e-9, atol=4e-16 * radius)
    inside = tracer.cast(np.array([[0.0, radius + 5, 0]]), unit(np.array([[1.0, 2, 3]]))).range_m
    assert inside == pytest.approx([radius])


@pytest.mark.slow
def test_spheres_and_cylinders_are_their_fine_meshes(tmp_path):
    stage = scene(tmp_path, TEXT.replace("ground: {z_m: -1, reflectivity: 12}", ""))
    vertices, triangles = stage.mesh(1e-3)
    rng = np.random.default_rng(9)
    origins = rng.uniform(-30, 30, (500, 3))
    centres = np.array([[10, 0, 0], [0, 20, 0], [0, -20, 0.5]])[rng.integers(3, size=500)]
    way = unit(centres + rng.normal(size=(500, 3)) - origins)
    hits = Tracer(stage, HERE).cast(origins, way)
    range_m, _ = naive.first_triangle(vertices, triangles, origins, way)
    with np.errstate(invalid="ignore"):
        cosine = abs((hits.normal * way).sum(axis=1))
        off = abs(hits.range_m - range_m)
    both = np.isfinite(hits.range_m) & np.isfinite(range_m) & (cosine > 0.05)
    assert both.sum() > 200
    assert (off[both] < 2e-3 / cosine[both]).all()
    assert (np.isfinite(hits.range_m) != np.isfinite(range_m))[cosine > 0.05].sum() == 0


def test_moving_objects_are_where_their_motion_says(tmp_path):
    """Boxes and spheres on straight lines and arcs, and rotating, against closed forms at each ray's time."""
    text = """
boxes:
  - {name: a, center_m: [10, 0, 0], size_m: [2, 1, 4], yaw_deg: 20, reflectivity: 9, motion: {velocity_m_s: [-5, 1, 0]}}
  - {name: b, center_m: [0, 12, 0], size_m: [3, 1, 4], reflectivity: 9, motion: {arc: {speed_m_s: 8, yaw_rate_deg_s: 90}}}
spheres: [{name: c, center_m: [-9, 0, 1], radius_m: 2, reflectivity: 9, motion: {velocity_m_s: [3, 3, 0]}}]
"""
    tracer = Tracer(scene(tmp_path, text), HERE)
    rng = np.random.default_rng(10)
    way = unit(rng.normal(size=(3000, 3)) * (1, 1, 0.1))
    time_ns = rng.integers(0, 2 * 10**9, 3000)
    hits = tracer.cast(np.zeros((3000, 3)), way, time_ns)
    assert len(set(hits.object.tolist())) == 4
    for ray, t, range_m, which in zip(way, time_ns / 1e9, hits.range_m, hits.object, strict=True):
        turn = np.radians(90) * t
        along = 8 / np.radians(90) * np.array([np.sin(turn), 1 - np.cos(turn), 0])
        found = (
            naive.box(HERE, ray, np.array([10 - 5 * t, t, 0]), (2, 1, 4), np.radians(20)),
            naive.box(HERE, ray, np.array([0, 12, 0]) + along, (3, 1, 4), turn),
            naive.sphere(HERE, ray, (-9 + 3 * t, 3 * t, 1), 2),
        )
        assert range_m == pytest.approx(min(found), rel=1e-9)
        assert which == (int(np.argmin(found)) if np.isfinite(min(found)) else -1)


@pytest.mark.slow
def test_two_thousand_moving_boxes(tmp_path):
    """Each at its place, whichever is near: against the few that a ray could hit."""
    rng = np.random.default_rng(11)
    place = rng.uniform(-80, 80, (2000, 2))
    speed = rng.uniform(-20, 20, (2000, 2))
    boxes = "\n".join(
        f"  - {{name: b{i}, center_m: [{x}, {y}, 0], size_m: [1, 1, 2], reflectivity: 9, motion: {{velocity_m_s: [{u}, {v}, 0]}}}}"
        for i, ((x, y), (u, v)) in enumerate(zip(place.tolist(), speed.tolist(), strict=True))
    )
    tracer = Tracer(scene(tmp_path, "boxes:\n" + boxes), HERE)
    azimuth = np.linspace(0, 2 * np.pi, 300)
    time_ns = np.linspace(0, 10**8, 300).astype(np.int64)
    way = directions(azimuth, np.zeros(300))
    hits = tracer.cast(np.zeros((300, 3)), way, time_ns)
    for n in range(0, 300, 5):
        at = np.column_stack([place + speed * time_ns[n] / 1e9, np.zeros(2000)])
        near = np.flatnonzero(np.linalg.norm(np.cross(at, way[n]), axis=1) < 1)
        expected = min((naive.box(HERE, way[n], at[i], (1, 1, 2), 0.0) for i in near), default=np.inf)
        assert hits.range_m[n] == pytest.approx(expected, rel=1e-9)


def test_a_dynamic_object_is_needed_only_within_its_poses(tmp_path):
    text = "{time_s: 0, position_m: [0, 0, 0]}, {time_s: 1, position_m: [1, 0, 0]}"
    stage = scene(
        tmp_path,
        f"spheres: [{{name: s, center_m: [9, 0, 0], radius_m: 1, reflectivity: 9, motion: {{poses: [{text}]}}}}]",
    )
    tracer = Tracer(stage, HERE)
    way = np.array([[1.0, 0, 0]])
    assert tracer.cast(np.zeros((1, 3)), way, np.array([10**9])).range_m == pytest.approx([9])
    with pytest.raises(ConfigError, match=r"s: a pose is needed at 1.5 to 1.5 s; the timed poses cover 0 to 1 s"):
        tracer.cast(np.zeros((1, 3)), way, np.array([1_500_000_000]))


def test_blocked_is_a_first_hit_before_the_target():
    """Rows of targets from one origin, against the first hits of the same rays; a target on a surface is not blocked."""
    rng = np.random.default_rng(12)
    vertices, triangles = soup(rng, 2000, 0.5)
    tracer = of_mesh(vertices, triangles)
    targets = np.stack(np.meshgrid(*(np.linspace(-6, 6, n) for n in (20, 21, 22)), indexing="ij"), -1).reshape(-1, 3)
    origin = np.array([0.3, 7.0, 0.2])
    length = np.linalg.norm(targets - origin, axis=1)
    first = tracer.cast(np.tile(origin, (len(targets), 1)), (targets - origin) / length[:, None]).range_m
    hidden = tracer.blocked(origin, targets)
    assert 0.2 < hidden.mean() < 0.99
    assert np.array_equal(hidden, first < length * (1 - 1e-9))
    on = vertices[triangles].mean(axis=1)
    theirs, _ = naive.first_triangle(vertices, triangles, np.tile(origin, (2000, 1)), unit(on - origin))
    assert np.array_equal(tracer.blocked(origin, on), theirs < np.linalg.norm(on - origin, axis=1) * (1 - 1e-9))


def test_spheres_and_cylinders_block_what_is_behind_them(tmp_path):
    """As their first hits say, and those of the sphere in closed form."""
    stage = scene(
        tmp_path,
        "spheres: [{name: s, center_m: [9, 0, 0], radius_m: 1, reflectivity: 9}]\n"
        "cylinders: [{name: c, base_m: [0, 9, -1], radius_m: 1, height_m: 2, reflectivity: 9}]",
    )
    rng = np.random.default_rng(14)
    targets = rng.uniform(-3, 3, (6000, 3)) + np.repeat([[12, 0, 0], [0, 12, 0]], 3000, axis=0)
    length = np.linalg.norm(targets, axis=1)
    way = targets / length[:, None]
    tracer = Tracer(stage, HERE)
    hidden = tracer.blocked(HERE, targets)
    assert 0.05 < hidden.mean() < 0.5
    assert np.array_equal(hidden, tracer.cast(np.zeros((6000, 3)), way).range_m < length)
    ball = [naive.sphere(HERE, d, np.array([9, 0, 0]), 1) for d in way[:3000]]
    assert np.array_equal(hidden[:3000], ball < length[:3000])


def test_a_rotated_scene_has_rotated_hits():
    """Any rotation of mesh and rays together leaves the ranges, to rounding."""
    rng = np.random.default_rng(13)
    vertices, triangles = soup(rng, 500, 1.0)
    origins = rng.uniform(-5, 5, (2000, 3))
    way = unit(rng.normal(size=(2000, 3)))
    straight = of_mesh(vertices, triangles).cast(origins, way)
    R = rotation((0.3, -0.8, 2.0))
    turned = of_mesh(vertices @ R.T, triangles).cast(origins @ R.T, way @ R.T)
    same = straight.triangle == turned.triangle
    assert same.mean() > 0.999
    np.testing.assert_allclose(turned.range_m[same], straight.range_m[same], rtol=1e-9)
