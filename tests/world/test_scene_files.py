"""Height fields, glTF of several nodes and surfels: against their definitions and closed forms; what is refused."""

import json
import math
import struct

import numpy as np
import plyfile
import pytest
from PIL import Image

from lidarcfg import inputs
from lidarcfg.clouds.cloud import save_clouds
from lidarcfg.clouds.las import save_las
from lidarcfg.errors import LidarcfgError
from lidarcfg.world.gltf_models import read_nodes
from lidarcfg.world.height_field import read_heights
from lidarcfg.world.surfels import CORNER, read_points
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import scene
from tests.clouds.test_cloud import cloud
from tests.naive.scene_files import disc_hit, height_field_hit
from tests.refusals import refused

FIELD = "height_fields: [{{name: land, {}, cell_m: {}, position_m: [{}, {}, {}], reflectivity: 12}}]"
HERE = np.zeros(3)


def field(tmp_path, given, cell=1.0, position=(0.0, 0.0, 0.0)):
    return scene(tmp_path, FIELD.format(given, cell, *position))


def saved(tmp_path, heights):
    np.save(tmp_path / "land.npy", heights)
    return "file: land.npy"


def rays(rng, count, around, spread):
    """From above a square, downwards and across."""
    origins = np.column_stack([rng.uniform(*around, (count, 2)), rng.uniform(3, 6, count)])
    way = np.column_stack([rng.normal(0, spread, (count, 2)), -np.ones(count)])
    return origins, way / np.linalg.norm(way, axis=1, keepdims=True)


def test_a_rough_field_is_what_its_definition_says(tmp_path):
    """Rows run from the north, the last row's first height stands at the position; found half cell by half cell."""
    rng = np.random.default_rng(4)
    heights = rng.normal(0, 0.6, (7, 9))
    place = np.array([100.0, -50.0, 2.0])
    land = field(tmp_path, saved(tmp_path, heights), 0.5, place)
    origins, way = rays(rng, 300, (-0.5, 4), 0.4)
    found = Tracer(land, place).cast(origins + place, way)
    expected = np.array([height_field_hit(heights.tolist(), 0.5, o, w) for o, w in zip(origins, way, strict=True)])
    np.testing.assert_allclose(found.range_m, expected, rtol=1e-11)
    assert 50 < np.isfinite(expected).sum() < 250


def test_a_slope_is_a_plane(tmp_path):
    """z = 0.3 x - 0.2 y + 1, in steps of 1/8 so that the heights are exact: the range in closed form."""
    x, y = np.meshgrid(np.arange(33) * 0.5, np.arange(25)[::-1] * 0.5)
    land = field(tmp_path, saved(tmp_path, 0.25 * x - 0.125 * y + 1), 0.5)
    origins, way = rays(np.random.default_rng(1), 2000, (4, 8), 0.3)
    hits = Tracer(land, HERE).cast(origins, way)
    normal = np.array([-0.25, 0.125, 1])
    np.testing.assert_allclose(hits.range_m, (1 - origins @ normal) / (way @ normal), rtol=1e-13)
    np.testing.assert_allclose(abs(hits.normal @ normal), np.linalg.norm(normal), rtol=1e-12)
    assert land.names == ("land",)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32, np.int64])
