"""The analytic measure where sight is limited: against closed forms, and plain loops."""

import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.placement.analytic import integrate, level
from lidarcfg.placement.boundaries import Boundaries, Lattice, axes_from
from lidarcfg.placement.evaluation import evaluate
from lidarcfg.placement.study import load_study
from lidarcfg.placement.subspace import BLIND, segment
from tests.naive import boundaries as naive
from tests.naive import placement as loops

SENSOR = """
  - elevation_deg: [90]
    {more}
    min: {{position_m: {position}, rpy_deg: {rpy}}}
    max: {{position_m: {position}, rpy_deg: {rpy}}}
"""


def study(tmp_path, box, cuboid, position, rpy=(0, 0, 0), more="", bodies=""):
    """A region from box to box, and a LiDAR without beams but along its axis."""
    text = f"region: {{min_m: {list(box[0])}, max_m: {list(box[1])}, cuboid_m: {[cuboid] * 3}}}\n{bodies}\nsensors:"
    path = tmp_path / "study.yaml"
    path.write_text(text + SENSOR.format(position=list(position), rpy=list(rpy), more=more))
    return load_study(path)


def bodies(loaded):
    """{digit: (volume, surface)} of the subspaces on half the study's edges."""
    region = loaded.region.halved()
    lidars = loaded.lidars(loaded.lower)
    subspaces = segment(region, lidars, loaded.visibility)
    seen = integrate(subspaces, lidars, loaded.visibility)
    joined = seen.joined()
    wholes = np.unique(seen.whole)
    out = {int(subspaces.gap[j, 0]): (joined.volume_m3[j], joined.surface_m2[j]) for j in wholes}
    assert len(out) == len(wholes)
    return out


BOX = (0, 0, 0), (4, 2, 1)


def test_a_plates_shadow_between_walls(tmp_path):
    plate = "vehicle: {planes: [{name: plate, center_m: [1, 1.05, 0.5], rpy_deg: [0, 90, 0], size_m: [9, 0.5]}]}"
    loaded = study(tmp_path, BOX, 0.1, (-1, 1, 0.5), bodies=plate)
    found = bodies(loaded)
    area = (0.5 + 1.25) / 2 * 3  # by similar triangles its width is half the distance from the LiDAR over 2 m
    sides = 0.5 + 1.25 + math.hypot(3, 0.3) + math.hypot(3, 0.45)
    assert found[BLIND] == pytest.approx((area, 2 * area + sides), rel=1e-3)
    assert found[0] == pytest.approx((8 - area, 2 * (8 - area) + sides + 2 * (4 + 2 - 1.25)), rel=1e-3)


def test_a_low_plates_shadow_ends_on_the_floor(tmp_path):
    plate = "vehicle: {planes: [{name: plate, center_m: [1, 1.05, 0.2], rpy_deg: [0, 90, 0], size_m: [0.4, 0.5]}]}"
    loaded = study(tmp_path, BOX, 0.05, (-1, 1, 0.9), bodies=plate)
    far = 1 + 0.4 / 0.25  # the upper edge's shadow falls by a quarter
    floor = 0.5 * ((far + 1) ** 2 - 2**2) / 4
    volume = sum(  # ∫ w h dx, a cubic: Simpson's rule is exact
        factor * 0.25 * (x + 1) * (0.4 - 0.25 * (x - 1)) * (far - 1) / 6
        for factor, x in ((1, 1), (4, (1 + far) / 2), (1, far))
    )
    sides = 0.5 * 0.4 * (far - 1) * (math.hypot(1, 0.1) + math.hypot(1, 0.15))
    surface = 0.5 * 0.4 + floor * (1 + math.hypot(1, 0.25)) + sides
    found = bodies(loaded)[BLIND]
    assert found[0] == pytest.approx(volume, rel=1e-3)
    assert found[1] == pytest.approx(surface, rel=0.02)  # the wedge's tip is thinner than a cuboid


@pytest.mark.parametrize(("least", "most"), [(0, 0.83), (0.41, 0.83)])
def test_ranges_are_spheres(tmp_path, least, most):
    loaded = study(tmp_path, ((-1, -1, -1), (1, 1, 1)), 0.1, (0.03, 0.05, -0.02), more=f"range_m: [{least}, {most}]")
    volume = 4 / 3 * math.pi * (most**3 - least**3)
    surface = 4 * math.pi * (most**2 + least**2)
    assert seen_body(loaded) == pytest.approx((volume, surface), rel=1e-3)


