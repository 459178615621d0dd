"""Max VSR for ever smaller cuboids: against bodies worked by hand, quadrature, points on the cones, and finer grids.

The faces that stand for a surface add up to its shadows along x, y and z: those of a convex body to twice the sum of
its three shadows, those of a piece with normal n to |n_x| + |n_y| + |n_z| times its area, however fine the grid.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy import integrate as quadrature
from scipy import ndimage

from lidarcfg.cli.main import cli
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import up
from lidarcfg.report.key_figures import extrapolated_figure
from lidarcfg.study.extrapolation import Extrapolated, extrapolate, limit
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.vsr.cones import Lidar, gaps_at
from lidarcfg.vsr.region import Region

STUDIES = Path(__file__).parents[2] / "data/studies"
UP = (0.0, 0.0, 1.0)
TURNS = 360
STEPS = 160  # of the points on a cone
SINE = math.sin(math.radians(25))
COSINE = math.cos(math.radians(25))


def cones(position, axis, elevation_deg):
    axis = np.asarray(axis, float)
    return Lidar(np.asarray(position, float), axis / np.linalg.norm(axis), np.sin(np.radians(elevation_deg)))


def cube(edge):
    return Region.from_boxes((-1, -1, -1), (1, 1, 1), (edge, edge, edge))


def check(found, truth, within):
    """The error bar holds, and says something."""
    print(found.max_vsr_m, found.error_m, truth)
    assert abs(found.max_vsr_m - truth) <= found.error_m <= within * truth


def test_values_that_fall_with_the_edges():
    assert limit(3.0, 2.0, 1.5) == (1.0, 0.5)
    assert limit(1.0, 1.0, 1.0) == (1.0, 0.0)
    assert limit(1.0, 2.0, 1.0) == (0.75, 2.5)  # one down by 1, by the halving before up by 1/2: they differ by 1.5


@pytest.mark.parametrize("z_m", [0.05, 0.3123, 0.35, 0.42, 0.4376, 0.561])
def test_a_plane_along_the_walls(z_m):
    """A box of 2 × 1.5 m above or below it; on all three grids the plane may seem to be at one height."""
    region = Region.from_boxes((0, 0, 0), (2, 1.5, 1), (0.1, 0.1, 0.1))
    height = max(z_m, 1 - z_m)
    found = extrapolate(region, [cones((0.7, 0.6, z_m), UP, [0.0])], 1.0)
    check(found, 3 * height / (2 * (3 + 3.5 * height)), 0.1)


def test_a_plane_cuts_a_corner_off():
    """A cube without a corner has the shadows of the cube."""
    region = Region.from_boxes((0, 0, 0), (1, 1, 1), (0.1, 0.1, 0.1))
    check(extrapolate(region, [cones((1 / 3, 1 / 3, 1 / 3), (1, 1, 1), [0.0])], 1.0), 5 / 36, 0.02)


@pytest.mark.parametrize("tilt", [0.0, 90.0, 180.0, 270.0])
def test_around_a_cone(tilt):
    """A cube without a cone of height 2 along z, y, −z or −y: its side's shadows are a disc, and four triangles."""
    axis = up((math.radians(tilt), 0.0, 0.0))
    radius = 2 / math.tan(math.radians(68))
    found = extrapolate(cube(0.1), [cones(-axis, axis, [68])], 1.0)
    check(found, (8 - math.pi * radius**2 * 2 / 3) / (24 + 4 * 2 * radius), 0.02)


def test_an_apex_in_the_region():
    """Between two cones of height 1, apex on apex."""
    radius = 1 / math.tan(math.radians(60))
    found = extrapolate(cube(0.1), [cones((0, 0, 0), UP, [-60, 60])], 1.0)
    check(found, (8 - 2 * math.pi * radius**2 / 3) / (24 + 2 * 4 * radius), 0.02)


def test_above_a_cone_through_walls_is_what_quadrature_says():
    """z >= r tan 20° over a rectangle of 3 × 2 m, up to 1 m: its shadow along z is the rectangle."""
    slope = math.tan(math.radians(20))
    below, _ = quadrature.dblquad(lambda y, x: slope * math.hypot(x, y), -1.5, 1.5, -1, 1, epsabs=1e-9)
    sides = 3 - slope * 1.5**2 + 2 - slope * 1**2
    region = Region.from_boxes((-1.5, -1, 0), (1.5, 1, 1), (0.1, 0.1, 0.1))
    check(extrapolate(region, [cones((0, 0, 0), UP, [20])], 1.0), (6 - below) / (2 * (6 + sides)), 0.02)