def test_a_png_an_array_and_heights_written_in_the_scene_are_one_field(tmp_path, kind):
    values = np.array([[3, 1, 2], [250, 0, 7]])
    written = (values * 0.02).tolist()
    if kind in (np.uint8, np.uint16):
        Image.fromarray(values.astype(kind)).save(tmp_path / "land.png")
        file = "land.png"
    else:
        np.save(tmp_path / "land.npy", values.astype(kind))
        file = "land.npy"
    read = field(tmp_path, f"file: {file}, scale: 0.02", 2.0, (1, 2, 3))
    here = field(tmp_path, f"heights_m: {written}", 2.0, (1, 2, 3))
    np.testing.assert_array_equal(read.vertices_m, here.vertices_m)
    np.testing.assert_array_equal(read.triangles, here.triangles)
    np.testing.assert_allclose(read.vertices_m[[0, 2, 3, 5]], [[1, 4, 3.06], [5, 4, 3.04], [1, 2, 8], [5, 2, 3.14]])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("cell_m: 1", "heights_m: missing; or give a file"),
        ("file: a.npy, heights_m: [[1, 2], [3, 4]], cell_m: 1", "heights_m: conflicts with file; give only one of them"),
        ("heights_m: [[1, 2], [3, 4]], cell_m: 1, scale: 2", "scale: belongs to a file; heights_m are metres"),
        ("heights_m: [[1, 2], [3]], cell_m: 1", "heights_m[1]: has 1 heights; allowed: 2, as in the first row"),
        ("heights_m: [[1], [3]], cell_m: 1", "heights_m[0]: has 1 heights; allowed: at least 2"),
        ("heights_m: [[1, 2]], cell_m: 1", "heights_m: has 1 value; allowed: at least 2"),
        ("heights_m: [[1, .nan], [1, 2]], cell_m: 1", "is not a finite number"),
        ("heights_m: [[1, 2], [3, 4]], cell_m: 0", "cell_m: 0 is too small; allowed: above 0"),
        ("heights_m: [[1, 2], [3, 4]]", "cell_m: missing"),
        ("file: none.npy, cell_m: 1", "none.npy: no such file"),
        ("file: land.tif, cell_m: 1", "land.tif: is no height field; allowed: .png, .npy"),
        ("file: nan.npy, cell_m: 1", "nan.npy: row 1, column 2 is nan; a height must be finite"),
        ("file: line.npy, cell_m: 1", "line.npy: has 1 axes of float64; allowed: 2, rows and columns, of numbers"),
        ("file: text.npy, cell_m: 1", "text.npy: not a whole npy file: "),
        ("file: row.npy, cell_m: 1", "row.npy: has 1 × 5 heights; allowed: at least 2 × 2"),
        ("file: high.npy, cell_m: 1", "high.npy: a height is 1e+09 m; allowed: at most 1e+08"),
        ("file: huge.npy, cell_m: 1", "has 3,999,900,000 cells, which take 2,400 GB of memory; allowed: at most 10,000,000"),
        ("file: huge.png, cell_m: 1", "has 9,999,800,001 cells, which take 6,000 GB of memory; allowed: at most 10,000,000"),
        ("file: colour.png, cell_m: 1", "colour.png: is not an image in grey of 8 or 16 bits; colours are no heights"),
        ("file: cut.png, cell_m: 1", "cut.png: not a whole png file: "),
        ("file: text.png, cell_m: 1", "text.png: is no PNG file"),
    ],
)  # fmt: skip
def test_fields_that_are_refused(tmp_path, monkeypatch, given, message):
    (tmp_path / "land.tif").write_bytes(b"II*\0")
    (tmp_path / "text.npy").write_text("hello")
    (tmp_path / "text.png").write_text("hello")
    nan = np.zeros((3, 4))
    nan[1, 2] = math.nan
    for name, values in (
        ("nan", nan),
        ("line", np.zeros(5)),
        ("row", np.zeros((1, 5))),
        ("high", np.full((2, 2), 1e9)),
    ):
        np.save(tmp_path / f"{name}.npy", values)
    with open(tmp_path / "huge.npy", "wb") as file:
        shape = 40_000, 100_001
        np.lib.format.write_array_header_1_0(file, {"descr": "|u1", "fortran_order": False, "shape": shape})
        file.truncate(file.tell() + math.prod(shape))
    if "huge.npy" in given:  # larger than any file that is read; its size is told by its header alone
        monkeypatch.setattr("lidarcfg.world.height_field.FILE_MAX", 10**10)
    noise = np.random.default_rng(1).integers(0, 9, (50, 50), np.uint8)
    Image.fromarray(np.dstack([noise] * 3)).save(tmp_path / "colour.png")
    Image.fromarray(noise).save(tmp_path / "cut.png")
    whole = (tmp_path / "cut.png").read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "huge.png").write_bytes(whole[:16] + struct.pack(">IIBB", 100_000, 100_000, 8, 0) + whole[26:])
    with refused(message, r"scene\.yaml:2:\d+: height_fields\[0\]"):
        scene(tmp_path, f"height_fields: [{{name: f, {given}, position_m: [0, 0, 0], reflectivity: 12}}]")


def test_a_field_that_memory_does_not_hold(tmp_path, monkeypatch):
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 1e6)
    with pytest.raises(LidarcfgError, match=r"a height field of 9,801 cells needs 0\.0 GB of memory"):
        field(tmp_path, saved(tmp_path, np.zeros((100, 100))))