def seen_body(loaded):
    """(volume, surface) of what is seen, where what is not is two subspaces."""
    region = loaded.region.halved()
    lidars = loaded.lidars(loaded.lower)
    subspaces = segment(region, lidars, loaded.visibility)
    joined = integrate(subspaces, lidars, loaded.visibility).joined()
    (seen,) = np.flatnonzero(subspaces.gap[:, 0] == 0)
    return joined.volume_m3[seen], joined.surface_m2[seen]


def test_a_range_beyond_a_wall_is_a_cap(tmp_path):
    loaded = study(tmp_path, ((-1, -1, 0), (1, 1, 1)), 0.1, (0, 0, -0.5), more="range_m: [0, 1.1]")
    height = 0.6
    radius2 = 1.1**2 - 0.5**2
    volume = math.pi * height**2 * (3 * 1.1 - height) / 3
    surface = 2 * math.pi * 1.1 * height + math.pi * radius2
    assert bodies(loaded)[0] == pytest.approx((volume, surface), rel=1e-3)


def test_a_field_of_view_cuts_a_box(tmp_path):
    loaded = study(
        tmp_path, ((-1, -1, -0.5), (1, 1, 0.5)), 0.1, (0, 0, 0), (0, 0, 30), more="azimuth_fov_deg: [270, 90]"
    )
    cut = 2 / math.cos(math.radians(30))  # the chord of a square through its middle, times a height of 1
    half = (2.0, 4.0 + 4.0 + cut)  # half of the walls, of floor and of ceiling; and the plane
    assert bodies(loaded) == {0: pytest.approx(half, rel=1e-3), BLIND: pytest.approx(half, rel=1e-3)}


def test_a_narrow_field_of_view_is_a_wedge(tmp_path):
    loaded = study(tmp_path, ((0, -1, 0), (2, 1, 1)), 0.1, (-0.5, 0, 0.5), more="azimuth_fov_deg: [345, 20]")
    right, left = math.tan(math.radians(20)), math.tan(math.radians(15))  # clockwise is positive
    area = (right + left) * (2.5**2 - 0.5**2) / 2
    sides = 2 * (math.hypot(1, right) + math.hypot(1, left)) + (right + left) * (2.5 + 0.5)
    assert seen_body(loaded) == pytest.approx((area, 2 * area + sides), rel=1e-3)


def test_a_tilted_field_of_view_cuts_a_cube_in_a_hexagon(tmp_path):
    """The plane x + y + z = 0: its normal is the sensor's x, and half a turn about that is seen."""
    pitch = -math.degrees(math.asin(1 / math.sqrt(3)))
    yaw = 45
    loaded = study(
        tmp_path, ((-1, -1, -1), (1, 1, 1)), 0.1, (0, 0, 0), (0, pitch, yaw), more="azimuth_fov_deg: [270, 90]"
    )
    half = (4.0, 12.0 + 3 * math.sqrt(3) / 2 * 2)  # a regular hexagon of side √2
    assert bodies(loaded) == {0: pytest.approx(half, rel=2e-3), BLIND: pytest.approx(half, rel=2e-3)}


def test_a_spheres_shadow_is_a_cone(tmp_path):
    ball = "vehicle: {spheres: [{name: ball, center_m: [1, 0, 0], radius_m: 0.4}]}"
    loaded = study(tmp_path, ((0, -1, -1), (2, 1, 1)), 0.1, (-0.2, 0, 0), bodies=ball)
    distance = 1.2
    radius = 0.4
    wall = 2.2
    sine = radius / distance
    tangent = sine / math.sqrt(1 - sine**2)
    touch = distance * (1 - sine**2)  # where the cone touches the sphere
    depth = touch - (distance - radius)  # of the cap in front of that
    cone = (
        math.pi * tangent**2 * (wall**3 - touch**3) / 3,
        math.pi * tangent / math.sqrt(1 - sine**2) * (wall**2 - touch**2),
    )
    cap = math.pi * depth**2 * (3 * radius - depth) / 3, 2 * math.pi * radius * depth
    assert bodies(loaded)[BLIND] == pytest.approx(
        (cone[0] + cap[0], cone[1] + cap[1] + math.pi * (wall * tangent) ** 2), rel=1e-3
    )


