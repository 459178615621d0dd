"""Meshes of Open3D as scenes, bodies and objects: the same as from a file; and what is refused."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest

from lidarcfg.config.document import yaml_text
from lidarcfg.errors import ConfigError, LidarcfgError, SceneError
from lidarcfg.returns.target import ObjectFile, target_of
from lidarcfg.sensors.rig import load_rig, rig_to_dict
from lidarcfg.study.loading import load_study
from lidarcfg.world.mesh_source import Triangles
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.vehicle import Vehicle, load_vehicle, rig_vehicle
from tests.naive.rays import first_triangle
from tests.test_tools import ROOT

SEDAN = ROOT / "data/vehicles/sedan.ply"


def body():
    return o3d.io.read_triangle_mesh(str(SEDAN))


def test_a_scene_of_meshes_is_hit_where_open3d_hits_them():
    """Legacy and tensor meshes, with a reflectivity of their own, on a ground."""
    ball = o3d.geometry.TriangleMesh.create_sphere(1.0).translate((6, 0, 1))
    box = o3d.t.geometry.TriangleMesh.create_box(2, 1, 3)
    scene = Scene.from_meshes({"ball": ball, "box": box}, {"ball": 70}, ground_reflectivity=10)
    assert (scene.names, scene.reflectivity.tolist()) == (("ground", "ball", "box"), [10, 70, 20])
    rng = np.random.default_rng(1)
    towards = rng.uniform((-1, -2, 0.2), (7, 2, 3), (500, 3)) - (2, -6, 2)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    start = np.tile([2.0, -6, 2], (500, 1))
    theirs = o3d.t.geometry.RaycastingScene()
    for mesh in (o3d.t.geometry.TriangleMesh.from_legacy(ball), box):
        theirs.add_triangles(mesh)
    rays = np.concatenate([start, towards], axis=1).astype(np.float32)
    expected = theirs.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    plain = Scene.from_meshes({"ball": ball, "box": box})
    corners = plain.vertices_m[plain.triangles]
    assert corners.shape == (len(ball.triangles) + 12, 3, 3)
    found, _ = first_triangle(plain.vertices_m, plain.triangles, start, towards)
    both = np.isfinite(expected) & np.isfinite(found)
    assert both.sum() > 100
    assert (np.isfinite(expected) != np.isfinite(found)).sum() <= 2  # at edges
    np.testing.assert_allclose(found[both], expected[both], rtol=1e-5)


def test_a_scene_of_meshes_is_the_scene_of_its_file(tmp_path):
    """Written with its triangles, and read again."""
    scene = Scene.from_meshes({"box": o3d.geometry.TriangleMesh.create_box(2, 1, 3)}, 40, 10)
    path = tmp_path / "scene.yaml"
    path.write_text(yaml_text(scene.file.model_dump(mode="json", exclude_none=True)))
    found = load_scene(path)
    assert found.file == scene.file
    assert np.array_equal(found.vertices_m, scene.vertices_m)
    assert np.array_equal(found.triangles, scene.triangles)


def test_a_body_of_a_mesh_is_that_of_its_file():
    ours, theirs = Vehicle.from_meshes({"body": body()}), load_vehicle(SEDAN)
    assert np.array_equal(ours.scene.vertices_m, theirs.scene.vertices_m)
    assert (ours.excluded, theirs.excluded) == (("body",), ())  # its inside is no part of the region
    assert ours.depth_m(np.array([[0.0, 0, 0.6]])) == theirs.depth_m(np.array([[0.0, 0, 0.6]]))
    rig = replace(load_rig(ROOT / "data/rigs/roof.yaml"), vehicle=ours.section)
    assert np.array_equal(rig_vehicle(rig).scene.triangles, ours.scene.triangles)
    assert rig_to_dict(rig)["vehicle"]["meshes"][0]["file"].keys() == {"vertices_m", "triangles"}


def test_an_open_body_blocks_beams_and_excludes_nothing():
    mesh = body()
    mesh.remove_triangles_by_index([0])
    ours = Vehicle.from_meshes({"body": mesh})
    assert ours.excluded == ()
    assert "'body' of a mesh of 5,921 triangles is not closed" in ours.warnings[0]


def test_an_object_of_a_mesh():
    child = ROOT / "data/objects/child.ply"
    ours = target_of(ObjectFile(mesh=o3d.io.read_triangle_mesh(str(child))), ROOT)
    theirs = target_of(ObjectFile(name="child"), ROOT)
    assert np.array_equal(ours.mesh[0], theirs.mesh[0])


@pytest.mark.parametrize(
    ("mesh", "what"),
    [
        (3, "an int is no mesh; allowed: Open3D's TriangleMesh, or vertices"),
        (o3d.geometry.TriangleMesh(), "the mesh has no triangles"),
        (o3d.t.geometry.TriangleMesh(), "the mesh has no triangles"),
        ((np.zeros((3, 3)), [[0, 1, 9]]), "a triangle names vertex 9; there are 3"),
        ((np.zeros((3, 2)), [[0, 1, 2]]), r"have shapes \(3, 2\) and \(1, 3\); allowed"),
        (([[0, 0, 0], [1, np.nan, 0], [1, 1, 1]], [[0, 1, 2]]), "vertex 1 is not finite"),
        (([[0, 0], [1, 2, 0]], [[0, 1, 2]]), "not all of three numbers"),
        (([[0, 0, 0]] * 3, [[0, 1, 0.5]]), "not whole numbers"),
    ],
)
def test_what_is_no_mesh_is_refused(mesh, what):
    with pytest.raises(LidarcfgError, match=what):
        Triangles.of(mesh)


def test_a_scene_whose_mesh_lacks_triangles_is_refused_with_its_line(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text(
        "name: one\nmeshes:\n  - {name: a, position_m: [0, 0, 0], reflectivity: 9, file: {vertices_m: [[0, 0, 0]]}}\n"
    )
    with pytest.raises(
        ConfigError, match=r"scene.yaml:3:\d+: meshes\[0\].file: has the keys vertices_m; allowed: vert"
    ):
        load_scene(path)
    with pytest.raises(SceneError, match="reflectivity: no mesh is called 'b'"):
        Scene.from_meshes({"a": o3d.geometry.TriangleMesh.create_box()}, {"b": 3})


@pytest.mark.slow
def test_a_study_s_vehicle_may_be_triangles(tmp_path):
    path = tmp_path / "study.yaml"
    mesh = Triangles.of(body())
    text = (ROOT / "data/studies/sedan.yaml").read_text()
    path.write_text(
        text.replace(
            "../vehicles/sedan.ply",
            str(
                dict(zip(("vertices_m", "triangles"), (mesh.vertices_m.tolist(), mesh.triangles.tolist()), strict=True))
            ),
        )
    )
    ours, theirs = load_study(path), load_study(ROOT / "data/studies/sedan.yaml")
    assert np.array_equal(ours.region.included, theirs.region.included)