def glb(path, nodes, materials=("brick", "glass"), primitives=((0, 1),), damaged=None):
    """A glTF file, by its specification: the unit square from (0, 0, 0) in x and y, once a mesh, with materials each."""
    data = (
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4").tobytes()
        + np.uint16([0, 1, 2, 0, 2, 3]).tobytes()
    )
    root = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [i for i in range(len(nodes)) if not any(i in n.get("children", ()) for n in nodes)]}],
        "nodes": nodes,
        "materials": [{"name": name} for name in materials],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": m} for m in used]}
            for used in primitives
        ],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    }
    text = json.dumps(root | (damaged or {})).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks)


MODEL = "models: [{{name: block, file: a.glb, position_m: [{}], reflectivity: 30{}}}]"
TURN = [0, 0, math.sqrt(0.5), math.sqrt(0.5)]  # 90° about glTF's z, by hand below
NODES = [
    {"name": "house", "translation": [10, 0, 0], "children": [1], "mesh": 0},
    {"name": "door", "translation": [0, 2, 0], "rotation": TURN, "scale": [3, 1, 1], "mesh": 1},
]


def corners(stage, name):
    """The vertices of an object's triangles."""
    return stage.vertices_m[np.unique(stage.triangles[stage.triangle_object == stage.names.index(name)])]


def test_each_node_is_an_object_in_its_place(tmp_path):
    """The door is turned and stretched, then moved with its house; y up becomes z up, -z y: worked out by hand."""
    glb(tmp_path / "a.glb", NODES, primitives=((0,), (1,)))
    stage = scene(tmp_path, MODEL.format("1, 2, 3", ", materials: {glass: 5}"))
    assert stage.names == ("block/door", "block/house")
    assert stage.reflectivity.tolist() == [5, 30]
    np.testing.assert_allclose(
        sorted(corners(stage, "block/house").tolist()), [[11, 2, 3], [11, 2, 4], [12, 2, 3], [12, 2, 4]]
    )
    # (x, y, 0) → (3x, y, 0) → (-y, 3x, 0) → (10 - y, 2 + 3x, 0) → z up: (10 - y, 0, 2 + 3x) → placed
    np.testing.assert_allclose(
        sorted(corners(stage, "block/door").tolist()), [[10, 2, 5], [10, 2, 8], [11, 2, 5], [11, 2, 8]], atol=1e-12
    )
    hits = Tracer(stage, HERE).cast(np.array([[11.5, 0, 3.5], [10.5, 0, 6]]), np.array([[0, 1.0, 0], [0, 1.0, 0]]))
    assert hits.range_m.tolist() == pytest.approx([2, 2], abs=1e-12)
    assert [stage.names[i] for i in hits.object] == ["block/house", "block/door"]


def test_a_node_of_several_materials_is_an_object_a_material(tmp_path):
    glb(tmp_path / "a.glb", [{"name": "house", "mesh": 0}])
    for _ in range(2):  # trimesh names such parts at random
        stage = scene(tmp_path, MODEL.format("0, 0, 0", ", materials: {brick: 40, glass: 5}"))
        assert stage.names == ("block/house/brick", "block/house/glass")
        assert stage.reflectivity.tolist() == [40, 5]


def test_only_the_nodes_that_are_named(tmp_path):
    glb(tmp_path / "a.glb", NODES, primitives=((0,), (1,)))
    assert scene(tmp_path, MODEL.format("0, 0, 0", ", nodes: [door]")).names == ("block/door",)


@pytest.mark.parametrize(
    ("given", "made", "message"),
    [
        (", nodes: [dor]", {}, "a.glb: has no node 'dor'; did you mean 'door'? it has 'door', 'house'"),
        (", materials: {brik: 3}", {}, "has no material 'brik'; did you mean 'brick'? it has 'brick', 'glass'"),
        (", materials: {brick: 300}", {}, "materials.brick: 300 is too large; allowed: at most 255"),
        ("", {"nodes": [{"name": "a"}]}, "a.glb: no triangles in any of its nodes"),
        ("", {"accessors": []}, "a.glb: not a whole glTF file: "),
        ("", {"nodes": [{"name": "a", "mesh": 0, "scale": [0, 0, 0]}]}, "node 'a' is a single point; if the file is"),
    ],
)
def test_models_that_are_refused(tmp_path, given, made, message):
    glb(tmp_path / "a.glb", NODES, primitives=((0,), (1,)), damaged=made)
    with refused(message, r"scene\.yaml:2:\d+: models\[0\]"):
        scene(tmp_path, MODEL.format("0, 0, 0", given))