def test_a_cylinders_shadow_between_floor_and_ceiling(tmp_path):
    post = "vehicle: {cylinders: [{name: post, base_m: [1, 1, -1], radius_m: 0.25, height_m: 3}]}"
    loaded = study(tmp_path, BOX, 0.1, (-0.2, 1, 0.5), bodies=post)
    distance = 1.2
    radius = 0.25
    wall = 4.2
    turn = math.asin(radius / distance)
    touch = math.sqrt(distance**2 - radius**2)
    area = math.tan(turn) * wall**2 - touch * radius + (math.pi / 2 - turn) * radius**2  # beyond the near arc
    arc = (math.pi - 2 * turn) * radius
    sides = 2 * (wall / math.cos(turn) - touch) + 2 * wall * math.tan(turn) + arc
    assert bodies(loaded)[BLIND] == pytest.approx((area, 2 * area + sides), rel=1e-3)


def test_a_cylinders_shadow_below_its_rim(tmp_path):
    """Straight above it: its shadow widens from the upper rim to the floor, where the LiDAR is as high as it is."""
    drum = "vehicle: {cylinders: [{name: drum, base_m: [0, 0, 0.3], radius_m: 0.3, height_m: 0.2}]}"
    loaded = study(tmp_path, ((-1, -1, 0), (1, 1, 1)), 0.05, (0, 0, 1.1), bodies=drum)
    top = 0.3
    low = 0.3 * 1.1 / 0.6
    near = 0.6
    far = 1.1
    volume = math.pi / 3 * (low**2 * far - top**2 * near)
    side = math.pi * (low * math.hypot(low, far) - top * math.hypot(top, near))
    assert bodies(loaded)[BLIND] == pytest.approx((volume, side + math.pi * (low**2 + top**2)), rel=1e-3)


SOLIDS = {
    "spheres: [{name: a, center_m: [0.1, 0, 0], radius_m: 0.6, exclude: true}]": (
        4 / 3 * math.pi * 0.216,
        4 * math.pi * 0.36,
    ),
    "cylinders: [{name: a, base_m: [0.1, 0, -0.4], radius_m: 0.5, height_m: 0.9, exclude: true}]": (
        math.pi * 0.25 * 0.9,
        math.pi * (0.9 + 0.5),
    ),
    "boxes: [{name: a, size_m: [0.9, 0.7, 0.8], yaw_deg: 25, exclude: true}]": (0.504, 2 * (0.63 + 0.72 + 0.56)),
    "boxes: [{name: a, size_m: [0.8, 0.6, 0.5], yaw_deg: 25, exclude: true}, "  # a cross
    "{name: b, size_m: [0.6, 0.8, 0.5], yaw_deg: 25, exclude: true}]": (0.5 * 0.6, 2 * 0.6 + 3.2 * 0.5),
    "spheres: [{name: a, center_m: [0, 0, 0], radius_m: 0.6, exclude: true}, "  # one within the other
    "{name: b, center_m: [0.1, 0, 0], radius_m: 0.3, exclude: true}]": (4 / 3 * math.pi * 0.216, 4 * math.pi * 0.36),
}


@pytest.mark.parametrize("solid", SOLIDS)
def test_excluded_bodies_have_their_own_surface(tmp_path, solid):
    off = "\nvisibility: {range: false, field_of_view: false, occlusion: false}"
    volume, surface = SOLIDS[solid]
    loaded = study(
        tmp_path, ((-1, -1, -1), (1, 1, 1)), 0.1, (0, 0, 0), bodies=f"vehicle: {{{solid}, allow_inside: true}}{off}"
    )
    assert loaded.visibility is None
    assert bodies(loaded)[0] == pytest.approx((8 - volume, 24 + surface), rel=1e-3)


STUDY = """
region: {min_m: [-2, -1.5, 0], max_m: [2, 1.5, 1.2], cuboid_m: [0.4, 0.3, 0.2], exclude: [{min_m: [1.6, 0, 0], max_m: [2, 1, 1]}]}
"""
LIDAR = """
  - elevation_deg: [-25, -5, 0, 20]
    {more}
    min: {{position_m: {position}, rpy_deg: {rpy}}}
    max: {{position_m: {position}, rpy_deg: {rpy}}}
"""
OBSTACLES = """
vehicle:
  allow_inside: true
  boxes:
    - {name: box, center_m: [0.3, -0.4, 0.35], size_m: [0.9, 0.5, 0.6], yaw_deg: 20, exclude: true}
    - {name: step, center_m: [0.7, -0.3, 0.2], size_m: [0.7, 0.6, 0.33], yaw_deg: 20, exclude: true}
  spheres: [{name: ball, center_m: [0.2, 0.8, 0.6], radius_m: 0.23}]
  cylinders: [{name: post, base_m: [-0.9, -0.2, -0.1], radius_m: 0.2, height_m: 0.8, exclude: true}]
  planes: [{name: sign, center_m: [-0.4, 0.6, 0.7], rpy_deg: [20, 65, 10], size_m: [0.5, 0.3]}]
"""
POSES = {
    "above": ((0.25, -0.35, 0.9), (10, -15, 40), "range_m: [0.3, 1.9]\n    azimuth_fov_deg: [200, 120]"),
    "below": ((-0.35, 0.1, 0.31), (-25, 5, 0), "range_m: [0, 1.5]\n    azimuth_fov_deg: [300, 70]"),
    "outside": ((-3, 2, 1.6), (0, 10, -20), ""),
}


