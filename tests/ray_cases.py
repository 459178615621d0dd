"""Hard rays: at the vertices and edges of convex bodies, at slivers, grazing, far away; and who is right about them."""

from typing import NamedTuple

import numpy as np
import open3d as o3d
from scipy.spatial import ConvexHull

from lidarcfg.world.scene import Scene
from lidarcfg.world.scene_file import SceneFile
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import scene
from tests.naive import rays as naive

BODIES = {
    "cube": "boxes: [{{name: b, center_m: {at}, size_m: [2, 2, 2], reflectivity: 9}}]",
    "box": "boxes: [{{name: b, center_m: {at}, size_m: [4.2, 1.8, 1.5], yaw_deg: 17, reflectivity: 9}}]",
    "cylinder": "cylinders: [{{name: c, base_m: {at}, radius_m: 0.4, height_m: 5, reflectivity: 9}}]",
    "mesh": "meshes: [{{name: m, file: m.ply, position_m: {at}, rpy_deg: [10, 20, 30], reflectivity: 7}}]",
    "sphere": "spheres: [{{name: s, center_m: {at}, radius_m: 1, reflectivity: 9}}]",
    "large sphere": "spheres: [{{name: s, center_m: {at}, radius_m: 20, reflectivity: 9}}]",
}
BODIES_PLACES = ((0, 0, 0), (-80.3, 55.1, -2), (4e5, 3e6, 10), (9e7, -9e7, 1e3))
PLY = """ply
format ascii 1.0
element vertex {n}
property double x
property double y
property double z
element face {m}
property list uchar int vertex_indices
end_header
"""
GRAZED_M = 1e-3  # how deep a ray must go into a body, so that it does not only graze its outline
DIFFERENT_M = 1e-3  # ranges of ours and Open3D's that are further apart are looked into
KINDS = ("anywhere", "along an axis", "grazing", "at an edge", "sliver", "without area", "from the surface")
PLANE_OFF = 1e-10
EDGE_OFF = 1e-15
RANGE_OFF = 1e-9  # at most, as fractions of the distance
GRAZING = 1e-5  # the sine of the angle to a triangle below which a range is only as good as its plane
PLACES_M = (0.0, 1e3, -1e6, 9.9e7)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def mesh_scene(vertices, triangles):
    """A scene of a mesh alone."""
    return Scene(
        file=SceneFile(name="mesh"),
        names=("mesh",),
        reflectivity=np.array([9], np.uint8),
        vertices_m=np.asarray(vertices, float),
        triangles=np.asarray(triangles),
        triangle_object=np.zeros(len(triangles), np.int32),
        motions=(None,),
        places_m=np.zeros((1, 3)),
    )


