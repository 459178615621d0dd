"""Simplified meshes: distances by hand, and solids that stay closed; triangles that are there again."""

import numpy as np
import pytest
import trimesh

from lidarcfg.world.meshes import box_mesh, plane_mesh, ply_file, read_mesh
from lidarcfg.world.scene_file import Box, Plane
from lidarcfg.world.simplify import greatest_distance, simplify
from lidarcfg.world.solids import merge_vertices, open_edges
from tests.refusals import refused

SPHERE = trimesh.creation.icosphere(5, 1.5)  # 20,480 triangles
BALL = np.asarray(SPHERE.vertices), np.asarray(SPHERE.faces)


def box(size):
    return box_mesh(Box(name="a", reflectivity=1, center_m=(1000, 0, 0), size_m=(size, size, size)))


def test_the_greatest_distance_by_hand():
    """Of a cube in a larger one that of the corners, either way; of plates beside each other their gap."""
    assert greatest_distance(box(2.0), box(2.2)) == pytest.approx(0.1 * np.sqrt(3), rel=0.03)
    assert greatest_distance(box(2.2), box(2.0)) == greatest_distance(box(2.0), box(2.2))
    low, high = (plane_mesh(Plane(name="a", reflectivity=1, center_m=(0, 0, z), size_m=(3, 1))) for z in (0.0, 0.25))
    assert greatest_distance(low, high) == pytest.approx(0.25, abs=1e-6)
    assert greatest_distance(low, low) < 2e-6


@pytest.mark.parametrize("triangles", [500, 5000])
def test_a_ball_stays_one(triangles):
    """Closed, of the volume of a sphere, and as far from it as its vertices and the middles of its triangles say."""
    found = simplify(BALL, triangles)
    assert 0.99 * triangles <= len(found[1]) <= triangles
    assert not len(open_edges(found))
    solid = trimesh.Trimesh(*found)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(4 / 3 * np.pi * 1.5**3, rel=20 / triangles)
    apart = greatest_distance(BALL, found)
    assert apart == pytest.approx(abs(np.linalg.norm(solid.triangles_center, axis=1) - 1.5).max(), rel=0.5, abs=1e-3)


def test_what_cannot_be_simplified():
    with refused("has 12 triangles, which are no more than 100 already"):
        simplify(box(1.0), 100)


def test_a_written_mesh_is_read_bit_for_bit(tmp_path):
    (tmp_path / "ball.ply").write_bytes(ply_file(BALL))
    vertices, triangles = read_mesh(tmp_path / "ball.ply")
    assert (vertices == BALL[0]).all()
    assert (triangles == BALL[1]).all()


def test_triangles_that_are_there_again_change_nothing():
    """A body with some or all of its triangles twice is that body; two that touch keep both sides of the wall."""
    vertices, triangles = merge_vertices(BALL)
    for more in (triangles[:7], triangles[:, [1, 2, 0]]):
        again = merge_vertices((vertices, np.concatenate([triangles, more])))
        assert (again[1] == triangles).all()
    beside = [box_mesh(Box(name="a", reflectivity=1, center_m=(x, 0, 0), size_m=(1, 1, 1))) for x in (0, 1)]
    both = merge_vertices(
        (np.concatenate([beside[0][0], beside[1][0]]), np.concatenate([beside[0][1], beside[1][1] + 8]))
    )
    assert len(both[1]) == 24
    assert not len(open_edges(both))