BONES = {"skins": [{"joints": [1]}], "nodes": [{"name": "man", "mesh": 0, "skin": 0}, {"name": "hip"}]}
SHARED = [{"name": "a", "children": [2]}, {"name": "b", "children": [2]}, {"name": "wheel", "mesh": 0}]
MANY = {"name": "tree", "mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (
            BONES,
            "node 'man' has a skin, whose bones bend its mesh (in Blender, an Armature modifier); apply them, so that",
        ),
        (
            {"nodes": [{"name": "a", "mesh": 0}, {"mesh": 7}]},
            "node '1' names mesh 7, of 2; export it again, with its mesh",
        ),
        ({"nodes": [{"name": "a", "mesh": -1}]}, "node 'a' names mesh -1, of 2; export it again, with its mesh"),
        (
            {"nodes": [{"name": "face", "mesh": 0, "weights": [0, 0.5]}]},
            "node 'face' has morph targets in use (in Blender,",
        ),
        ({"nodes": SHARED}, "node 'wheel' has 2 parents; allowed is one: export it again, with a copy under each"),
        (
            {"nodes": [MANY]},
            "node 'tree' stands for several by EXT_mesh_gpu_instancing; export it again without instancing",
        ),
        ({"nodes": {"a": {"mesh": 0}}}, "a.glb: not a whole glTF file: "),
        ({"nodes": [{"children": [[1]]}]}, "a.glb: not a whole glTF file: "),
    ],
)
def test_nodes_that_would_be_shown_otherwise(tmp_path, made, message):
    """By name, for a model and for a mesh, whose reader crashes on skins without matrices."""
    glb(tmp_path / "a.glb", NODES, primitives=((0,), (1,)), damaged=made)
    with refused(message, r"scene\.yaml:2:\d+: models\[0\]"):
        scene(tmp_path, MODEL.format("0, 0, 0", ""))
    with refused(message, r"scene\.yaml:2:\d+: meshes\[0\]"):
        scene(tmp_path, "meshes: [{name: m, file: a.glb, position_m: [0, 0, 0], reflectivity: 3}]")


def test_nodes_beside_those_that_are_wanted(tmp_path):
    """A skin is no matter where another node is asked for; a node without triangles is said to be one."""
    nodes = [{"name": "man", "mesh": 0, "skin": 0}, {"name": "hip"}, {"name": "door", "mesh": 1}]
    still = [{"name": "rest", "mesh": 0, "weights": [0, 0]}]
    made = {"skins": [{"joints": [1]}], "nodes": nodes + still}
    glb(tmp_path / "a.glb", nodes + still, primitives=((0,), (1,)), damaged=made)
    assert scene(tmp_path, MODEL.format("0, 0, 0", ", nodes: [door, rest]")).names == ("block/door", "block/rest")
    with refused("a.glb: node 'hip' has no triangles; it has 'door', 'man', 'rest'", r"scene\.yaml:2:\d+: models\[0\]"):
        scene(tmp_path, MODEL.format("0, 0, 0", ", nodes: [door, hip]"))


def test_a_node_called_as_another_object(tmp_path):
    glb(tmp_path / "a.glb", NODES, primitives=((0,), (1,)))
    box = "boxes: [{name: block/door, center_m: [0, 0, 0], size_m: [1, 1, 1], reflectivity: 3}]\n"
    with pytest.raises(LidarcfgError, match=r"models.*'block/door' would be two objects; each name"):
        scene(tmp_path, box + MODEL.format("0, 0, 0", ""))


def test_a_file_that_is_no_gltf(tmp_path):
    for name, what in (("a.glb", "not a whole glTF file: "), ("a.obj", "is no glTF file; allowed: .gltf, .glb")):
        (tmp_path / name).write_text("hello")
        with pytest.raises(LidarcfgError, match=what):
            scene(tmp_path, f"models: [{{name: b, file: {name}, position_m: [0, 0, 0], reflectivity: 3}}]")