def soup(rng, count, size):
    """Random triangles of a size in a cube of ten metres."""
    corners = rng.uniform(-5, 5, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * size
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


# Closed bodies


class Aimed(NamedTuple):
    """Rays from one place."""

    body: Scene
    start: np.ndarray  # (3,)
    way: np.ndarray  # (N, 3) unit vectors
    range_m: np.ndarray  # (N,) how far each gets


def ellipsoid(folder, points=300):
    """A closed mesh of odd triangles, in a file: the hull of random points on an ellipsoid."""
    point = np.random.default_rng(1).normal(size=(points, 3))
    point *= (2.0, 1.3, 0.8) / np.linalg.norm(point, axis=1)[:, None]
    faces = ConvexHull(point).simplices
    rows = [" ".join(map(repr, row)) for row in point.tolist()] + [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    (folder / "m.ply").write_text(PLY.format(n=points, m=len(faces)) + "\n".join(rows) + "\n")


def body_at(folder, name, place, tolerance_m=0.001):
    """A body as a mesh, no farther off than that, its centre at a place (3,)."""
    ellipsoid(folder)
    body = scene(folder, BODIES[name].format(at=[float(x) for x in place]))
    return mesh_scene(*body.mesh(tolerance_m))


def aimed(body, inside, rng, count):
    """Of `count` rays aimed at vertices and edges of a convex body, from inside or outside, those that surely hit it."""
    vertices = body.vertices_m
    triangles = body.triangles
    which = rng.integers(len(triangles), size=count)
    corner = rng.integers(3, size=count)
    part = rng.choice((0.0, 1 / 3, 0.5, 0.9), (count, 1))  # 0: a vertex
    one, other = vertices[triangles[which, corner]], vertices[triangles[which, (corner + 1) % 3]]
    aim = (1 - part) * one + part * other
    middle = vertices.mean(axis=0)
    beside = rng.uniform(-0.1, 0.1, 3) * bool(rng.integers(2))
    start = middle + (beside if inside else unit(rng.normal(size=3)) * rng.uniform(35, 300))
    way = unit(aim - start)
    enter, leave, depth = through(half_spaces(vertices[triangles] - middle), start - middle, way)
    deep = depth > GRAZED_M
    return Aimed(body, start, way[deep], (leave if inside else enter)[deep])


def half_spaces(corners):
    """(planes, 4) n·p ≤ d of the triangles of a convex body around the origin, n of unit length."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    has_area = length > 1e-12
    normal = normal[has_area] / length[has_area, None]
    corner = corners[has_area, 0]
    offset = (corner * normal).sum(axis=1)
    planes = np.column_stack([normal * np.sign(offset)[:, None], np.abs(offset)])
    return planes[np.unique(planes.round(9), axis=0, return_index=True)[1]]


def through(planes, start, way):
    """Where rays (N, 3) enter and leave the half-spaces' common body, and how deep in it they are halfway."""
    x, y, z = np.ascontiguousarray(way.T)
    enter = np.full(len(way), -np.inf)
    leave = np.full(len(way), np.inf)
    depth = np.full(len(way), np.inf)
    room = [d - a * start[0] - b * start[1] - c * start[2] for a, b, c, d in planes]
    for (a, b, c, _), left in zip(planes, room, strict=True):
        rise = a * x + b * y + c * z
        with np.errstate(divide="ignore", invalid="ignore"):
            met = left / rise
        enter = np.where(rise < 0, np.maximum(enter, met), enter)  # the last way in
        leave = np.where(rise > 0, np.minimum(leave, met), leave)  # the first way out
    half = (np.maximum(enter, 0.0) + leave) / 2
    for (a, b, c, _), left in zip(planes, room, strict=True):
        depth = np.minimum(depth, left - (a * x + b * y + c * z) * half)
    return np.array([enter, leave, depth])


def cast_aimed(aimed_rays):
    """How far off the tracer is (N,), in metres; inf where a ray slips through."""
    origins = np.tile(aimed_rays.start, (len(aimed_rays.way), 1))
    return abs(Tracer(aimed_rays.body, aimed_rays.start).cast(origins, aimed_rays.way).range_m - aimed_rays.range_m)


def off_m(place):
    """How far off a range may be: coordinates far away are rounded, which tilts small triangles."""
    return 1e-9 + 100 * np.spacing(np.abs(place).max())


# Beside Open3D


class Differences(NamedTuple):
    """Rays about which the tracer and Open3D differ."""

    rays: np.ndarray  # (D,) which
    mine: np.ndarray  # (D,) range, inf: nothing
    theirs: np.ndarray  # (D,)
    truth: np.ndarray  # (D,) by a float64 loop over all triangles


def open3d_scene(vertices, triangles):
    theirs = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    theirs.add_triangles(tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32)))
    return theirs


def differences(tracer, theirs, origins, way):
    """Ranges that differ by more than a millimetre, or hits that are misses; the scene is of triangles alone."""
    mine = tracer.cast(origins, way).range_m
    rays = o3d.core.Tensor.from_numpy(np.hstack([origins, way]).astype(np.float32))
    found = theirs.cast_rays(rays)["t_hit"].numpy().astype(np.float64)
    with np.errstate(invalid="ignore"):
        differ = np.flatnonzero(~(abs(mine - found) <= DIFFERENT_M) & ~(np.isinf(mine) & np.isinf(found)))
    stage = tracer.scene
    truth, _ = naive.first_triangle(stage.vertices_m, stage.triangles, origins[differ], way[differ])
    return Differences(differ, mine[differ], found[differ], truth)


