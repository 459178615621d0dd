"""Rays against a plane, a sphere and a box, worked on paper, and against half-spaces at their very edges."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from lidarcfg.geometry import directions
from lidarcfg.world.kernels import NOTHING, Nearest, Rays
from lidarcfg.world.raycast import Raycaster
from lidarcfg.world.triangles import FLAT, HAIR_M, PAST, RIM, SHARE, SHARP, Triangles, measured, met
from lidarcfg.world.turns import Turns
from tests import edges
from tests.capture_fixtures import scene
from tests.naive import placement as naive

TEXT = """
ground: {z_m: -1, reflectivity: 12}
boxes: [{name: box, center_m: [10, 0, 0], size_m: [2, 2, 1.5], reflectivity: 30}]
spheres: [{name: ball, center_m: [0, 20, 0], radius_m: 3, reflectivity: 40}]
"""


ONE = np.array([[0, 1, 2]])  # triangle


def nothing_known(count):
    return Nearest(np.full(count, np.inf), np.full(count, NOTHING, np.int32), np.zeros((count, 3), np.float32))


@pytest.fixture
def caster(tmp_path):
    return Raycaster(scene(tmp_path, TEXT), np.zeros(3))


def test_by_hand(caster):
    down = np.array([3, 4, -1]) / np.sqrt(26)
    rays = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], down])
    range_m, reflectivity, objects, *_ = caster.cast(np.zeros((5, 3)), rays)
    np.testing.assert_allclose(range_m, [9, 17, np.inf, np.inf, np.sqrt(26)], atol=1e-3)
    assert reflectivity.tolist() == [30, 40, 0, 0, 12]
    assert objects.tolist() == [1, 2, -1, -1, 0]


def test_sphere_off_centre(caster):
    """A ray that passes the centre at distance d enters sqrt(r² - d²) before the nearest point."""
    d = np.linspace(-2.5, 2.5, 21)
    origins = np.stack([d, 0 * d, 0 * d], axis=1)
    range_m, *_ = caster.cast(origins, np.tile([0.0, 1, 0], (21, 1)))
    slant = 3 / np.sqrt(9 - d**2)  # the facets' millimetre, seen aslant
    assert (abs(range_m - (20 - np.sqrt(9 - d**2))) <= 0.001 * slant).all()


def test_ground_is_good_to_100_m(tmp_path):
    caster = Raycaster(scene(tmp_path, "ground: {reflectivity: 12}"), np.array([0.0, 0, 2]))
    rng = np.random.default_rng(1)
    elevation, azimuth = -np.arcsin(2 / rng.uniform(2.01, 100, 50_000)), rng.uniform(0, 2 * np.pi, 50_000)
    rays = directions(azimuth, elevation)
    range_m, *_ = caster.cast(np.tile([0.0, 0, 2], (50_000, 1)), rays)
    error = abs(range_m + 2 / rays[:, 2])
    assert np.median(error) < 5e-6
    assert error.max() < 1e-4


def test_far_from_the_world_origin(tmp_path):
    """The same scene a million metres away, and back: the local frame keeps the millimetres."""
    far = np.array([1e6, -2e6, 50.0])
    text = "boxes: [{name: b, center_m: [1000007.5, -2000000, 50], size_m: [1, 9, 9], reflectivity: 1}]"
    caster = Raycaster(scene(tmp_path, text + "\nground: {z_m: 40, reflectivity: 1}"), far)
    range_m, *_ = caster.cast(np.array([far, far]), np.array([[1.0, 0, 0], [0, 0, -1]]))
    np.testing.assert_allclose(range_m, [7, 10], atol=1e-5)


@pytest.mark.parametrize("name", ["cube", "box", "ball", "cylinder", "mesh"])
@pytest.mark.parametrize("place", [(0, 0, 0), (20, 7, 1), (-80.3, 55.1, -2)])
def test_rays_at_vertices_and_edges_do_not_slip_through(tmp_path, name, place):
    """In plain float32 0.5 in a thousand of these do, and 2 of those at the ball."""
    rng = np.random.default_rng(4)
    for inside in (True, False):
        aimed = edges.aimed(tmp_path, name, place, inside, rng, 2000)
        caster = Raycaster(aimed.body, aimed.start)
        range_m = caster.cast(np.tile(aimed.start, (len(aimed.way), 1)), aimed.way)[0]
        error = abs(range_m - aimed.range_m)
        assert error.max() < 6e-4  # of rays that pass a corner within HAIR_M; of the others float64's
        assert np.quantile(error, 0.99) < 1e-11


def test_an_outline_is_sharp(tmp_path):
    """A micrometre beside a box rays pass by, though its triangles are larger for Open3D; a micrometre inside not."""
    stage = scene(tmp_path, "boxes: [{name: b, center_m: [30, 0, 0], size_m: [4, 2, 2], reflectivity: 9}]")
    along = np.random.default_rng(3).uniform(-0.99, 0.99, 2000)
    for out in (-1e-6, 1e-6):
        aim = np.stack([np.full(2000, 28.0), np.full(2000, 1 + out), along], axis=1)
        way = aim / np.linalg.norm(aim, axis=1)[:, None]
        origins = way * 3.0  # any on the way
        range_m = Raycaster(stage, np.zeros(3)).cast(origins, way)[0]
        front = aim[:, 0] / way[:, 0] - 3.0
        if out < 0:
            np.testing.assert_allclose(range_m, front, atol=1e-9)
        else:  # it passes the front, and leans away from the side
            assert np.isinf(range_m).all()


def test_open_sheets_end_at_their_edges(tmp_path):
    """A plane is no body: seen from both sides, up to its edge and not beyond."""
    stage = scene(tmp_path, "planes: [{name: p, center_m: [0, 0, 5], size_m: [2, 2], reflectivity: 9}]")
    x = np.array([0.0, 0.5, 1 - 1e-6, 1 + 1e-6, 1.01, -1 + 1e-6, -1 - 1e-6])
    for start, way in ((0.0, 1.0), (10.0, -1.0)):
        origins = np.stack([x, 0.3 * x, np.full(7, start)], axis=1)
        range_m = Raycaster(stage, np.zeros(3)).cast(origins, np.tile([0.0, 0, way], (7, 1)))[0]
        assert range_m.tolist() == [5, 5, 5, np.inf, np.inf, 5, np.inf]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4, 1e7])
def test_triangles_are_measured(scale):
    """Bit for bit as in plain loops: any, needles, and such as have no area."""
    rng = np.random.default_rng(7)
    vertices = rng.normal(size=(300, 3))
    vertices[100:200] = vertices[:100] + rng.normal(size=(100, 3)) * 10.0 ** -rng.integers(3, 16, (100, 1))
    vertices[200:] = 3 * vertices[:100]
    rows = np.arange(100)
    needles, flat = np.stack([rows, rows + 100, rows + 200], axis=1), np.stack([rows, rows + 200, rows], axis=1)
    faces = np.concatenate([rng.integers(0, 300, (300, 3)), needles, flat, np.full((1, 3), 5)])
    vertices *= scale
    objects = rng.integers(0, 2**31, len(faces)).astype(np.int32)
    facets, corners = measured(vertices, faces, objects)
    twin = naive.measured(vertices.tolist(), faces.tolist(), HAIR_M, SHARE, RIM, SHARP, FLAT)
    plane, hair, wide, moved = (np.array(values) for values in twin)
    assert np.array_equal(facets, np.column_stack([plane, hair, wide, objects, 0 * hair]))
    assert np.array_equal(corners, moved.reshape(-1, 3).astype(np.float32))
    assert all(len(values) == 0 for values in measured(vertices, faces[:0], objects[:0]))


def test_which_rays_pass_beside_their_triangle():
    """The kernel against plain areas: a point of a triangle's plane is outside if its three shares do not add up."""
    rng, place = np.random.default_rng(5), np.array((0.5, -1, 2))
    vertices = np.add(rng.normal(size=(3, 3)), (0, 0, 6))  # relative to the place, where the rays start
    a, b, c = vertices.tolist()
    aims = rng.dirichlet(np.ones(3), 500) @ vertices + rng.normal(size=(500, 3)) * 1e-4
    way = aims / np.linalg.norm(aims, axis=1)[:, None]
    normal = np.cross(np.subtract(b, a), np.subtract(c, a))
    hit_m = (normal @ a / (way @ normal)).astype(np.float32)
    hit_m[::7], hit_m[1::7] = np.inf, 0.5
    uv, nearest = np.full((500, 2), 0.3, np.float32), nothing_known(500)
    nearest.range_m[2::7] = 0.1
    facets = np.array([[*normal, normal @ a, 1e-4, np.inf, 5, 0]])
    rays, zero = Rays(np.tile(place, (500, 1)), way, np.arange(500)), np.zeros(500, np.uint32)
    given = rays.origins_m, rays, np.arange(500), place, np.eye(3)[None], hit_m, zero, uv, facets, vertices, ONE
    rows, moved = met(*given, False, nearest)
    outside = []
    for i, ray in enumerate(way.tolist()):
        exact = np.dot(normal, a) / np.dot(normal, ray)
        p = np.multiply(exact, ray)
        shares = [np.linalg.norm(np.cross(np.subtract(q, p), np.subtract(r, p))) for q, r in ((a, b), (b, c), (c, a))]
        if sum(shares) > np.linalg.norm(normal) * (1 + 1e-9) and i % 7:
            outside.append(i)
    assert 0 < len(outside) < 100
    assert rows.tolist() == outside
    assert np.isinf(nearest.range_m[[i for i in outside if i % 7 != 2]]).all()  # not yet
    assert not len(met(*given, True, nearest)[0])
    for i, ray in enumerate(way.tolist()):
        exact = np.dot(normal, a) / np.dot(normal, ray)
        expected = [np.inf, 0.5, 0.1][i % 7] if i % 7 < 3 else exact  # nothing; the plane is too far; nearer is known
        assert nearest.range_m[i] == pytest.approx(expected, rel=1e-12)
        assert nearest.object[i] == (NOTHING if i % 7 in (0, 2) else 5)
        assert nearest.normal[i] == pytest.approx(0 * normal if i % 7 in (0, 2) else normal)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), PAST * 1e-4)
    np.testing.assert_allclose(moved @ normal, 0, atol=1e-15)  # in the plane
    middle = vertices.mean(axis=0)
    assert (((aims[rows] - middle) * moved).sum(axis=1) > 0).all()  # and away from the triangle


