"""The objects that come with the package: closed, of the sizes it says, on the ground."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

OBJECTS = Path(__file__).parents[1] / "data/objects"
SIZES_M = {  # x, y, z
    "pedestrian": (0.73, 0.59, 1.75),
    "child": (0.23, 0.40, 1.10),
    "cyclist": (1.74, 0.63, 1.75),
    "car": (4.20, 1.98, 1.45),  # with mirrors
    "tyre": (0.632, 0.632, 0.205),
    "dog": (1.25, 0.30, 0.84),  # the shoulder is at 0.60 m
    "post": (0.1, 0.1, 1.0),
}
VOLUME_M3 = {  # a body's mass by its density of 1 kg/l; a car's clearance below its floor is not its own
    "pedestrian": (0.06, 0.09),
    "child": (0.018, 0.03),
    "cyclist": (0.07, 0.11),
    "car": (5.5, 8.0),
    "tyre": (0.012, 0.03),
    "dog": (0.03, 0.05),  # 30 to 40 kg
    "post": (0.0074, 0.0079),  # π 0.05² m² × 1 m
}


@pytest.mark.parametrize("name", SIZES_M)
def test_an_object_is_one_closed_mesh_with_its_middle_over_the_origin(name):
    path = OBJECTS / f"{name}.ply"
    body = o3d.io.read_triangle_mesh(path)
    assert body.is_watertight()
    assert body.is_orientable()
    assert len(body.cluster_connected_triangles()[1]) == 1
    assert VOLUME_M3[name][0] < body.get_volume() < VOLUME_M3[name][1]
    assert path.stat().st_size < 100_000
    low, high = body.get_min_bound(), body.get_max_bound()
    np.testing.assert_allclose(high - low, SIZES_M[name], atol=0.006)
    np.testing.assert_allclose((low + high)[:2] / 2, 0, atol=0.004)
    assert low[2] == 0


def test_a_beam_passes_where_it_should():
    """Between a cyclist's spokes and through a tyre that lies flat; not through a rider or a tyre's wall."""
    rays = {
        "cyclist": ([(-0.53 + 0.2, 2, 0.34 + 0.06), (-0.2, 2, 1.2)], (0, -1, 0)),
        "tyre": ([(0.1, 0.1, 2), (0.26, 0, 2)], (0, 0, -1)),
    }
    for name, (starts, way) in rays.items():
        scene = o3d.t.geometry.RaycastingScene()
        mesh = o3d.io.read_triangle_mesh(OBJECTS / f"{name}.ply")
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
        hits = scene.cast_rays(np.array([[*start, *way] for start in starts], np.float32))["t_hit"].numpy()
        assert np.isinf(hits[0])
        assert np.isfinite(hits[1])