def busy_study(tmp_path):
    path = tmp_path / "busy.yaml"
    lidars = [LIDAR.format(position=list(place), rpy=list(rpy), more=more) for place, rpy, more in POSES.values()]
    (tmp_path / "floor.yaml").write_text("name: floor\nground: {z_m: 0.05, reflectivity: 9}\n")
    path.write_text(STUDY + OBSTACLES + "surroundings: floor.yaml\nsensors:" + "".join(lidars))
    return load_study(path)


def crossed(region, lidars, visibility, axis):
    order = axes_from(axis)
    x, y, z = np.array(region.shape)[order].tolist()
    lattice = Lattice(axis, region.min_m[order], region.cuboid_m[order], (x, y, z))
    with ThreadPoolExecutor(2) as pool:
        return lattice, Boundaries(region, lidars, visibility).flips(lattice, pool)


def line_place(lattice, line):
    """Where a line runs: the first coordinates are even, the second ones by the golden ratio."""
    across = (line + 0.5) / lattice.lines, (line * (5**0.5 - 1) / 2 + 0.5) % 1
    return tuple(lattice.low[i] + across[i - 1] * lattice.shape[i] * lattice.edge[i] for i in (1, 2))


def changes(flips, row, line):
    """(place, |n·e|) of a line's flips."""
    first, last = flips.first[row * flips.start.shape[1] + line : row * flips.start.shape[1] + line + 2]
    return list(zip(flips.at[first:last].tolist(), flips.weight[first:last].tolist(), strict=True))


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_sight_begins_and_ends_where_small_steps_find_it(tmp_path, pose, axis):
    """Some lines of the lattice; the steps may miss what is shorter than they are."""
    loaded = busy_study(tmp_path)
    number = list(POSES).index(pose)
    lattice, flips = crossed(loaded.region, loaded.lidars(loaded.lower), loaded.visibility, axis)
    lidar = loaded.lidars(loaded.lower)[number]
    scene = loaded.vehicle.scene
    order = axes_from(axis)
    sensor = {
        "position": lidar.position_m.tolist(),
        "x": lidar.level[:, 0].tolist(),
        "y": lidar.level[:, 1].tolist(),
        "range": lidar.range_m or (0, math.inf),
        "fov": np.degrees(lidar.azimuth_fov or (0, 2 * math.pi)).tolist(),
    }
    triangles = scene.vertices_m[scene.triangles].tolist()
    rounds = [(0.2, 0.8, 0.6, 0.23, math.nan), (-0.9, -0.2, -0.1, 0.2, 0.8)]

    def see(s, u, v):
        point = [0.0] * 3
        for at, value in zip(order, (s, u, v), strict=True):
            point[at] = value
        return naive.sees(point, sensor, triangles, rounds, 0.05)

    low, high = lattice.low[0], lattice.low[0] + lattice.shape[0] * lattice.edge[0]
    steps = 150
    compared = 0
    for line in range(3, flips.start.shape[1], 25):
        u, v = line_place(lattice, line)
        state, wanted = naive.flips(see, u, v, low, high, steps)
        assert flips.start[number, line] == state or changes(flips, number, line)[0][0] < low + (high - low) / steps
        found = changes(flips, number, line)
        places = [place for place, _ in found]
        for place in wanted:
            assert min(abs(place - one) for one in places) < 1e-9
        ends = [low, *places, high]
        for n in range(len(ends) - 1):  # and what the steps have missed
            assert see((ends[n] + ends[n + 1]) / 2, u, v) == (flips.start[number, line] ^ n % 2)
        for (place, weight), before, after in zip(found, ends[:-2], ends[2:], strict=True):
            steepness = naive.steepness(see, u, v, place, min(place - before, after - place, 0.05) / 2)
            if steepness is not None:
                assert weight == pytest.approx(steepness, abs=1e-4)
                compared += 1
    assert compared >= 5


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_lines_are_in_bodies_where_points_are(tmp_path, axis):
    loaded = busy_study(tmp_path)
    order = axes_from(axis)
    lattice, flips = crossed(loaded.region, (), None, axis)
    for line in range(0, flips.start.shape[1], 5):
        u, v = line_place(lattice, line)
        places = [place for place, _ in changes(flips, 0, line)]
        ends = [lattice.low[0], *places, lattice.low[0] + lattice.shape[0] * lattice.edge[0]]
        for n in range(len(ends) - 1):
            point = np.empty((3, 1))
            point[order, 0] = (ends[n] + ends[n + 1]) / 2, u, v
            inside = any(loaded.vehicle.inside(name, *point).any() for name in loaded.vehicle.excluded)
            assert inside == (flips.start[0, line] == n % 2)