SURFELS = "surfels: [{{name: map, file: {}, radius_m: {}, position_m: [0, 0, 0], reflectivity: 30}}]"


def ply(path, points, normals=None, text=False):
    names = ["x", "y", "z", *(("nx", "ny", "nz") if normals is not None else ())]
    rows = np.array(points) if normals is None else np.hstack([points, normals])
    table = np.array([tuple(row) for row in rows], [(name, "<f8") for name in names])
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")], text=text).write(str(path))


def test_a_plane_of_surfels_is_the_plane(tmp_path):
    """Points 0.1 m apart on a slanted plane, normals estimated: each ray hits it where the plane is, none passes."""
    normal = np.array([1.0, -2, 3]) / math.sqrt(14)
    u = np.array([2.0, 1, 0]) / math.sqrt(5)
    grid = np.stack(np.meshgrid(np.arange(-20, 21), np.arange(-20, 21)), axis=-1).reshape(-1, 2) * 0.1
    points = grid @ np.stack([u, np.cross(normal, u)]) + (500_000, 4_000_000, 30)
    ply(tmp_path / "a.ply", points)
    stage = scene(tmp_path, SURFELS.format("a.ply", 0.08))
    rng = np.random.default_rng(3)
    centre = points.mean(axis=0)
    aims = rng.uniform(-1.8, 1.8, (1000, 2)) @ np.stack([u, np.cross(normal, u)])
    origins = 5 * normal + rng.normal(0, 1, (1000, 3))
    way = (aims - origins) / np.linalg.norm(aims - origins, axis=1, keepdims=True)
    hits = Tracer(stage, centre).cast(origins + centre, way)
    np.testing.assert_allclose(hits.range_m, -(origins @ normal) / (way @ normal), rtol=1e-7)  # coordinates of 4e6 m
    np.testing.assert_allclose(abs(hits.normal @ normal), 1, rtol=1e-12)