SENSOR = """
  - elevation_deg: [90]
    {more}
    min: {{position_m: {position}, rpy_deg: {rpy}}}
    max: {{position_m: {position}, rpy_deg: {rpy}}}
"""


def limited(tmp_path, box, cuboid, position, rpy=(0, 0, 0), more="", bodies=""):
    """Max VSR from one corner to another around a LiDAR without beams but along its axis."""
    text = f"region: {{min_m: {list(box[0])}, max_m: {list(box[1])}, cuboid_m: {[cuboid] * 3}}}\n{bodies}\nsensors:"
    path = tmp_path / "study.yaml"
    path.write_text(text + SENSOR.format(position=list(position), rpy=list(rpy), more=more))
    loaded = load_study(path)
    return extrapolate(loaded.region, lidars_at(loaded.slots, loaded.space.lower), 1.0, loaded.visibility)


CUBE = (-1, -1, -1), (1, 1, 1)


def test_a_plates_shadow_between_walls(tmp_path):
    """A trapezoid 3 m long, 0.5 to 1.25 m wide, whose slanting sides go 0.3 and 0.45 m to the side; 1 m high."""
    plate = "vehicle: {planes: [{name: plate, center_m: [1, 1.05, 0.5], rpy_deg: [0, 90, 0], size_m: [9, 0.5]}]}"
    found = limited(tmp_path, ((0, 0, 0), (4, 2, 1)), 0.1, (-1, 1, 0.5), bodies=plate)
    area = (0.5 + 1.25) / 2 * 3
    check(found, area / (2 * area + 0.5 + 1.25 + (3 + 0.3) + (3 + 0.45)), 0.06)


def test_a_range_is_a_sphere(tmp_path):
    found = limited(tmp_path, CUBE, 0.1, (0.03, 0.05, -0.02), more="range_m: [0, 0.83]")
    check(found, 2 * 0.83 / 9, 0.07)


def test_a_range_beyond_a_wall_is_a_cap(tmp_path):
    """The region without a cap of 0.6 m: its shadows are a disc, and segments of a circle."""
    found = limited(tmp_path, ((-1, -1, 0), (1, 1, 1)), 0.1, (0, 0, -0.5), more="range_m: [0, 1.1]")
    volume = math.pi * 0.36 * (3 * 1.1 - 0.6) / 3
    angle = math.acos(0.5 / 1.1)
    segment = 1.1**2 * (angle - math.sin(angle) * math.cos(angle))
    check(found, (4 - volume) / (16 + 4 * segment), 0.06)


def test_a_field_of_view_cuts_a_box(tmp_path):
    """In halves, by an upright plane at 30°."""
    found = limited(
        tmp_path, ((-1, -1, -0.5), (1, 1, 0.5)), 0.1, (0, 0, 0), (0, 0, 30), more="azimuth_fov_deg: [270, 90]"
    )
    check(found, 2 / (4 + 4 + 2 * (1 + math.tan(math.radians(30)))), 0.05)


def test_a_tilted_field_of_view_cuts_a_cube_in_a_hexagon(tmp_path):
    """The plane x + y + z = 0, of area 3 √3, which counts √3 times: its normal is the sensor's x."""
    pitch = -math.degrees(math.asin(1 / math.sqrt(3)))
    found = limited(tmp_path, CUBE, 0.1, (0, 0, 0), (0, pitch, 45), more="azimuth_fov_deg: [270, 90]")
    check(found, 4 / (12 + 9), 0.05)


def test_a_spheres_shadow_is_a_cone(tmp_path):
    """The region without a cone that ends in a cap of the sphere: what it adds are its two shadows from the side."""
    ball = "vehicle: {spheres: [{name: ball, center_m: [1, 0, 0], radius_m: 0.4}]}"
    found = limited(tmp_path, ((0, -1, -1), (2, 1, 1)), 0.1, (-0.2, 0, 0), bodies=ball)
    sine = 0.4 / 1.2
    tangent = sine / math.sqrt(1 - sine**2)
    touch = 1.2 * (1 - sine**2)  # where the cone touches the sphere
    depth = touch - (1.2 - 0.4)  # of the cap in front of that
    volume = math.pi * tangent**2 * (2.2**3 - touch**3) / 3 + math.pi * depth**2 * (3 * 0.4 - depth) / 3
    angle = math.acos(1 - depth / 0.4)
    side = tangent * (2.2**2 - touch**2) + 0.16 * (angle - math.sin(angle) * math.cos(angle))
    check(found, (8 - volume) / (24 + 4 * side), 0.05)