# One ray and one triangle


class Case(NamedTuple):
    """A ray and a triangle, and the local origin of the tracer."""

    corners: np.ndarray  # (3, 3)
    origin: np.ndarray
    way: np.ndarray
    local_m: np.ndarray


class Judgement(NamedTuple):
    """How far a range is from what exact arithmetic says, as fractions of the distance."""

    plane: float  # the point hit, from the triangle's plane
    range: float  # along the ray, from the plane's exact range
    edge: float  # the ray's line from the nearest edge, where hit and miss are confused
    sine: float  # of the angle between ray and plane
    hit: bool  # exactly


def case(rng, kind):
    """A random case of a kind."""
    place = rng.choice(PLACES_M, 3)
    size = 10 ** rng.uniform(-2, 3)
    corners = np.round(rng.normal(size=(3, 3)) * size * 2**20) / 2**20
    if kind == "sliver":
        corners[2] = (corners[0] + corners[1]) / 2 + rng.normal(size=3) * size * 10 ** rng.uniform(-11, -3)
    elif kind == "without area":
        step = np.round(corners[1] * 2**10) / 2**10
        corners[1] = corners[0] + step
        corners[2] = corners[0] + rng.integers(0, 3) * step
    corners = corners + place
    if kind == "at an edge":
        weights = np.roll((0.0, *rng.choice([(0.5, 0.5), (1, 0), (0.1, 0.9)])), rng.integers(3))
    else:
        weights = rng.dirichlet((1, 1, 1))
    aim = weights @ corners
    edge = unit(corners[1] - corners[0] + 1e-300)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal = normal / max(np.linalg.norm(normal), 1e-300)
    way = unit(rng.normal(size=3))
    if kind == "along an axis":
        way = np.roll((rng.choice((-1.0, 1.0)), 0.0, 0.0), rng.integers(3))
    elif kind == "grazing":
        angle = 10 ** rng.uniform(-9, -1)
        turn = rng.uniform(0, 2 * np.pi)
        flat = np.cos(turn) * edge + np.sin(turn) * np.cross(normal, edge)
        way = unit(np.cos(angle) * flat + np.sin(angle) * normal)
    distance = 0.0 if kind == "from the surface" else size * 10 ** rng.uniform(-1, 3)
    origin = aim - way * distance
    if kind not in ("along an axis", "grazing") and distance:
        way = unit(aim - origin)
    return Case(corners, origin, way, (corners.mean(axis=0), np.zeros(3), origin)[rng.integers(3)])


def settled(one):
    """What exact arithmetic says of the tracer's range."""
    tracer = Tracer(mesh_scene(one.corners, [[0, 1, 2]]), one.local_m)
    found = float(tracer.cast(one.origin[None], one.way[None]).range_m[0])
    true = naive.exact(one.corners, one.origin, one.way)
    distance = float(np.linalg.norm(one.corners - one.origin, axis=1).max())
    off = abs(found - true.range_m) if np.isfinite(found) and true.range_m is not None else 0.0
    edge = true.beside_m / distance if np.isfinite(found) != true.hit else 0.0
    if true.range_m is not None and edge:  # where a ray starts on a surface, it is ahead or behind by rounding alone
        edge = min(edge, abs(true.range_m) * true.sine / distance)
    return Judgement(off * true.sine / distance, off / max(distance, 1e-300), edge, true.sine, true.hit)


def wrong(found):
    """Whether an error is more than rounding; at a grazing angle a range is only as good as its plane."""
    return found.plane > PLANE_OFF or found.edge > EDGE_OFF or (found.sine > GRAZING and found.range > RANGE_OFF)