def test_lines_see_what_plain_loops_see(tmp_path):
    """How many pieces a subspace has, and which belong together: the same; lengths and normals to 1e-9 of the largest."""
    loaded = busy_study(tmp_path)
    region = loaded.region
    lidars = loaded.lidars(loaded.lower)
    subspaces = segment(region, lidars, loaded.visibility)
    assert (subspaces.gap == BLIND).any(axis=0).all()
    found = integrate(subspaces, lidars, loaded.visibility)
    surface = np.zeros(len(subspaces))
    pairs = []
    for axis in range(3):
        order = axes_from(axis)
        _, flips = crossed(region, lidars, loaded.visibility, axis)
        rows, lines = flips.start.shape
        volume, pieces, faces, joined = loops.sweep(
            subspaces.label.transpose(order).tolist(),
            subspaces.gap.tolist(),
            region.min_m[order].tolist(),
            region.cuboid_m[order].tolist(),
            [(one.position_m[order].tolist(), one.axis[order].tolist(), one.sin_elevation.tolist()) for one in lidars],
            within=region.cut.included.transpose(order).tolist(),
            sight=[
                [(bool(flips.start[row, line]), changes(flips, row, line)) for row in range(rows)]
                for line in range(lines)
            ],
        )
        area = region.cuboid_m[order[1]] * region.cuboid_m[order[2]] / 4
        np.testing.assert_allclose(found.shadow[axis], np.multiply(pieces, area), rtol=1e-12)
        np.testing.assert_allclose(found.volume[axis], volume, rtol=0, atol=1e-9 * max(volume))
        surface += faces
        pairs += joined
    np.testing.assert_allclose(found.surface, surface, rtol=0, atol=1e-9 * surface.max())
    assert found.whole.tolist() == loops.wholes(len(subspaces), pairs)


CAR = """
region: {min_m: [-8, -5, 0], max_m: [8, 5, 3], cuboid_m: [1, 0.5, 0.25]}
vehicle: {meshes: [{name: body, file: %s, exclude: true}]}
sensors:
  - {name: roof, model: vlp-16, min: {position_m: [-0.6, -0.5, 1.6], rpy_deg: [-15, -15, 0]}, max: {position_m: [0.6, 0.5, 1.9], rpy_deg: [15, 15, 0]}}
  - {name: front, model: vlp-16, range_m: [0.5, 7], azimuth_fov_deg: [270, 90], min: {position_m: [2.45, -0.7, 0.4], rpy_deg: [-9, -9, 0]}, max: {position_m: [2.5, 0.7, 0.8], rpy_deg: [9, 9, 0]}}
"""


def test_evaluate_has_an_error_bar_that_holds_around_a_car(tmp_path):
    """Against edges of 1/4."""
    path = tmp_path / "car.yaml"
    path.write_text(CAR % (Path(__file__).parents[2] / "data/vehicles/sedan.ply"))
    loaded = load_study(path)
    for poses in loaded.poses(np.random.default_rng(3).random((2, int(loaded.free.sum())))):
        lidars = loaded.lidars(poses)
        found = evaluate(loaded, loaded.rig(poses), tolerance=1.0).analytic
        assert found.reached
        assert found.cuboids == 8 * loaded.region.included.size
        truth = level(loaded.region.halved().halved(), lidars, loaded.visibility)
        assert abs(found.max_vsr_m - truth.max_vsr_m) < found.error_m
        assert found.max_vsr_m == pytest.approx(truth.max_vsr_m, rel=0.02)