@pytest.mark.slow
def test_surfels_are_within_a_tenth_of_discs(tmp_path):
    """Hexagons of a disc's area: what hits the disc within lies in one of them, what misses the one around hits none."""
    rng = np.random.default_rng(6)
    points = rng.uniform(-2, 2, (60, 3))
    normals = rng.normal(size=(60, 3))
    ply(tmp_path / "a.ply", points, normals * 7)
    stage = scene(tmp_path, SURFELS.format("a.ply", 0.4))
    triangles = stage.vertices_m[stage.triangles]
    area = (
        np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum() / 2
    )
    assert area == pytest.approx(60 * math.pi * 0.16, rel=1e-12)
    units = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    way = rng.normal(size=(400, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    found = Tracer(stage, HERE).cast(np.zeros((400, 3)), way).range_m
    inner = [disc_hit(points, units, 0.4 * CORNER * math.cos(math.pi / 6), HERE, one) for one in way]
    outer = [disc_hit(points, units, 0.4 * CORNER, HERE, one) for one in way]
    assert (found <= np.array(inner) + 1e-9).all()
    assert (found >= np.array(outer) - 1e-9).all()
    assert CORNER == pytest.approx(1.0996, abs=1e-4)
    assert 100 < np.isfinite(found).sum() < 400


def test_points_of_any_file_are_the_same(tmp_path):
    """Our clouds as PLY, PCD, npz and LAS (which rounds to 0.1 mm); others' with normals as npz and in ASCII."""
    made = cloud(200)
    for suffix in ("ply", "pcd", "npz"):
        save_clouds(tmp_path / f"a.{suffix}", [made])
    save_las(tmp_path / "a.las", made)
    save_las(tmp_path / "a.laz", made)
    for suffix in ("ply", "pcd", "npz", "las", "laz"):
        points, normals = read_points(tmp_path / f"a.{suffix}")
        np.testing.assert_allclose(points, made.xyz, atol=6e-5 if suffix.startswith("la") else 0)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-12)
    up = np.tile([0.0, 0, 2], (200, 1))
    ply(tmp_path / "b.ply", made.xyz, up, text=True)
    np.savez(tmp_path / "b.npz", xyz=made.xyz, normals=up)
    for name in ("b.ply", "b.npz"):
        np.testing.assert_array_equal(read_points(tmp_path / name)[1], up / 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "radius", "message"),
    [
        ("a.ply", "0", "surfels[0].radius_m: 0 is too small; allowed: above 0"),
        ("none.ply", "1", "none.ply: no such file"),
        ("empty.ply", "1", "empty.ply: has no points"),
        ("two.ply", "1", "two.ply: has 2 points without normals; allowed: at least 3"),
        ("nan.ply", "1", "nan.ply: point 1 is not finite"),
        ("zero.ply", "1", "zero.ply: the normal of point 2 is 0"),
        ("a.e57", "1", "a.e57: is no cloud of points; allowed: .ply, .pcd, .npz, .las, .laz"),
        ("text.ply", "1", "text.ply: not a whole ply file: "),
        ("text.pcd", "1", "text.pcd: not a whole pcd file: "),
        ("text.las", "1", "text.las: not a whole las file: "),
        ("text.npz", "1", "text.npz: not a whole npz file: "),
        ("flat.npz", "1", "flat.npz: xyz has the shape (4, 2); allowed: points × 3, numbers"),
        ("bare.npz", "1", "bare.npz: missing: xyz"),
        ("flat.ply", "1", "flat.ply: missing: z"),
        ("many.npz", "1", "many.npz: has 1,000,001 points; allowed: at most 1,000,000; thin it out"),
        ("far.ply", "1", "far.ply: vertex 0 is beyond 1e+08 m with the scale 1"),
    ],
)
def test_surfels_that_are_refused(tmp_path, name, radius, message):
    points = np.eye(3)
    for file in ("a.e57", "text.ply", "text.pcd", "text.las", "text.npz"):
        (tmp_path / file).write_text("hello")
    ply(tmp_path / "a.ply", points)
    ply(tmp_path / "empty.ply", np.empty((0, 3)))
    ply(tmp_path / "two.ply", points[:2])
    ply(tmp_path / "nan.ply", [[0, 0, 0], [0, math.nan, 0]], [[0, 0, 1.0]] * 2)
    ply(tmp_path / "zero.ply", points, [[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0]])
    ply(tmp_path / "far.ply", points * 1e12)
    (tmp_path / "flat.ply").write_text(FLAT)
    np.savez(tmp_path / "flat.npz", xyz=np.zeros((4, 2)))
    np.savez(tmp_path / "bare.npz", points=points)
    if name == "many.npz":
        np.savez(tmp_path / "many.npz", xyz=np.zeros((1_000_001, 3)))
    with refused(message, r"scene\.yaml:2:\d+: surfels\[0\]"):
        scene(tmp_path, SURFELS.format(name, radius))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["png", "npy", "glb", "ply", "pcd", "npz", "las", "laz"])
def test_damaged_files_are_used_or_refused_in_one_line(tmp_path, suffix):
    """Cut off, or with octets changed, most of them in the header; a warning of a library would be an error here."""
    made = cloud(30)
    whole = tmp_path / f"whole.{suffix}"
    rng = np.random.default_rng(list(suffix.encode()))
    if suffix == "glb":
        glb(whole, NODES, primitives=((0,), (1,)))
    elif suffix in ("png", "npy"):
        heights = rng.integers(0, 99, (12, 9), np.uint16)
        Image.fromarray(heights).save(whole) if suffix == "png" else np.save(whole, heights)
    else:
        (save_las if suffix in ("las", "laz") else lambda path, one: save_clouds(path, [one]))(whole, made)
    read = {"png": read_heights, "npy": read_heights, "glb": read_nodes}.get(suffix, read_points)
    refused = []
    for _ in range(50):
        data = bytearray(whole.read_bytes())
        if rng.random() < 0.2:
            data = data[: rng.integers(len(data))]
        for at in rng.integers(min(len(data), 400), size=rng.integers(1, 6)) if data else ():
            data[at] = rng.choice([0, 255, *b"0123456789{}-", data[at] ^ 1 << rng.integers(8)])
        (tmp_path / f"damaged.{suffix}").write_bytes(data)
        try:
            read(tmp_path / f"damaged.{suffix}")
        except LidarcfgError as error:
            refused.append(str(error))
    assert len(refused) > 5
    assert all("\n" not in one and f"damaged.{suffix}" in one for one in refused)


FLAT = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n0 0\n"
