"""Scenes: shapes against solid geometry, the street, and what is refused."""

import errno
import math
from pathlib import Path

import numpy as np
import open3d as o3d
import plyfile
import pytest

from lidarcfg.errors import ConfigError, SceneError
from lidarcfg.world.meshes import read_mesh
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import PLY, STREET, scene
from tests.refusals import refused


def volume(scene):
    """By the divergence theorem: positive only if every facet looks outwards."""
    vertices, triangles = scene.mesh(0.001)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def test_volumes(tmp_path):
    box = scene(tmp_path, "boxes: [{name: b, center_m: [5, -3, 1], size_m: [2, 3, 4], yaw_deg: 30, reflectivity: 9}]")
    assert volume(box) == pytest.approx(24, rel=1e-12)
    sphere = scene(tmp_path, "spheres: [{name: s, center_m: [100, 0, 1], radius_m: 2, reflectivity: 9}]")
    assert volume(sphere) == pytest.approx(4 / 3 * math.pi * 8, rel=3e-3)
    assert volume(sphere) < 4 / 3 * math.pi * 8
    pole = scene(tmp_path, "cylinders: [{name: c, base_m: [1, 2, 3], radius_m: 0.5, height_m: 2, reflectivity: 9}]")
    assert volume(pole) == pytest.approx(math.pi * 0.25 * 2, rel=1e-2)


@pytest.mark.parametrize("tolerance_m", [0.001, 0.01])
def test_drawn_facets_stay_within_their_tolerance(tmp_path, tolerance_m):
    for radius in (0.05, 0.25, 2.0, 10.0, 26.0):
        sphere = scene(tmp_path, f"spheres: [{{name: s, center_m: [0, 0, 0], radius_m: {radius}, reflectivity: 9}}]")
        vertices, triangles = sphere.mesh(tolerance_m)
        triangles = vertices[triangles]
        edges = (triangles + np.roll(triangles, 1, axis=1)) / 2
        assert np.linalg.norm(edges, axis=2).min() > radius - tolerance_m


def test_large_spheres_take_no_memory(tmp_path):
    items = ", ".join(f"{{name: s{i}, center_m: [0, 0, {i}], radius_m: 1e7, reflectivity: 9}}" for i in range(100))
    stage = scene(tmp_path, f"spheres: [{items}]")
    assert len(stage.vertices_m) == len(stage.triangles) == 0
    assert len(Tracer(stage, np.zeros(3)).world.fixed) < 200


def test_yaw_turns_left(tmp_path):
    box = scene(tmp_path, "boxes: [{name: b, center_m: [0, 0, 0], size_m: [4, 1, 1], yaw_deg: 90, reflectivity: 9}]")
    np.testing.assert_allclose(box.vertices_m.max(axis=0), [0.5, 2, 0.5], atol=1e-12)


def test_plane_pitch_90_looks_along_x(tmp_path):
    plane = scene(
        tmp_path,
        "planes: [{name: p, center_m: [7, 1, 2], size_m: [2, 4], rpy_deg: [0, 90, 0], reflectivity: 9}]",
    )
    np.testing.assert_allclose(plane.vertices_m.min(axis=0), [7, -1, 1], atol=1e-12)
    np.testing.assert_allclose(plane.vertices_m.max(axis=0), [7, 3, 3], atol=1e-12)


def test_mesh_is_scaled_then_turned_then_moved(tmp_path):
    (tmp_path / "m.ply").write_text(PLY.format(n=3, m=1) + "0 0 0\n1 0 0\n0 2 0\n3 0 1 2\n")
    mesh = scene(
        tmp_path,
        "meshes: [{name: m, file: m.ply, position_m: [10, 0, 0], rpy_deg: [0, 0, 90], scale: 2, reflectivity: 7}]",
    )
    np.testing.assert_allclose(mesh.vertices_m, [[10, 0, 0], [10, 2, 0], [6, 0, 0]], atol=1e-12)
    assert mesh.names == ("m",)
    assert mesh.reflectivity.tolist() == [7]


