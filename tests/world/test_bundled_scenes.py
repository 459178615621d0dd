"""The scenes that come along: their labelled objects stand on the ground, face where they move, and touch nothing.

Open3D and shapely say so: rays straight down, samples of all other surfaces in each box, footprints of pairs of boxes.
"""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial import cKDTree
from shapely.geometry import Polygon

from lidarcfg.world.boxes import boxed_objects
from lidarcfg.world.meshes import cylinder_mesh, join_meshes
from lidarcfg.world.scene import load_scene

ROOT = Path(__file__).parents[2]
SCENES = ["street", pytest.param("suburb", marks=pytest.mark.slow), "depot"]
SECONDS = np.arange(0, 61, 3.0)  # also beyond the ten seconds that data sets are likely to have
HALF = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
GROUND_M = 1000.0
STEP_M = 0.15  # a foot on a kerb is higher or lower by that at most
SIZES_M = {  # the least and the most: length, width, height
    "car": ((3.5, 1.6, 1.3), (5.2, 2.2, 2.0)),
    "truck": ((5.0, 1.9, 2.0), (9.0, 2.9, 4.0)),
    "bus": ((10.0, 2.4, 2.7), (13.0, 3.1, 3.5)),
    "trailer": ((8.0, 2.4, 2.5), (14.0, 2.7, 4.1)),
    "bicycle": ((1.5, 0.4, 1.5), (2.0, 0.8, 2.0)),
    "pedestrian": ((0.2, 0.3, 0.9), (1.0, 0.8, 2.0)),
    "other_vehicle": ((2.0, 1.0, 1.8), (5.0, 2.0, 2.6)),
    "other_object": ((0.8, 0.5, 0.5), (1.5, 1.2, 2.0)),
}


@pytest.fixture(scope="module", params=SCENES)
def world(request):
    """A scene, its boxed objects, and all other surfaces as Open3D's mesh, with a ground that is infinite in ours."""
    scene = load_scene(ROOT / f"data/scenes/{request.param}.yaml")
    objects = boxed_objects(scene)
    rest = ~np.isin(scene.triangle_object, [one.index for one in objects])
    parts = [(scene.vertices_m, scene.triangles[rest]), *(cylinder_mesh(one, 0.01) for one in scene.file.cylinders)]
    assert not scene.file.spheres
    if scene.file.ground:
        corners = np.column_stack([2 * GROUND_M * HALF, np.full(4, scene.file.ground.z_m)])
        parts.append((corners, np.array([[0, 1, 2], [0, 2, 3]])))
    vertices_m, triangles = join_meshes(parts)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices_m), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    return scene, objects, mesh


def test_sizes_and_categories(world):
    """People, cyclists and cars in each, and some of each that move, as long and as wide as such things are."""
    _, objects, _ = world
    for category in ("pedestrian", "bicycle", "car"):
        assert any(one.category == category for one in objects), category
    moving = {one.category for one in objects if one.path}
    assert {"pedestrian", "bicycle"} < moving
    for one in objects:
        low, high = SIZES_M[one.category]
        assert (one.size_m >= low).all(), (one.name, one.size_m)
        assert (one.size_m <= high).all(), (one.name, one.size_m)
    assert len({one.name for one in objects}) == len(objects)


def test_they_face_where_they_move(world):
    """KITTI's and nuScenes' boxes have the front along x: the direction of 0.2 s of the way, where it is not backwards."""
    _, objects, _ = world
    checked = 0
    for one in objects:
        for second in SECONDS if one.path else []:
            T = one.pose(second)
            way = one.pose(second + 0.2)[:2, 3] - T[:2, 3]
            if np.linalg.norm(way) < 0.05:
                continue
            along = way @ T[:2, 0] / np.linalg.norm(way)
            assert abs(along) > np.cos(np.radians(8)), (one.name, second)
            assert along > 0 or one.category == "other_vehicle", (one.name, second)
            checked += 1
    assert checked > 30


def test_they_stand_on_the_ground(world):
    """Open3D's ray from the middle of each box down meets the ground at its lower face; on a kerb, within a step."""
    _, objects, mesh = world
    below = o3d.t.geometry.RaycastingScene()
    below.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    gaps_m = []
    for second in SECONDS:
        T = np.array([one.pose(second) for one in objects])
        from_m = T[:, :3, 3] + (0.5 - 0.5 * np.array([one.size_m[2] for one in objects]))[:, None] * T[:, :3, 2]
        rays = np.column_stack([from_m, -T[:, :3, 2]]).astype(np.float32)
        gaps_m.append(below.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy() - 0.5)
    gaps = np.abs(gaps_m)
    far = [(one.name, gap) for one, gap in zip(objects, gaps.max(axis=0), strict=True) if gap > STEP_M]
    assert not far
    assert np.quantile(gaps, 0.98) < 0.03


def test_nothing_else_is_in_a_box(world):
    """Samples of the surfaces of all other things but flat ground, 40 to a square metre: none is above a box's feet."""
    _, objects, mesh = world
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    mesh.remove_triangles_by_mask((corners[..., 2].min(axis=1) > 4) | (np.ptp(corners[..., 2], axis=1) < 1e-9))
    o3d.utility.random.seed(3)
    points = np.asarray(mesh.sample_points_uniformly(int(mesh.get_surface_area() * 40)).points)
    tree = cKDTree(points[:, :2])
    for one in objects:
        for second in SECONDS if one.path else SECONDS[:1]:
            T = one.pose(second)
            near = points[tree.query_ball_point(T[:2, 3], np.linalg.norm(one.size_m[:2]) / 2)]
            box = o3d.geometry.OrientedBoundingBox(T[:3, 3], T[:3, :3], one.size_m)
            inside = near[box.get_point_indices_within_bounding_box(o3d.utility.Vector3dVector(near))]
            above = (inside - T[:3, 3]) @ T[:3, 2] + one.size_m[2] / 2
            assert (above < STEP_M).all(), (one.name, second, inside[above.argmax()])


def test_no_two_boxes_touch(world):
    """Footprints as shapely's polygons, at the times of data sets."""
    _, objects, _ = world
    for second in SECONDS:
        T = np.array([one.pose(second) for one in objects])
        size_m = np.array([one.size_m for one in objects])
        corners = T[:, None, :2, 3] + np.einsum("nij,nkj->nki", T[:, :2, :2], HALF * size_m[:, None, :2])
        shapes = [Polygon(outline) for outline in corners]
        for i, one in enumerate(shapes):
            for k in np.flatnonzero(np.linalg.norm(T[:, :2, 3] - T[i, :2, 3], axis=1) < 15):
                assert k <= i or not one.intersects(shapes[k]), (objects[i].name, objects[k].name, second)
