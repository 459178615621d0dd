"""The vehicles that come with the package: closed, of the sizes it says, clear of the sensors."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

VEHICLES = Path(__file__).parents[1] / "data/vehicles"
SIZES_M = {  # x, y with mirrors, z
    "sedan": (4.8, 2.056, 1.5),
    "truck": (7.2, 2.716, 3.2),
    "shuttle": (4.4, 2.0, 2.5),
    "bus": (12.0, 3.0, 3.0),
}
TRIANGLES = {"sedan": (2000, 6000), "truck": (2000, 6000), "shuttle": (2000, 6000), "bus": (300, 900)}


def read(name):
    """A vehicle as Open3D reads it."""
    return o3d.io.read_triangle_mesh(VEHICLES / f"{name}.ply")


def distances_m(name, points):
    """From the body's surface, negative inside."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(read(name)))
    return scene.compute_signed_distance(np.asarray(points, np.float32)).numpy()


@pytest.mark.slow
@pytest.mark.parametrize("name", SIZES_M)
def test_a_vehicle_is_one_closed_mesh_on_the_ground(name):
    body = read(name)
    assert body.is_watertight()
    assert body.is_orientable()
    assert body.get_volume() > 0  # and its normals point outwards
    assert len(body.cluster_connected_triangles()[1]) == 1
    assert TRIANGLES[name][0] <= len(body.triangles) <= TRIANGLES[name][1]
    assert (VEHICLES / f"{name}.ply").stat().st_size < 200_000
    areas = np.linalg.norm(
        np.cross(*np.diff(np.asarray(body.vertices)[np.asarray(body.triangles)], axis=1).transpose(1, 0, 2)), axis=1
    )
    assert areas.min() > 0
    low, high = body.get_min_bound(), body.get_max_bound()
    np.testing.assert_allclose(high - low, SIZES_M[name], atol=0.006)
    np.testing.assert_allclose((low + high)[:2] / 2, 0, atol=0.003)
    assert low[2] == 0


def test_the_sedan_by_places_that_a_saloon_has():
    """Inside: cabin, engine, boot, a tyre. Outside: above bonnet and boot, below the sill, in a wheel arch, by a mirror."""
    inside = [(-0.4, 0, 1.2), (1.8, 0, 0.6), (-2.1, 0, 0.8), (1.42, 0.82, 0.06), (0.71, 0.95, 1.02)]
    outside = [(1.8, 0, 1.0), (-2.1, 0, 1.1), (0, 0, 0.1), (1.42, 0.85, 0.7), (0.71, 1.1, 1.02), (0.9, 0, 1.25)]
    assert (distances_m("sedan", inside) < 0).all()
    assert (distances_m("sedan", outside) > 0).all()


def test_no_bumper_or_roof_sensor_of_the_sedan_is_inside_its_body():
    y = np.linspace(-0.7, 0.7, 29)
    for x in (-2.45, 2.45):
        bumper = [(x, side, z) for side in y for z in np.linspace(0.4, 0.8, 9)]
        far = distances_m("sedan", bumper)
        assert far.min() > 0.04
        assert far.max() < 0.2
    roof = [
        (x, side, z) for x in np.linspace(-0.6, 0.6, 13) for side in np.linspace(-0.5, 0.5, 11) for z in (1.65, 1.9)
    ]
    assert distances_m("sedan", roof).min() > 0.14


def test_the_truck_by_places_that_a_delivery_truck_has():
    """Inside: cab, box. Outside: between them, over the cab, under the box, beside a mirror's arm."""
    assert (distances_m("truck", [(2.6, 0, 1.5), (-1, 0, 2), (-3.5, 1.1, 3.1), (3.33, 1.24, 1.9)]) < 0).all()
    assert (distances_m("truck", [(1.68, 0, 2.0), (2.6, 0, 2.7), (0, 0, 0.3), (3.3, 1.09, 1.87)]) > 0).all()


def test_the_shuttle_is_the_same_forwards_and_backwards():
    points = np.random.default_rng(1).uniform((-2.4, -1.2, 0), (2.4, 1.2, 2.7), (5000, 3))
    np.testing.assert_allclose(distances_m("shuttle", points), distances_m("shuttle", points * (-1, 1, 1)), atol=0.006)


def test_the_bus_by_places_that_a_city_bus_has():
    """Inside: saloon, engine, a mirror. Outside: over the roof, under the floor, in a wheel arch, by a mirror's arms."""
    assert (distances_m("bus", [(0, 0, 1.5), (-5.5, 0, 1.0), (5.8, 1.42, 1.95), (0, 1.1, 2.95)]) < 0).all()
    assert (
        distances_m("bus", [(0, 0, 3.1), (0, 0, 0.2), (3.0, 1.2, 0.99), (5.8, 1.3, 1.95), (0, 1.26, 2.95)]) > 0
    ).all()
    across = distances_m("bus", [(-0.5, y, 2.0) for y in (-1.28, 1.28)])
    np.testing.assert_allclose(
        across, (0.045, 0.035), atol=0.003
    )  # a door 4 cm deep on the right, a window 3 cm on the left


def test_no_place_for_a_sensor_of_the_bus_is_inside_its_body():
    """Over the roof's edges and at the four corners, within the width of the mirrors."""
    roof = [(x, y, z) for x in (-4.0, 0.0, 4.0) for y in (-1.35, -1.15, 1.15, 1.35) for z in (3.1, 3.3)]
    corner = [(x, y, z) for x in (-6.15, -6.05, 6.05, 6.15) for y in (-1.45, 1.45, 1.35, -1.35) for z in (0.6, 1.6)]
    assert distances_m("bus", roof + corner).min() > 0.08
