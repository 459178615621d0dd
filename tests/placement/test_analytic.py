"""The analytic measure against closed forms, quadrature, points on the cones with cuboids of 1/16 the edge, and
marching cubes; the sweep against plain loops.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import integrate as quadrature
from scipy import ndimage
from skimage import measure

from lidarcfg.cli.main import cli
from lidarcfg.core import analytic as core
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import up
from lidarcfg.placement.analytic import Analytic, analytic, error_bar, integrate, level
from lidarcfg.placement.cones import Lidar, gaps_at, rig_lidars
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import load_study
from lidarcfg.placement.subspace import segment
from lidarcfg.report.tables import analytic_line
from lidarcfg.sensors.rig import load_rig
from tests.naive import placement as naive

STUDIES = Path(__file__).parents[2] / "data/studies"
UP = (0.0, 0.0, 1.0)
GOLDEN = (5**0.5 - 1) / 2  # the lines' lattice is in step with no cone
TURNS = 360
STEPS = 160  # of the points on a cone


def cones(position, axis, elevation_deg):
    axis = np.asarray(axis, float)
    return Lidar(np.asarray(position, float), axis / np.linalg.norm(axis), np.sin(np.radians(elevation_deg)))


def bodies(region, lidars):
    """{digits: (volume, surface)} of the subspaces."""
    subspaces = segment(region, lidars)
    seen = integrate(subspaces, lidars)
    joined = seen.joined()
    wholes = np.unique(seen.whole)
    out = {tuple(subspaces.gap[j].tolist()): (joined.volume_m3[j], joined.surface_m2[j]) for j in wholes}
    assert len(out) == len(wholes)
    return out


def test_a_plane_along_the_walls():
    region = Region.from_boxes((0, 0, 0), (2, 1.5, 1), (0.1, 0.1, 0.1))
    found = bodies(region, [cones((0.7, 0.6, 0.3123), UP, [0.0])])
    for digit, height in ((0, 0.3123), (1, 1 - 0.3123)):
        assert found[(digit,)] == pytest.approx((3 * height, 2 * (3 + 3.5 * height)), rel=5e-4)


def test_a_plane_cuts_a_corner_off():
    region = Region.from_boxes((0, 0, 0), (1, 1, 1), (0.05, 0.05, 0.05))
    found = bodies(region, [cones((1 / 3, 1 / 3, 1 / 3), (1, 1, 1), [0.0])])
    assert found[(0,)] == pytest.approx((1 / 6, 1.5 + math.sqrt(3) / 2), rel=2e-3)
    assert found[(1,)] == pytest.approx((5 / 6, 4.5 + math.sqrt(3) / 2), rel=2e-3)


def cone(height, radius):
    """Volume and lateral surface."""
    return math.pi * radius**2 * height / 3, math.pi * radius * math.hypot(height, radius)


@pytest.mark.parametrize("tilt", [0.0, 90.0, 180.0, 270.0])
def test_a_cone_a_frustum_and_a_gap_between_two(tilt):
    """Their axes along z, y, −z and −y; the apex on a wall, behind it, and on a wall again."""
    axis = up((math.radians(tilt), 0.0, 0.0))
    region = Region.from_boxes((-1, -1, -1), (1, 1, 1), (0.05, 0.05, 0.05))
    steep = 1 / math.tan(math.radians(75))
    flat = 1 / math.tan(math.radians(68))

    v, s = cone(2.0, 2 * steep)
    found = bodies(region, [cones(-axis, axis, [75])])
    assert found[(1,)] == pytest.approx((v, s + math.pi * (2 * steep) ** 2), rel=2e-3)

    found = bodies(region, [cones(-1.4 * axis, axis, [75])])
    (v1, s1), (v0, s0) = cone(2.4, 2.4 * steep), cone(0.4, 0.4 * steep)
    assert found[(1,)] == pytest.approx((v1 - v0, s1 - s0 + math.pi * (2.4**2 + 0.4**2) * steep**2), rel=2e-3)

    found = bodies(region, [cones(-axis, axis, [68, 75])])
    (v1, s1), (v0, s0) = cone(2.0, 2 * flat), cone(2.0, 2 * steep)
    assert found[(1,)] == pytest.approx((v1 - v0, s1 + s0 + 4 * math.pi * (flat**2 - steep**2)), rel=2e-3)


def test_a_cone_through_walls_is_what_quadrature_says():
    """z >= r tan θ over a rectangle; every part of it is an integral over one angle, or along one wall."""
    a = 1.5
    b = 1.0
    height = 1.0
    slope = math.tan(math.radians(35))

    def radius(angle):
        wall = min(a / max(abs(math.cos(angle)), 1e-300), b / max(abs(math.sin(angle)), 1e-300))
        return min(wall, height / slope)

    def quarter(function):
        kinks = [math.atan2(b, a), math.acos(min(a * slope / height, 1)), math.asin(min(b * slope / height, 1))]
        return 4 * quadrature.quad(function, 0, math.pi / 2, points=kinks, epsabs=1e-12, epsrel=1e-12, limit=200)[0]

    def wall(far, half):  # at distance `far`, from −half to half
        edge = min(half, math.sqrt(max((height / slope) ** 2 - far**2, 0)))
        return 2 * quadrature.quad(lambda w: height - slope * math.hypot(far, w), 0, edge, epsabs=1e-12)[0]

    volume = quarter(lambda t: height * radius(t) ** 2 / 2 - slope * radius(t) ** 3 / 3)
    flat = quarter(lambda t: radius(t) ** 2 / 2)
    surface = flat + flat * math.hypot(1, slope) + 2 * wall(a, b) + 2 * wall(b, a)
    worst = 0.0
    for edge in (0.1, 0.05, 0.025):
        region = Region.from_boxes((-a, -b, 0), (a, b, height), (edge, edge, edge))
        v, s = bodies(region, [cones((0, 0, 0), UP, [35])])[(1,)]
        worst = max(abs(v / volume - 1), abs(s / surface - 1))
        assert worst < 0.02 * edge
    assert volume / surface == pytest.approx(v / s, rel=2e-4)


angle = st.floats(-math.pi, math.pi)


@settings(max_examples=25, deadline=None)
@given(angle, angle, st.tuples(*[st.floats(-1, 1)] * 3), st.floats(-1, 1), st.floats(-1, 1), st.floats(-85, 85))
def test_crossings_are_where_small_steps_find_them(roll, pitch, position, u, v, elevation):
    assume(math.dist((u, v), position[1:]) > 1e-3)  # no line through the apex
    axis = up((roll, pitch, 0.0))
    row = np.array([*position, *axis, math.sin(math.radians(elevation)), np.nan])
    at, weight = core.cross_cones((u, v), row, -1.0, 1.0)
    count = len(at)
    wanted = naive.crossings((0.0, u, v), (1.0, 0.0, 0.0), -1.0, 1.0, position, axis, elevation)
    if count != len(wanted):  # two within a step, or one on an end
        assert (count - len(wanted)) % 2 == 0 or min(abs(at), default=1) > 1 - 1e-9
        return
    for k, (s, n) in enumerate(wanted):
        assert at[k] == pytest.approx(s, abs=1e-9)
        if math.dist((s, u, v), position) > 1e-2:
            assert weight[k] == pytest.approx(n, abs=1e-4)


def brute_force(region, lidars, fine):
    """The largest V/S: volumes by cuboids of 1/fine the edge, surfaces by points on the cones and by their faces."""
    included = region.included
    for n in range(3):
        included = included.repeat(fine, n)
    edge = region.cuboid_m / fine
    axes = [region.min_m[n] + (np.arange(included.shape[n]) + 0.5) * edge[n] for n in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    bases = [lidar.sin_elevation.size + 1 for lidar in lidars]

    def signature(points):
        return np.ravel_multi_index([gaps_at(points, lidar) for lidar in lidars], bases)

    grid = np.where(included, signature(centres).reshape(included.shape), -1)
    label = np.full(grid.shape, -1)
    of = []
    count = 0
    for value in np.unique(grid[included]):
        part, parts = ndimage.label(grid == value)
        label[part > 0] = part[part > 0] + count - 1
        count += parts
        of += [value] * parts
    size = np.bincount(label[included], minlength=count)
    surface = np.zeros(count)
    for n in range(3):  # faces against walls and exclusions
        padded = np.pad(label, [(1, 1) if m == n else (0, 0) for m in range(3)], constant_values=-1)
        area = np.prod(np.delete(edge, n))
        low, high = padded.take(range(padded.shape[n] - 1), n), padded.take(range(1, padded.shape[n]), n)
        for one, other in ((low, high), (high, low)):
            surface += area * np.bincount(one[(one >= 0) & (other < 0)], minlength=count)
    of = np.array(of)
    for lidar in lidars:
        across = np.linalg.svd(lidar.axis[None])[2][1:]  # two directions at right angles to the axis
        turn, reach = np.meshgrid((np.arange(TURNS) + 0.5) / TURNS * 2 * np.pi, (np.arange(STEPS) + 0.5) / STEPS * 2.0)
        out = np.cos(turn)[..., None] * across[0] + np.sin(turn)[..., None] * across[1]
        for sine in lidar.sin_elevation:
            cosine = math.sqrt(1 - sine**2)
            points = lidar.position_m + reach[..., None] * (sine * lidar.axis + cosine * out)
            normal = cosine * lidar.axis - sine * out
            area = reach * cosine * (2 * np.pi / TURNS) * (2.0 / STEPS)
            cell = np.floor((points - region.min_m) / edge).astype(int)
            inside = ((cell >= 0) & (cell < grid.shape)).all(axis=-1)
            inside[inside] = included[tuple(cell[inside].T)]
            for side in (-1e-9, 1e-9):
                wanted = signature(points[inside] + side * normal[inside])
                owner = np.full(len(wanted), -1)
                for step in np.ndindex(3, 3, 3):
                    near = np.clip(cell[inside] + np.array(step) - 1, 0, np.array(grid.shape) - 1)
                    one = label[tuple(near.T)]
                    good = (one >= 0) & (of[one] == wanted) & ((owner < 0) | (size[one] > size[owner]))
                    owner[good] = one[good]
                surface += np.bincount(owner[owner >= 0], area[inside][owner >= 0], count)
    large = size > 0.01 * size.sum()
    return (size[large] * np.prod(edge) / surface[large]).max()


RIG = [
    cones((0.7, 0.45, 0.22), (0.3, 0.2, 1), [-30, -10, 12, 30]),
    cones((0.8, 0.55, 0.28), (-0.5, 0.6, 0.7), [-25, 0, 25]),
    cones((0.75, 0.5, 0.3), (0.9, 0.1, -0.4), [-15, 15]),
]


@pytest.mark.parametrize("count", [2, 3])
def test_tilted_lidars_are_what_brute_force_says(count):
    vehicle = ((0.625, 0.375, 0.125), (0.875, 0.625, 0.375))
    region = Region.from_boxes((0, 0, 0), (1.5, 1, 0.5), (0.125, 0.125, 0.125), (vehicle,))
    truth = brute_force(region, RIG[:count], 16)
    found = analytic(region, RIG[:count], 0.01)
    print(truth, found)
    assert found.reached
    assert found.max_vsr_m == pytest.approx(truth, abs=found.error_m + 2e-3 * truth)


def on_a_line(region, axis, number):
    """A point of a line of the lattice along an axis, bit for bit; amid the region along it."""
    order = [axis, (axis + 1) % 3, (axis + 2) % 3]
    shape = np.array(region.shape)[order]
    low = region.min_m[order]
    edge = region.cuboid_m[order]
    lines = core.LINES_PER_EDGE**2 * shape[1] * shape[2]
    u, v = shape[1] * (number + 0.5) / lines, shape[2] * ((number * GOLDEN + 0.5) % 1.0)
    point = np.empty(3)
    point[order] = low[0] + 0.52 * shape[0] * edge[0], low[1] + u * edge[1], low[2] + v * edge[2]
    return point


SWEPT = Region.from_boxes((0.1, -0.2, 0), (1.6, 0.8, 0.9), (0.25, 0.2, 0.15))
HOLED = Region.from_boxes((0.1, -0.2, 0), (1.6, 0.8, 0.9), (0.25, 0.2, 0.15), (((0.6, 0.2, 0.3), (1.1, 0.6, 0.6)),))
FAN = [-35, -12, 0, 9, 40]
SWEEPS = {
    "inside": (SWEPT, [cones((0.7, 0.31, 0.42), UP, FAN)]),
    "tilted": (SWEPT, [cones((0.7, 0.31, 0.42), (0.4, -0.3, 0.7), FAN)]),
    "two tilted, close": (SWEPT, [cones((0.7, 0.3, 0.4), (0.4, -0.3, 0.7), FAN), cones((0.71, 0.3, 0.4), (0.39, -0.3, 0.7), FAN)]),
    "three tilted": (SWEPT, RIG),
    "outside": (SWEPT, [cones((-3, 2, 5), (0.2, 1, 0.1), [-40, -30, -20, -10, 0, 10, 20, 30, 60])]),
    "on a wall, and far outside": (SWEPT, [cones((0.1, 0.3, 0.4), (1, 0.1, 0.3), FAN), cones((400, 2, 5), (0.2, 1, 0.1), [-0.01, 0.01])]),
    "exclusion": (HOLED, RIG[:2]),
    "in an exclusion": (HOLED, [cones((0.9, 0.4, 0.4), (0.4, -0.3, 0.7), FAN), RIG[2]]),
    **{f"apex on a line along {'xyz'[n]}": (SWEPT, [cones(on_a_line(SWEPT, n, 7), (0.4, -0.3, 0.7), FAN), RIG[0]]) for n in range(3)},
    "apex on a line, upright": (SWEPT, [cones(on_a_line(SWEPT, 2, 11), UP, FAN)]),
    "beams along the axis and beside it": (SWEPT, [cones((0.7, 0.31, 0.42), (0.4, -0.3, 0.7), [-90, -89.9, 1e-8, 89.9, 90])]),
    "thin gaps": (SWEPT, [cones((0.3, 0.1, 0.2), (0.4, -0.3, 0.7), [-1, -0.9, -0.8, 0, 0.1, 0.2, 5, 5.01])]),
}  # fmt: skip


# Cases that take the same way through the kernel as one of the others.
ALIKE = {"tilted", "three tilted", "in an exclusion", "apex on a line along x", "apex on a line along z"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.nightly] * (n in ALIKE)) for n in SWEEPS])
def test_lines_see_what_plain_loops_see(name):
    """How many pieces a subspace has, and which belong together: the same. Lengths and normals come from bisection: to
    1e-9 of the largest.
    """
    region, lidars = SWEEPS[name]
    subspaces = segment(region, lidars)
    found = integrate(subspaces, lidars)
    surface = np.zeros(len(subspaces))
    pairs = []
    for axis in range(3):
        order = [axis, (axis + 1) % 3, (axis + 2) % 3]
        volume, pieces, faces, joined = naive.sweep(
            subspaces.label.transpose(order).tolist(),
            subspaces.gap.tolist(),
            region.min_m[order].tolist(),
            region.cuboid_m[order].tolist(),
            [(one.position_m[order].tolist(), one.axis[order].tolist(), one.sin_elevation.tolist()) for one in lidars],
        )
        area = region.cuboid_m[order[1]] * region.cuboid_m[order[2]] / 4
        assert np.rint(found.shadow[axis] / area).tolist() == pieces
        np.testing.assert_allclose(found.shadow[axis], np.multiply(pieces, area), rtol=1e-12)
        np.testing.assert_allclose(found.volume[axis], volume, rtol=0, atol=1e-9 * max(volume))
        surface += faces
        pairs += joined
    np.testing.assert_allclose(found.surface, surface, rtol=0, atol=1e-9 * surface.max())
    assert found.whole.tolist() == naive.wholes(len(subspaces), pairs)


TILTED = [  # position, roll, pitch and yaw in degrees, beams
    ((0.7, 0.45, 0.22), (12, -20, 0), [-30, -10, 12, 30]),
    ((0.8, 0.55, 0.28), (35, 40, 10), [-25, 0, 25]),
    ((0.75, 0.5, 0.3), (-8, 100, 0), [-15, 15]),
]
VEHICLE = ((0.625, 0.375, 0.125), (0.875, 0.625, 0.375))
CELLS = (4, 8, 16)  # of marching cubes, to a cuboid's edge


def study_and_rig(folder, rig, exclude):
    """Files of a small region and of TILTED LiDARs in it."""
    boxes = [{"min_m": low, "max_m": high} for low, high in exclude]
    edges = {"min_m": [0, 0, 0], "max_m": [1.5, 1, 0.5], "cuboid_m": [0.125] * 3, "exclude": boxes}
    bounds = {key: {"position_m": [0.5, 0.5, z], "rpy_deg": [0, 0, 0]} for key, z in (("min", 0), ("max", 0.5))}
    study = {"region": edges, "sensors": [{"elevation_deg": [0], **bounds}]}
    sensors = [
        {"name": f"lidar_{m}", "elevation_deg": beams, "position_m": position, "rpy_deg": rpy}
        for m, (position, rpy, beams) in enumerate(rig)
    ]
    for name, document in (("study", study), ("rig", {"name": "tilted", "sensors": sensors})):
        (folder / f"{name}.yaml").write_text(json.dumps(document))
    return folder / "study.yaml", folder / "rig.yaml"


def field(points, digits, lidars, region, exclude):
    """Below 0 inside the subspace of these digits: the largest of signed distances to walls and to the cones of its
    two beams of each LiDAR, which are F = h cos θ − ρ sin θ, at height h and distance ρ from the axis.
    """
    out = np.maximum(region.min_m - points, points - region.max_m).max(axis=-1)
    for low, high in exclude:
        np.maximum(out, -np.maximum(low - points, points - high).max(axis=-1), out=out)
    for one, digit in zip(lidars, digits, strict=True):
        away = points - one.position_m
        height = away @ one.axis
        flat = np.sqrt(np.maximum((away**2).sum(axis=-1) - height**2, 0))
        for beam, sign in ((digit - 1, -1), (digit, 1)):
            if 0 <= beam < one.sin_elevation.size:
                sine = one.sin_elevation[beam]
                np.maximum(out, sign * (height * math.sqrt(1 - sine**2) - flat * sine), out=out)
    return out


def marched(low, high, step, function):
    """Volume, by the divergence theorem, and area of the surface where a function of points is 0."""
    axes = [np.arange(low[n] - 1.5 * step, high[n] + 2 * step, step) for n in range(3)]
    values = function(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    vertices, triangles, _, _ = measure.marching_cubes(values, 0.0, spacing=(step,) * 3)
    a, b, c = vertices[triangles].astype(float).transpose(1, 0, 2)
    return abs((a * np.cross(b, c)).sum()) / 6, measure.mesh_surface_area(vertices, triangles)


@pytest.mark.parametrize(("count", "exclude"), [(1, ()), (2, ()), (3, ()), (2, (VEHICLE,))])
def test_tilted_lidars_are_what_marching_cubes_says(tmp_path, count, exclude):
    """The worst subspace of `evaluate --tolerance`, as a surface that another library finds in a field.

    Marching cubes cuts the corners off edges, over about a cell: area and V/S err by c h + d h². Halving the cells
    twice takes out both; what the second step changes is the tolerance.
    """
    files = study_and_rig(tmp_path, TILTED[:count], exclude)
    told = CliRunner().invoke(cli, ["evaluate", *map(str, files), "--tolerance", "0.003", "--json"]).output
    found = json.loads(told)["analytic"]
    region = load_study(files[0]).region
    lidars = rig_lidars(load_rig(files[1]))
    fine = region.halved().halved().halved()
    subspaces = segment(fine, lidars)
    parts = integrate(subspaces, lidars)
    seen = parts.joined()
    vsr = np.divide(seen.volume_m3, seen.surface_m2, out=np.zeros(len(subspaces)), where=seen.surface_m2 > 0)
    worst = int(vsr.argmax())
    digits = subspaces.gap[worst]
    assert set(parts.whole[(subspaces.gap == digits).all(axis=1)]) == {worst}  # the field has no other part
    its = np.argwhere((subspaces.label >= 0) & (parts.whole[subspaces.label] == worst))
    cuboids = region.cuboid_m / 8
    low = region.min_m + np.floor((its.min(axis=0) - 1) / 8) * region.cuboid_m  # walls amid cells on every grid
    high = region.min_m + (its.max(axis=0) + 2) * cuboids
    sizes = np.array(
        [marched(low, high, 0.125 / n, lambda p: field(p, digits, lidars, region, exclude)) for n in CELLS]
    )
    volume, area = sizes.T
    ratio = volume / area
    once = 2 * ratio[1:] - ratio[:-1]
    truth = (4 * once[1] - once[0]) / 3
    tolerance = abs(truth - once[1])
    print(ratio / truth - 1, once / truth - 1, vsr[worst] / truth - 1, found)
    assert 1.4 < (ratio[0] - ratio[1]) / (ratio[1] - ratio[2]) < 2.6  # it converges by the first order, as it should
    assert tolerance < 2e-3 * truth
    assert vsr[worst] == pytest.approx(truth, abs=tolerance)
    assert found["reached"]
    assert found["max_vsr_m"] == pytest.approx(truth, abs=found["error_m"] + tolerance)
    assert seen.volume_m3[worst] == pytest.approx(volume[2], rel=2e-3)


def test_an_apex_in_the_region_and_lines_through_it():
    """A half-space cut by z = 0 and a double cone about x, on whose apex a line of every axis may pass."""
    row = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -0.5, 0.0, 0.5])
    at, weight = core.cross_cones((0.0, 0.0), row, -1.0, 1.0)
    assert len(at) > 0  # the piece ends at the apex
    assert not at[0]
    assert not weight[0]
    region = Region.from_boxes((-1, -1, -1), (1, 1, 1), (0.1, 0.1, 0.1))
    v, s = cone(1.0, 1 / math.tan(math.radians(60)))
    found = bodies(region, [cones((0, 0, 0), UP, [-60, 60])])
    both = (v, s + math.pi / 3)
    assert found[(0,)] == pytest.approx(both, rel=5e-3)
    assert found[(2,)] == pytest.approx(both, rel=5e-3)
    assert found[(1,)] == pytest.approx((8 - 2 * v, 24 + 2 * s - 2 * math.pi / 3), rel=5e-3)


def test_cones_that_coincide_are_one():
    region = Region.from_boxes((0, 0, 0), (2, 2, 1), (0.1, 0.1, 0.1))
    one = cones((0.9, 1.1, 0.3), (0.2, 0.1, 1), [-10, 20])
    single = level(region, [one])
    double = level(region, [one, one])
    assert double.max_vsr_m == pytest.approx(single.max_vsr_m, rel=1e-12)


def test_beams_along_the_axis_cut_nothing():
    region = Region.from_boxes((0, 0, 0), (1, 1, 1), (0.25, 0.25, 0.25))
    found = analytic(region, [cones((0.5, 0.5, 0.5), UP, [-90, 90])], 0.1)
    assert found.max_vsr_m == pytest.approx(1 / 6, rel=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_larger_region_has_a_larger_vsr(scale):
    def measured(by):
        region = Region.from_boxes((0, 0, 0), np.array((3, 2, 1)) * by, np.array((0.25, 0.25, 0.25)) * by)
        rig = [Lidar(one.position_m * 2 * by, one.axis, one.sin_elevation) for one in RIG]
        return analytic(region, rig, 0.05)

    found = measured(scale)
    unit = measured(1.0)
    assert found.max_vsr_m == pytest.approx(scale * unit.max_vsr_m, rel=1e-6)
    assert found.error_m == pytest.approx(scale * unit.error_m, rel=1e-3)


def test_refines_only_as_far_as_needed():
    region = Region.from_boxes((0, 0, 0), (1.5, 1, 0.5), (0.125, 0.125, 0.125))
    sizes = [analytic(region, RIG, tolerance).cuboids for tolerance in (0.5, 0.002)]
    assert sizes[0] == 8 * 12 * 8 * 4 < sizes[1]
    found = analytic(region, RIG, 1e-6, cuboids_max=10_000)
    assert not found.reached
    assert found.cuboids == 8 * 12 * 8 * 4
    with pytest.raises(ConfigError, match="half the edges, that is 3,072 cuboids; allowed: at most 3,000"):
        analytic(region, RIG, 0.01, cuboids_max=3_000)
    for wrong in (0.0, -1.0, math.nan):
        with pytest.raises(ConfigError, match="allowed: above 0"):
            analytic(region, RIG, wrong)


@pytest.mark.parametrize("study", ["liu2018-1x8", "liu2018-3x4"])
def test_error_bars_hold_on_the_papers_region(study):
    """Against edges of 1/4: the tool of the accuracy benchmark asks the same of hundreds of rigs."""
    loaded = load_study(STUDIES / f"{study}.yaml")
    rng = np.random.default_rng(5)
    for poses in loaded.poses(rng.random((2, int(loaded.free.sum())))):
        lidars = loaded.lidars(poses)
        coarse = level(loaded.region, lidars)
        fine = level(loaded.region.halved(), lidars)
        truth = level(loaded.region.halved().halved(), lidars)
        assert abs(fine.max_vsr_m - truth.max_vsr_m) < error_bar(coarse, fine)
        assert fine.max_vsr_m == pytest.approx(truth.max_vsr_m, rel=0.01)


def test_evaluate_says_what_it_reached(tmp_path):
    study = STUDIES / "liu2018-1x4.yaml"
    rig = tmp_path / "rig.yaml"
    rig.write_text("name: one\nsensors:\n  - {name: a, model: fan-4, position_m: [30, 10, 2.5], rpy_deg: [10, 5, 0]}\n")
    words = ["evaluate", str(study), str(rig), "--tolerance"]
    result = json.loads(CliRunner().invoke(cli, [*words, "0.05", "--json"]).output)
    assert result["measure"] == "faces"
    found = result["analytic"]
    region = load_study(study).region
    assert found["reached"]
    assert found["error_m"] <= 0.05 * found["max_vsr_m"]
    assert found["cuboids"] == 8 * region.included.size
    assert found["cuboid_m"] == pytest.approx([0.5, 0.25, 0.1])
    table = CliRunner().invoke(cli, [*words, "0.05"]).output
    assert f"analytic max VSR {found['max_vsr_m']:.6f} ± {found['error_m']:.6f} m, within" in table
    for wrong in ("0", "-1", "nan", "2", "x"):
        assert CliRunner().invoke(cli, [*words, wrong]).exit_code == 2


def test_evaluate_says_plainly_what_it_did_not_reach():
    found = Analytic(0.5, 0.01, 0.001, [0.5, 0.25, 0.1], 384_000, 0.1)
    assert not found.reached
    assert "NOT within the tolerance of 0.001, but of 0.02" in analytic_line(found)