def test_street():
    street = load_scene(STREET)
    assert street.names[0] == "ground"
    assert (street.triangle_object > 0).all()
    corners = street.vertices_m[street.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.maximum(np.maximum(low, -high), 0)[:, :2]  # from the origin to each triangle's bounds
    assert (np.hypot(*near.T) > 3).all()
    assert low[:, 0].min() >= -60
    assert high[:, 0].max() <= 60
    assert abs(corners[..., 1]).max() <= 20
    assert sum(item.category == "pedestrian" for item in street.items) >= 8
    assert (street.reflectivity > 100).sum() >= 4
    assert street.file.meshes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty; give a ground or an object"),
        ("ground: {z_m: 0}", "ground.reflectivity: missing"),
        ("ground: {reflectivity: 300}", "300 is too large; allowed: at most 255"),
        ("spheres: [{name: s, center_m: [0, 0, 0], radius: 1, reflectivity: 1}]", "allowed: radius_m"),
        ("spheres: [{name: s, center_m: [0, 0, 0], radius_m: 0, reflectivity: 1}]", "above 0"),
        (
            "spheres: [{name: ground, center_m: [0, 0, 0], radius_m: 1, reflectivity: 1}]",
            "is an object already",
        ),
        ("geo_origin: {latitude_deg: 90}\nground: {reflectivity: 1}", "at most 89"),
        (
            "meshes: [{name: m, file: none.ply, position_m: [0, 0, 0], reflectivity: 1}]",
            "none.ply: no such file",
        ),
        (
            "meshes: [{name: m, file: ., position_m: [0, 0, 0], reflectivity: 1}]",
            ": is a directory",
        ),
        (
            'meshes: [{name: m, file: "a\\0b", position_m: [0, 0, 0], reflectivity: 1}]',
            "embedded null byte",
        ),
        (
            "spheres: [{name: s, center_m: [0, 0, 0], radius_m: 1e14, reflectivity: 1}]",
            "at most 100000000",
        ),
        (
            "spheres: [{name: s, center_m: [0, 0, 2e8], radius_m: 1, reflectivity: 1}]",
            "at most 100000000",
        ),
        (
            "cylinders: [{name: s, base_m: [0, -2e8, 0], radius_m: 1, height_m: 1, reflectivity: 1}]",
            "at least -100000000",
        ),
        (
            "boxes: [{name: b, center_m: [0, 0, 0], size_m: [1, 1, 1e9], reflectivity: 1}]",
            "at most 100000000",
        ),
        (
            "planes: [{name: p, center_m: [0, 0, 0], size_m: [1, 1e9], reflectivity: 1}]",
            "at most 100000000",
        ),
        ("ground: {z_m: 1e300, reflectivity: 1}", "ground.z_m: 1e+300 is too large; allowed: at most 100000000"),
    ],
)
def test_refused(tmp_path, text, message):
    with refused(message, r"scene\.yaml"):
        scene(tmp_path, text)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "not a whole ply file: line 1: expected 'ply'"),
        ("hello", "not a whole ply file: line 1: expected 'ply'"),
        (PLY.format(n=3, m=1) + "0 0 0\n1 0", "not a whole ply file: element 'vertex': row 1: property 'z': early end"),
        (PLY.format(n=3, m=0) + "0 0 0\n1 0 0\n0 1 0\n", "no triangles"),
        (PLY.format(n=3, m=1) + "0 0 0\n1 0 0\nnan 1 0\n3 0 1 2\n", "vertex 2 is not finite"),
        (PLY.format(n=3, m=1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "a triangle names vertex 7; there are 3"),
    ],
)
def test_unsound_mesh(tmp_path, content, message, capfd):
    """One error, and no library says anything besides."""
    (tmp_path / "m.ply").write_text(content)
    with refused(message, r"scene\.yaml:2:20: meshes\[0\]\.file: .*m\.ply: ", ConfigError):
        scene(tmp_path, "meshes: [{name: m, file: m.ply, position_m: [0, 0, 0], reflectivity: 1}]")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("text", [True, False])
def test_comments_need_not_be_ascii(tmp_path, text):
    vertex = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [("x", "f8"), ("y", "f8"), ("z", "f8")])
    face = np.array([([0, 1, 2],)], [("vertex_indices", "i4", (3,))])
    elements = [plyfile.PlyElement.describe(vertex, "vertex"), plyfile.PlyElement.describe(face, "face")]
    plyfile.PlyData(elements, text=text, comments=["by Muller"]).write(str(tmp_path / "m.ply"))
    (tmp_path / "m.ply").write_bytes((tmp_path / "m.ply").read_bytes().replace(b"Muller", "Müller".encode()))
    vertices, triangles = read_mesh(tmp_path / "m.ply")
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert triangles.tolist() == [[0, 1, 2]]


def test_mesh_without_permission(tmp_path, monkeypatch):
    (tmp_path / "m.ply").write_text("")

    def refuse(path, mode):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(SceneError, match=r"m\.ply: permission denied"):
        read_mesh(tmp_path / "m.ply")


@pytest.mark.parametrize(("vertex", "scale"), [("1e30", 1), ("1e5", 1e4), ("1e307", 1e7)])
def test_mesh_that_is_too_large(tmp_path, vertex, scale):
    text = PLY.format(n=3, m=1).replace("float", "double") + f"0 0 0\n1 0 0\n0 {vertex} 0\n3 0 1 2\n"
    (tmp_path / "m.ply").write_text(text)
    with pytest.raises(ConfigError, match=r"meshes\[0\]\.file: m\.ply: vertex 2 is beyond 1e\+08 m with the scale"):
        scene(
            tmp_path, f"meshes: [{{name: m, file: m.ply, position_m: [0, 0, 0], scale: {scale:.1f}, reflectivity: 1}}]"
        )


def test_the_largest_things(tmp_path):
    """Also at UTM coordinates."""
    sphere = scene(tmp_path, "spheres: [{name: s, center_m: [5e5, 1e7, -1e8], radius_m: 1e8, reflectivity: 9}]")
    assert volume(sphere) == pytest.approx(4 / 3 * math.pi * 1e24, rel=1e-3)


def test_no_file(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        load_scene(tmp_path / "none.yaml")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("real", ["f4", "f8"])
def test_a_binary_ply_is_read_as_open3d_reads_it(tmp_path, order, real):
    rng = np.random.default_rng(3)
    vertex = np.zeros(40, [("x", real), ("y", real), ("z", real), ("quality", "u1")])
    for axis in "xyz":
        vertex[axis] = rng.normal(size=40)
    corners = rng.permuted(np.tile(np.arange(40), (30, 1)), axis=1)
    for name, sizes in (("triangles", [3] * 30), ("some_quads", [3, 4] * 15)):
        face = np.empty(30, [("vertex_indices", object)])
        face["vertex_indices"] = [row[:size].astype("i4") for row, size in zip(corners, sizes, strict=True)]
        elements = [plyfile.PlyElement.describe(vertex, "vertex"), plyfile.PlyElement.describe(face, "face")]
        path = tmp_path / f"{name}.ply"
        plyfile.PlyData(elements, byte_order=order).write(str(path))
        mesh = o3d.io.read_triangle_mesh(str(path))
        vertices, triangles = read_mesh(path)
        assert np.array_equal(vertices, np.asarray(mesh.vertices))
        assert np.array_equal(triangles, np.asarray(mesh.triangles))
        assert len(triangles) == sum(sizes) - 2 * len(sizes)