SOLIDS = {  # volume, and what its side and top add
    "spheres: [{name: a, center_m: [0.1, 0, 0], radius_m: 0.6, exclude: true}]": (
        4 / 3 * math.pi * 0.216,
        6 * math.pi * 0.36,
    ),
    "cylinders: [{name: a, base_m: [0.1, 0, -0.4], radius_m: 0.5, height_m: 0.9, exclude: true}]": (
        math.pi * 0.25 * 0.9,
        2 * (math.pi * 0.25 + 2 * 0.9),
    ),
    "boxes: [{name: a, size_m: [0.9, 0.7, 0.8], yaw_deg: 25, exclude: true}]": (
        0.504,
        2 * (0.63 + (0.9 + 0.7) * (SINE + COSINE) * 0.8),
    ),
    "boxes: [{name: a, size_m: [0.8, 0.6, 0.5], yaw_deg: 25, exclude: true}, "  # a cross
    "{name: b, size_m: [0.6, 0.8, 0.5], yaw_deg: 25, exclude: true}]": (
        0.5 * 0.6,
        2 * 0.6 + 3.2 * 0.5 * (SINE + COSINE),
    ),
    "spheres: [{name: a, center_m: [0, 0, 0], radius_m: 0.6, exclude: true}, "  # one within the other
    "{name: b, center_m: [0.1, 0, 0], radius_m: 0.3, exclude: true}]": (4 / 3 * math.pi * 0.216, 6 * math.pi * 0.36),
}


@pytest.mark.parametrize("solid", SOLIDS)
def test_excluded_bodies_are_cut_out_of_every_grid(tmp_path, solid):
    off = "\nvisibility: {range: false, field_of_view: false, occlusion: false}"
    volume, surface = SOLIDS[solid]
    bodies = f"vehicle: {{{solid}, allow_inside: true}}{off}"
    check(limited(tmp_path, CUBE, 0.1, (0, 0, 0), bodies=bodies), (8 - volume) / (24 + surface), 0.06)


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
            shadows = area * abs(normal).sum(axis=-1)
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
                surface += np.bincount(owner[owner >= 0], shadows[inside][owner >= 0], count)
    large = size > 0.01 * size.sum()
    return (size[large] * np.prod(edge) / surface[large]).max()


RIG = [
    cones((0.7, 0.45, 0.22), (0.3, 0.2, 1), [-30, -10, 12, 30]),
    cones((0.8, 0.55, 0.28), (-0.5, 0.6, 0.7), [-25, 0, 25]),
    cones((0.75, 0.5, 0.3), (0.9, 0.1, -0.4), [-15, 15]),
]
VEHICLE = ((0.625, 0.375, 0.125), (0.875, 0.625, 0.375))
SMALL = Region.from_boxes((0, 0, 0), (1.5, 1, 0.5), (0.125, 0.125, 0.125))
HOLED = Region.from_boxes((0, 0, 0), (1.5, 1, 0.5), (0.125, 0.125, 0.125), (VEHICLE,))


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2, 3])
def test_tilted_lidars_are_what_brute_force_says(count):
    truth = brute_force(HOLED, RIG[:count], 16)
    found = extrapolate(HOLED, RIG[:count], 0.05)
    print(truth, found)
    assert found.reached
    assert abs(found.max_vsr_m - truth) <= found.error_m + 2e-3 * truth


def in_the_limit(region, lidars, visibility=None):
    """Extrapolated from edges of 1/4 to 1/16: its own error bar is much smaller."""
    fine = region.halved().halved()
    return extrapolate(fine, lidars, 1.0, visibility).max_vsr_m


