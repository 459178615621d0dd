"""The analytic measure where sight is limited, against closed forms."""

import math

import numpy as np
import pytest

from lidarcfg.placement.analytic import integrate
from lidarcfg.placement.study import load_study
from lidarcfg.placement.subspace import BLIND, segment

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
    region, lidars = loaded.region.halved(), loaded.lidars(loaded.lower)
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
    volume, surface = (4 / 3 * math.pi * (most**3 - least**3), 4 * math.pi * (most**2 + least**2))
    assert seen_body(loaded) == pytest.approx((volume, surface), rel=1e-3)


def seen_body(loaded):
    """(volume, surface) of what is seen, where what is not is two subspaces."""
    region, lidars = loaded.region.halved(), loaded.lidars(loaded.lower)
    subspaces = segment(region, lidars, loaded.visibility)
    joined = integrate(subspaces, lidars, loaded.visibility).joined()
    (seen,) = np.flatnonzero(subspaces.gap[:, 0] == 0)
    return joined.volume_m3[seen], joined.surface_m2[seen]


def test_a_range_beyond_a_wall_is_a_cap(tmp_path):
    loaded = study(tmp_path, ((-1, -1, 0), (1, 1, 1)), 0.1, (0, 0, -0.5), more="range_m: [0, 1.1]")
    height, radius2 = 0.6, 1.1**2 - 0.5**2
    volume, surface = math.pi * height**2 * (3 * 1.1 - height) / 3, 2 * math.pi * 1.1 * height + math.pi * radius2
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
    pitch, yaw = -math.degrees(math.asin(1 / math.sqrt(3))), 45
    loaded = study(
        tmp_path, ((-1, -1, -1), (1, 1, 1)), 0.1, (0, 0, 0), (0, pitch, yaw), more="azimuth_fov_deg: [270, 90]"
    )
    half = (4.0, 12.0 + 3 * math.sqrt(3) / 2 * 2)  # a regular hexagon of side √2
    assert bodies(loaded) == {0: pytest.approx(half, rel=2e-3), BLIND: pytest.approx(half, rel=2e-3)}


def test_a_spheres_shadow_is_a_cone(tmp_path):
    ball = "vehicle: {spheres: [{name: ball, center_m: [1, 0, 0], radius_m: 0.4}]}"
    loaded = study(tmp_path, ((0, -1, -1), (2, 1, 1)), 0.1, (-0.2, 0, 0), bodies=ball)
    distance, radius, wall = 1.2, 0.4, 2.2
    sine = radius / distance
    tangent, touch = sine / math.sqrt(1 - sine**2), distance * (1 - sine**2)  # where the cone touches the sphere
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
    distance, radius, wall = 1.2, 0.25, 4.2
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
    top, low, near, far = 0.3, 0.3 * 1.1 / 0.6, 0.6, 1.1
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
    loaded = study(tmp_path, ((-1, -1, -1), (1, 1, 1)), 0.1, (0, 0, 0), bodies=f"vehicle: {{{solid}}}{off}")
    assert loaded.visibility is None
    assert bodies(loaded)[0] == pytest.approx((8 - volume, 24 + surface), rel=1e-3)