def test_a_mesh_as_fine_as_a_hair(tmp_path):
    """A ball of 2 cm whose triangles' edges are half a millimetre: none is larger than its neighbours leave room for."""
    rng = np.random.default_rng(6)
    points = rng.normal(size=(5000, 3))
    vertices = points * 0.01 / np.linalg.norm(points, axis=1)[:, None] + (8, 3, 1)
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    way = rng.normal(size=(1000, 3)) * 0.003 + (8, 3, 1)
    way /= np.linalg.norm(way, axis=1)[:, None]
    enter, _, depth = edges.through(edges.half_spaces(vertices[faces], np.array((8.0, 3, 1))), np.zeros(3), way)
    triangles, nearest = Triangles(vertices, faces, np.zeros(len(faces), np.int32), Turns()), nothing_known(len(way))
    deep = depth > 1e-3
    rays = Rays(np.zeros_like(way), way, np.arange(len(way)))
    triangles.cast(rays, np.flatnonzero(deep), np.zeros(3), np.eye(3)[None], nearest)
    assert deep.sum() > 900
    assert abs(nearest.range_m - enter)[deep].max() < 1e-5
    assert np.isinf(nearest.range_m[~deep]).all()


def test_a_ray_that_starts_on_a_plane_is_nowhere_behind_its_start():
    """Found by tools/stress.py: float32 lost the 8e-12 m by which the ray starts beyond, and the plane gave them back."""
    rays = Rays(np.array([[1 + 8e-12, 0, 0]]), np.array([[1.0, 0, 0]]), np.arange(1))
    hit_m, triangle, uv = np.zeros(1, np.float32), np.zeros(1, np.uint32), np.full((1, 2), 0.3, np.float32)
    corners, facets = np.array([[1.0, -1, -1], [1, 2, -1], [1, -1, 2]]), np.array([[1.0, 0, 0, 1, 1e-4, 1e-3, 0, 0]])
    mesh, nearest = (facets, corners, ONE), nothing_known(1)
    again, _ = met(rays.origins_m, rays, np.arange(1), np.zeros(3), np.eye(3)[None], hit_m, triangle, uv, *mesh, False, nearest)  # fmt: skip
    assert nearest.range_m[0] == 0
    assert not len(again)