@pytest.mark.parametrize("region", [SMALL, HOLED])
def test_error_bars_hold_on_finer_grids(region):
    for one in (RIG[:1], RIG[:2], RIG, RIG[1:], RIG[::2]):
        check(extrapolate(region, one, 1.0), in_the_limit(region, one), 0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "liu2018-3x4",
        "sedan",
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("liu2018-1x8", "truck", "bus")),
    ],
)
def test_error_bars_hold_in_studies(name):
    """On cuboids with twice the edges."""
    study = load_study(STUDIES / f"{name}.yaml")
    region = study.region
    uncut = region.cut.included if region.cut else region.included
    coarse = Region(region.min_m, region.max_m, uncut[::2, ::2, ::2])
    if region.cut:
        coarse = coarse.without(region.cut.bodies)
    rng = np.random.default_rng(5)
    for poses in study.space.poses(rng.random((2, study.space.dimensions))):
        lidars = lidars_at(study.slots, poses)
        found = extrapolate(coarse, lidars, 1.0, study.visibility)
        check(found, in_the_limit(coarse, lidars, study.visibility), 0.4)


def test_cones_that_coincide_are_one():
    region = Region.from_boxes((0, 0, 0), (2, 2, 1), (0.1, 0.1, 0.1))
    one = cones((0.9, 1.1, 0.3), (0.2, 0.1, 1), [-10, 20])
    assert extrapolate(region, [one, one], 1.0).max_vsr_m == extrapolate(region, [one], 1.0).max_vsr_m


def test_beams_along_the_axis_cut_nothing():
    region = Region.from_boxes((0, 0, 0), (1, 1, 1), (0.25, 0.25, 0.25))
    found = extrapolate(region, [cones((0.5, 0.5, 0.5), UP, [-90, 90])], 0.1)
    assert found.max_vsr_m == pytest.approx(1 / 6, rel=1e-12)
    assert found.error_m < 1e-12


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_larger_region_has_a_larger_vsr(scale):
    def measured(by):
        region = Region.from_boxes((0, 0, 0), np.array((3, 2, 1)) * by, np.array((0.25, 0.25, 0.25)) * by)
        rig = [Lidar(one.position_m * 2 * by, one.axis, one.sin_elevation) for one in RIG]
        return extrapolate(region, rig, 1.0)

    found = measured(scale)
    unit = measured(1.0)
    assert found.max_vsr_m == pytest.approx(scale * unit.max_vsr_m, rel=1e-6)
    assert found.error_m == pytest.approx(scale * unit.error_m, rel=1e-3)


def test_refines_only_as_far_as_needed():
    cuboids = 12 * 8 * 4
    sizes = [extrapolate(SMALL, RIG, tolerance).cuboids for tolerance in (0.5, 0.01)]
    assert sizes[0] == 64 * cuboids < sizes[1]
    found = extrapolate(SMALL, RIG, 1e-6, cuboids_max=511 * cuboids)
    assert not found.reached
    assert found.cuboids == 64 * cuboids
    with pytest.raises(ConfigError, match="a quarter of the edges, that is 24,576 cuboids; allowed: at most 24,575"):
        extrapolate(SMALL, RIG, 0.01, cuboids_max=24_575)
    for wrong in (0.0, -1.0, math.nan):
        with pytest.raises(ConfigError, match="allowed: above 0"):
            extrapolate(SMALL, RIG, wrong)


def test_evaluate_says_what_it_reached(tmp_path):
    study = STUDIES / "liu2018-1x4.yaml"
    rig = tmp_path / "rig.yaml"
    rig.write_text("name: one\nsensors:\n  - {name: a, model: fan-4, position_m: [30, 10, 2.5], rpy_deg: [10, 5, 0]}\n")
    words = ["evaluate", str(study), str(rig), "--tolerance"]
    result = json.loads(CliRunner().invoke(cli, [*words, "0.05", "--json"]).output)
    found = result["extrapolated"]
    region = load_study(study).region
    assert found["reached"]
    assert found["error_m"] <= 0.05 * found["max_vsr_m"]
    assert found["cuboids"] == 64 * region.included.size
    assert found["cuboid_m"] == pytest.approx([0.25, 0.125, 0.05])
    table = CliRunner().invoke(cli, [*words, "0.05"]).output
    said = " ".join(table.split())
    assert f"max VSR, extrapolated (m) {found['max_vsr_m']:.6f} ± {found['error_m']:.6f}" in said
    assert "within the tolerance of 0.05" in said
    for wrong in ("0", "-1", "nan", "2", "x"):
        assert CliRunner().invoke(cli, [*words, wrong]).exit_code == 2


def test_evaluate_says_plainly_what_it_did_not_reach():
    found = Extrapolated(0.5, 0.01, 0.001, [0.25, 0.125, 0.05], 3_072_000, 0.1)
    assert not found.reached
    assert "NOT within the tolerance of 0.001, but of 0.02" in extrapolated_figure(found).detail
