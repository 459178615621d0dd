"""Meshes that users bring, in every format: read, closed or not, of a size that says its unit; by Open3D and by hand."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from lidarcfg.config.document import yaml_text
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose, transform
from lidarcfg.world.mesh_frame import gltf_rpy_deg
from lidarcfg.world.meshes import box_mesh
from lidarcfg.world.scene_file import Box
from lidarcfg.world.solids import connected_components, merge_vertices, open_edges
from lidarcfg.world.vehicle import load_vehicle
from tests.command_line import lidarcfg

ROOT = Path(__file__).parents[2]
SEDAN = ROOT / "data/vehicles/sedan.ply"
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)  # of a tetrahedron
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.uint16)


def write_glb(path, nodes, roots, vertices=CORNERS, faces=FACES):
    """A glTF binary, by its specification, of nodes that all show one mesh."""
    data = vertices.astype(np.float32).tobytes() + faces.astype(np.uint16).tobytes()
    end = 12 * len(vertices)
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": end},
        {"buffer": 0, "byteOffset": end, "byteLength": len(data) - end},
    ]
    described = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": roots}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(vertices),
                "type": "VEC3",
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": faces.size, "type": "SCALAR"},
        ],
    }
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


def save(mesh, path):
    """A mesh by Open3D; STL wants normals."""
    mesh.compute_triangle_normals()
    assert o3d.io.write_triangle_mesh(str(path), mesh)
    return path


def vehicle_text(mesh, extra=""):
    """A vehicle file of one mesh."""
    return f"meshes: [{{name: body, file: {mesh}{extra}}}]\n"


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "off", "glb", "gltf"])
def test_a_saloon_in_any_format_is_the_same_closed_body(tmp_path, suffix):
    """STL knows no shared vertices; what is inside is told the same of all, and as Open3D tells it."""
    path = tmp_path / f"body.{suffix}"
    body = o3d.io.read_triangle_mesh(SEDAN)
    if suffix == "glb":  # Open3D's own are refused by its reader
        write_glb(path, [{"mesh": 0}], [0], np.asarray(body.vertices), np.asarray(body.triangles))
    else:
        save(body, path)
    found = load_vehicle(path)
    assert [said.partition(";")[0] for said in found.warnings] == [
        f"{path}: z is up by its looks, though a glTF file has y up"
    ] * (suffix in ("glb", "gltf"))
    assert list(found.closed) == ["body"]
    assert len(found.scene.triangles) == 5922
    x = np.linspace(-2.6, 2.6, 40)
    y = np.linspace(-1.1, 1.1, 25)
    z = np.linspace(-0.1, 1.6, 23)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(o3d.io.read_triangle_mesh(SEDAN)))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).astype(np.float32)
    far = caster.compute_signed_distance(o3d.core.Tensor(points)).numpy()
    clear = abs(far) > 1e-4
    assert (found.inside("body", x, y, z) == (far < 0))[clear].all()
    assert clear.mean() > 0.99


def test_the_nodes_of_a_gltf_are_each_in_their_place(tmp_path):
    """A child is moved with its parent: rotated by a quarter about z, then by 100 m along x, by hand."""
    write_glb(
        tmp_path / "nodes.glb",
        [
            {"children": [1, 2], "translation": [100, 0, 0], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)]},
            {"mesh": 0, "translation": [10, 0, 0]},
            {"mesh": 0, "scale": [2, 2, 2], "children": [3]},
            {"mesh": 0, "translation": [0, 0, 3]},
        ],
        [0],
    )
    (tmp_path / "nodes.yaml").write_text(vehicle_text("nodes.glb"))  # in which nothing is turned
    body = load_vehicle(tmp_path / "nodes.yaml")
    vertices, triangles = body.closed["body"]
    turn = pose((100, 0, 0), (0, 0, np.pi / 2))
    local = (CORNERS + np.array([10, 0, 0]), CORNERS * 2, CORNERS * 2 + np.array([0, 0, 6]))
    expected = np.unique(np.concatenate([transform(turn, one) for one in local]).round(4), axis=0)
    np.testing.assert_allclose(np.unique(vertices[np.unique(triangles)].round(4), axis=0), expected, atol=2e-4)
    assert len(triangles) == 12
    assert len(connected_components((vertices, triangles))) == 3


@pytest.mark.parametrize(("rpy_deg", "said"), [((90, 0, 90), "y is up and z forward"), ((90, 0, 0), "y is up")])
def test_a_gltf_file_is_turned_as_its_standard_has_it(tmp_path, rpy_deg, said):
    """The saloon as glTF writes it: y up, and z or x ahead; found as the PLY has it."""
    body = o3d.io.read_triangle_mesh(SEDAN)
    x, y, z = np.asarray(body.vertices).T
    lying = {(90, 0, 90): (y, z, x), (90, 0, 0): (x, z, -y)}[rpy_deg]
    path = tmp_path / "body.glb"
    write_glb(path, [{"mesh": 0}], [0], np.stack(lying, axis=1), np.asarray(body.triangles))
    found = load_vehicle(path)
    angles = ", ".join(map(str, rpy_deg))
    assert found.warnings == (f"{path}: {said}, as in glTF files: turned, as by rpy_deg: [{angles}]",)
    np.testing.assert_allclose(np.ptp(found.scene.vertices_m, axis=0), np.ptp([x, y, z], axis=1), atol=1e-6)
    np.testing.assert_allclose(found.scene.vertices_m.min(axis=0), (x.min(), y.min(), z.min()), atol=1e-6)
    (tmp_path / "v.yaml").write_text(yaml_text(found.section.values))
    assert np.array_equal(load_vehicle(tmp_path / "v.yaml").scene.vertices_m, found.scene.vertices_m)


@pytest.mark.parametrize(("size", "rpy_deg"), [((4, 2, 1), (90, 0, 0)), ((1, 2, 4), (90, 0, 90))])
def test_a_gltf_file_without_looks_is_taken_by_the_standard(size, rpy_deg):
    """A box: y is up, and the longer side ahead."""
    assert gltf_rpy_deg(box_mesh(Box(name="b", reflectivity=0, center_m=(0, 0, 0), size_m=size))) == rpy_deg


def strip(vertices):
    """Triangles that follow one another along so many vertices."""
    return np.stack([np.arange(n, vertices - 2 + n) for n in range(3)], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "triangles",
    [
        np.random.default_rng(1).integers(0, 3000, (1000, 3)),
        np.random.default_rng(2).permutation(5000)[strip(5000)],
        np.delete(strip(500), [70, 71, 200, 201, 202], axis=0)[::-1],
        np.empty((0, 3), np.int64),
    ],
    ids=["random", "long and shuffled", "cut", "none"],
)
def test_parts_are_what_a_walk_from_triangle_to_triangle_reaches(triangles):
    vertices = np.zeros((triangles.max(initial=0) + 1, 3))
    around = {}
    for number, corners in enumerate(triangles.tolist()):
        for corner in corners:
            around.setdefault(corner, []).append(number)
    part = {}
    for start in sorted(around):  # parts come in the order of their first vertices
        ahead = around[start]
        while ahead:
            ahead = [number for number in ahead if number not in part]
            part |= dict.fromkeys(ahead, start)
            ahead = [other for number in ahead for corner in triangles[number].tolist() for other in around[corner]]
    of = np.array([part[number] for number in range(len(triangles))], np.int64)
    expected = [triangles[of == start] for start in np.unique(of)]
    found = [corners for _, corners in connected_components((vertices, triangles))]
    assert len(found) == len(expected)
    assert all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))


def test_open_edges_by_hand(tmp_path):
    """A box without its lid: four edges; excluded it is an error, otherwise a warning."""
    box = o3d.geometry.TriangleMesh.create_box(4, 2, 1.5)
    lid = np.asarray(box.vertices)[np.asarray(box.triangles)][:, :, 2].min(axis=1) == 1.5
    box.remove_triangles_by_mask(lid)
    save(box, tmp_path / "box.ply")
    (tmp_path / "v.yaml").write_text(vehicle_text("box.ply"))
    found = load_vehicle(tmp_path / "v.yaml")
    assert found.closed == {}
    (message,) = found.warnings
    where = f"{tmp_path / 'v.yaml'}:1:{vehicle_text('box.ply').index('{name') + 1}: meshes[0]: "
    assert message == (
        f"{where}'body' of box.ply is not closed, so that nothing is inside: 4 of its edges bound an odd number of triangles, "
        f"the first from {message.partition('first from ')[2]}"
    )
    assert message.endswith("; 0 closed parts; it still blocks beams")
    first = [
        float(number)
        for number in message.partition("first from ")[2]
        .partition(";")[0]
        .translate(str.maketrans("(,)to", "     "))
        .split()
    ]
    assert first[2] == first[5] == 1.5
    (tmp_path / "v.yaml").write_text(vehicle_text("box.ply", ", exclude: true"))
    with pytest.raises(
        ConfigError,
        match=r"v\.yaml:1:\d+: meshes\[0\]\.exclude: 'body' of box\.ply is not closed.* 4 of its edges .*\(.* to \(.*; close the mesh, or remove exclude",
    ):
        load_vehicle(tmp_path / "v.yaml")


def test_parts_that_are_open_and_closed(tmp_path):
    both = o3d.geometry.TriangleMesh.create_box(1, 1, 1)
    both += o3d.geometry.TriangleMesh.create_sphere(0.5).translate((3, 0, 0))
    both.remove_triangles_by_index([0])
    (message,) = load_vehicle(save(both, tmp_path / "both.stl")).warnings
    assert "3 of its edges" in message
    assert "; 1 closed parts;" in message


@pytest.mark.parametrize(
    ("factor", "scale", "unit"), [(1000, 0.001, "millimetre"), (100, 0.01, "centimetre"), (1 / 0.0254, 0.0254, "inch")]
)
def test_a_mesh_in_another_unit_is_told_by_its_size(tmp_path, factor, scale, unit):
    body = o3d.io.read_triangle_mesh(SEDAN).scale(factor, np.zeros(3))
    save(body, tmp_path / "body.stl")
    (message,) = load_vehicle(tmp_path / "body.stl").warnings
    size = " × ".join(f"{value * factor:.4g}" for value in (4.7998, 2.0552, 1.5))
    assert (
        message
        == f"{tmp_path / 'body.stl'}: 'body' of body.stl is {size} m large; if its unit is the {unit}, set scale: {scale:g}"
    )
    (tmp_path / "v.yaml").write_text(vehicle_text("body.stl", f", scale: {scale}"))
    assert load_vehicle(tmp_path / "v.yaml").warnings == ()


def test_the_size_of_a_large_mesh_has_no_exponent(tmp_path):
    save(o3d.geometry.TriangleMesh.create_box(12_000, 2550, 2900), tmp_path / "bus.stl")
    (message,) = load_vehicle(tmp_path / "bus.stl").warnings
    assert "is 12000 × 2550 × 2900 m large; if its unit is the millimetre, set scale: 0.001" in message


def test_a_mesh_in_metres_that_is_scaled_down_is_told(tmp_path):
    (tmp_path / "v.yaml").write_text(vehicle_text(SEDAN, ", scale: 0.001"))
    (message,) = load_vehicle(tmp_path / "v.yaml").warnings
    assert re.match(rf"{tmp_path}/v.yaml:1:\d+: meshes\[0\].file: 'body' of ", message)
    assert message.endswith("is 0.0048 × 0.002055 × 0.0015 m large; if its unit is the metre, set scale: 1")


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"vertex 0 is not finite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", r"no triangles that Open3D can read"),
    ],
)
def test_a_mesh_that_cannot_be_used(tmp_path, text, error):
    (tmp_path / "body.obj").write_text(text)
    with pytest.raises(ConfigError, match=error):
        load_vehicle(tmp_path / "body.obj")
    with pytest.raises(ConfigError, match=r"none\.stl: no such file"):
        load_vehicle(tmp_path / "none.stl")


@pytest.mark.slow
def test_a_million_triangles_are_read_and_said(tmp_path):
    sphere = o3d.geometry.TriangleMesh.create_sphere(1.5, 501)
    assert len(sphere.triangles) == 1_002_000
    found = load_vehicle(save(sphere, tmp_path / "body.ply"))
    (message,) = found.warnings
    assert "the vehicle has 1,002,000 triangles; reading them took " in message
    assert found.body_at(np.array([0.0, 1.0, 0.5])) == "body"
    assert found.body_at(np.array([0.0, 1.5, 0.5])) is None


def test_welding_and_open_edges_are_those_of_numpy():
    """Against np.unique of rows, with places that repeat, are ±0 and differ in one bit."""
    rng = np.random.default_rng(1)
    vertices = rng.integers(-2, 3, (400, 3)) * np.float64(0.1)
    vertices[::7] = np.nextafter(vertices[::7], 9)
    vertices[::11] *= -0.0
    triangles = rng.integers(0, 400, (900, 3))
    places, corners = merge_vertices((vertices, triangles))
    assert len(places) == len(np.unique(vertices + 0.0, axis=0))
    whole = [row for row in vertices[triangles] + 0.0 if len(np.unique(row, axis=0)) == 3]
    assert (places[corners] == whole).all()
    counts = {}
    for corner in corners.tolist():
        for k in range(3):
            edge = frozenset((corner[k], corner[k - 1]))
            counts[edge] = counts.get(edge, 0) + 1
    odd = {edge for edge, count in counts.items() if count % 2}
    found = open_edges((places, corners))
    assert {frozenset(map(tuple, edge)) for edge in found.tolist()} == {
        frozenset(tuple(places[i].tolist()) for i in edge) for edge in odd
    }


@pytest.mark.slow
def test_commands_warn_of_a_vehicle(tmp_path):
    save(o3d.io.read_triangle_mesh(SEDAN).scale(1000, np.zeros(3)), tmp_path / "mm.stl")
    text = (ROOT / "data/studies/liu2018-1x4.yaml").read_text()
    (tmp_path / "study.yaml").write_text(
        text + "vehicle: {meshes: [{name: body, file: mm.stl, position_m: [0, 0, -9000]}]}\n"
    )
    (tmp_path / "rig.yaml").write_text("name: r\nsensors: [{name: s, model: vlp-16, position_m: [0, 0, 2]}]\n")
    (tmp_path / "scene.yaml").write_text("name: s\nground: {reflectivity: 9}\n")
    export = (
        "export",
        "rig.yaml",
        "--scene",
        "scene.yaml",
        "--duration",
        "0.01",
        "-o",
        "c.pcap",
        "--vehicle",
        "mm.stl",
    )
    for words, place in (
        (("evaluate", "study.yaml", "rig.yaml"), f"study.yaml:{text.count(chr(10)) + 1}:33: vehicle.meshes[0].file"),
        (export, "mm.stl"),
    ):
        said = lidarcfg(*words, "--quiet", cwd=tmp_path).stderr
        assert f"lidarcfg: warning: {place}: 'body' of mm.stl is 4800 × 2055 × 1500 m large" in said
