"""Distances to a concave body by hand and by plain loops, and footprints with holes."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from lidarcfg.returns.places import Stand, StandZone
from lidarcfg.world.footprint import GRID_M, MANY_TRIANGLES, Footprint
from lidarcfg.world.meshes import join_meshes, read_mesh
from tests.naive import requirements as naive
from tests.returns_cases import box


def moved(mesh, x, y):
    return mesh[0] + (x, y, 0.0), mesh[1]


BAR = box(4.0, 1.0, 1.0)
U = join_meshes([BAR, moved(box(1.0, 2.0, 1.0), -1.5, 1.5), moved(box(1.0, 2.0, 1.0), 1.5, 1.5)])  # open to the left
OBJECT = Footprint.of(box(0.4, 0.2, 1.0))


def at(x, y, heading_deg=0.0):
    return np.array([[x, y, 0.0, math.radians(heading_deg)]])


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        (at(0.0, 1.5), 0.8 - 0.0),  # in the notch: 1 to either arm, 1 to the bar, less half of 0.4 and of 0.2
        (at(0.0, 1.5, 90.0), 0.8),  # to the bar
        (at(4.0, 0.0), 1.8),
        (at(4.0, 0.0, 90.0), 1.9),
        (at(3.0, 3.5), math.hypot(0.8, 0.9)),  # from corner to corner
        (at(0.0, 0.4), 0.0),  # in the body
    ],
)
def test_distances_by_hand(place, expected):
    assert Footprint.of(U).to_objects_m(OBJECT, place)[0] == pytest.approx(expected, abs=1e-5)


def test_distances_by_plain_loops():
    rng = np.random.default_rng(3)
    body = Footprint.of(U)
    outline = body.outlines_m[0][:-1]
    for x, y, heading in rng.uniform((-6, -6, 0), (6, 6, 360), (40, 3)):
        place = at(x, y, heading)
        found = body.to_objects_m(OBJECT, place)[0]
        if found > 0:
            c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
            corners = OBJECT.outlines_m[0][:-1] @ np.array([[c, s], [-s, c]]) + (x, y)
            assert found == pytest.approx(naive.distance_m(corners, outline), abs=1e-9)


PLANE = Footprint.of(
    (np.array([[0.0, -0.3, 0], [0, 0.3, 0], [0, 0.3, 2], [0, -0.3, 2]]), np.array([[0, 1, 2], [0, 2, 3]]))
)
PAIR = Footprint.of(join_meshes([moved(box(0.2, 0.2, 1.0), 0.3, 0.0), moved(box(0.1, 0.3, 1.0), -0.3, 0.1)]))


@pytest.mark.parametrize("item", [OBJECT, PLANE, PAIR], ids=["box", "plane", "two parts"])
@pytest.mark.parametrize("within_m", [(0.0, 0.6), (0.4, 1.5), (1.0, math.inf)])
def test_a_zone_holds_the_places_at_its_distances(item, within_m):
    """Beside the distances of all parts, whose shapes are more than circles; within the zone nothing meets the body."""
    rng = np.random.default_rng(4)
    body = Footprint.of(U)
    places = np.insert(rng.uniform((-4, -3, 0), (4, 5, 2 * math.pi), (3000, 3)), 2, 0.0, axis=1)
    distance_m = body.to_objects_m(item, places)
    expected = (distance_m > 0) & (distance_m >= within_m[0]) & (distance_m <= within_m[1])
    assert 0.02 < expected.mean() < 0.9
    assert (Stand(StandZone(body, within_m), item, np.zeros(1), 0.0).holds(places) == expected).all()
    assert (body.are_beside(*within_m, item, places) == (distance_m > within_m[0]) & (distance_m <= within_m[1])).all()
    assert item.inner_radius_m <= np.linalg.norm(np.concatenate(item.outlines_m), axis=1).min()


def test_the_circle_within_a_footprint_by_hand():
    """Half the lesser side about the middle; none where the origin is on an edge, or between two parts."""
    assert OBJECT.inner_radius_m == pytest.approx(0.1, abs=1e-5)
    assert Footprint.of(U).inner_radius_m == pytest.approx(0.5, abs=1e-5)
    assert (PLANE.inner_radius_m, PAIR.inner_radius_m) == (0.0, 0.0)


def test_holes_are_filled_and_bays_are_kept():
    ring = join_meshes([U, moved(BAR, 0.0, 3.0)])  # closes the notch
    assert Footprint.of(U).shape.area == pytest.approx(8.0, abs=1e-4)
    assert Footprint.of(ring).shape.area == pytest.approx(4.0 * 4.0, abs=1e-4)
    assert Footprint.of(ring).to_points_m(np.array([[0.0, 1.5]]))[0] == 0.0


def test_an_upright_plane_has_a_footprint():
    corners = np.array([[0.0, -1, 0], [0, 1, 0], [0, 1, 2], [0, -1, 2]])
    plane = Footprint.of((corners, np.array([[0, 1, 2], [0, 2, 3]])))
    assert plane.to_points_m(np.array([[3.0, 0.0]]))[0] == pytest.approx(3.0)


def test_places_are_where_they_are_allowed():
    """Distances, the sector and the spacing of the base grid, place by place."""
    body = Footprint.of(BAR)
    zone = StandZone(body, (0.5, 7.0), (math.radians(-30), math.radians(60)))
    stand = Stand(zone, OBJECT, np.radians([0.0, 90.0]), 0.0)
    places = stand.base
    distance = stand.distance_m(places)
    assert (distance >= 0.5 - 1e-9).all()
    assert (distance <= 7.0 + 1e-9).all()
    angle = np.degrees(np.arctan2(places[:, 1], places[:, 0]))
    assert ((angle >= -30 - 1e-9) & (angle <= 60 + 1e-9)).all()
    assert (stand.near_step_m, stand.far_step_m) == (pytest.approx(0.1), 0.5)
    near = places[body.to_points_m(places[:, :2]) < 5]
    steps = np.diff(np.unique(near[:, 0].round(6)))
    assert steps.max() == pytest.approx(0.1)
    some = {most: {tuple(place) for place in stand.thinned(most)} for most in (300, 1000)}
    assert some[300] < some[1000] < {tuple(place) for place in places}
    assert [len(one) for one in some.values()] == pytest.approx([300, 1000], rel=0.1)
    ahead = [np.mean([place[1] > 0 for place in one]) for one in some.values()]  # spread: half of them on either side
    assert ahead == pytest.approx([np.mean(places[:, 1] > 0)] * 2, abs=0.04)
    assert len(stand.thinned(len(places))) == len(places)
    inside = StandZone(body, box_m=(np.array([3.0, -1.0]), np.array([5.0, 1.0])))
    boxed = Stand(inside, OBJECT, np.radians([0.0, 90.0]), 0.0, 0.25).base
    reach = np.where(boxed[:, 3] == 0, 0.2, 0.1)
    assert (boxed[:, 0] - reach).min() >= 3.0 - 1e-9
    assert (boxed[:, 0] + reach).max() <= 5.0 + 1e-9


def _cut(mesh, times):
    """A mesh with each triangle cut into four, several times."""
    for _ in range(times):
        mesh = trimesh.remesh.subdivide(*mesh)
    assert len(mesh[1]) > 1.8 * MANY_TRIANGLES  # a half or more lies flat
    return mesh


def _box_shape(width, depth, x, y):
    return shapely.box(x - width / 2, y - depth / 2, x + width / 2, y + depth / 2)


def test_a_large_mesh_by_hand():
    """Bodies beside each other, one with a notch, a hole that is filled, and what lies in the hole."""
    frame = [moved(box(3.0, 0.5, 1.0), 8.0, y) for y in (-1.25, 1.25)]
    frame += [moved(box(0.5, 3.0, 1.0), 8.0 + x, 0.0) for x in (-1.25, 1.25)]
    inside = moved(box(0.3, 0.3, 1.0), 8.0, 0.2)
    found = Footprint.of(_cut(join_meshes([U, *frame, inside]), 5)).shape
    bar = shapely.union_all([_box_shape(4, 1, 0, 0), _box_shape(1, 2, -1.5, 1.5), _box_shape(1, 2, 1.5, 1.5)])
    expected = bar.union(_box_shape(3, 3, 8, 0))
    assert len(shapely.get_parts(found)) == 2
    assert found.symmetric_difference(expected).area < GRID_M * expected.length
    assert shapely.hausdorff_distance(found, expected) < 2 * GRID_M


@pytest.mark.parametrize("name", ["vehicles/sedan", "objects/cyclist"])
def test_a_large_mesh_by_the_union_of_its_triangles(name):
    mesh = read_mesh(Path(__file__).parents[2] / f"data/{name}.ply")
    found = Footprint.of(_cut(mesh, 2)).shape
    expected = Footprint.of(mesh).shape
    assert shapely.hausdorff_distance(found, expected) < 2 * GRID_M
    assert found.symmetric_difference(expected).area < GRID_M * expected.length
