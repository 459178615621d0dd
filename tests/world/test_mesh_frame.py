"""A vehicle that lies on its side is told from its symmetry: our vehicles, turned out of the vehicle frame."""

import numpy as np
import pytest
import yaml

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose, transform
from lidarcfg.returns.target import mesh_target
from lidarcfg.study.loading import load_study
from lidarcfg.world.mesh_frame import AS_IS, TURNS, likely_rpy_deg
from lidarcfg.world.mesh_source import Triangles
from lidarcfg.world.meshes import box_mesh, read_mesh
from lidarcfg.world.scene_file import Box
from lidarcfg.world.vehicle import Vehicle, load_vehicle
from tests.documents import ROOT

VEHICLES = sorted((ROOT / "data/vehicles").glob("*.ply"))


def turned(path, rpy_deg):
    """The mesh in a frame that `rpy_deg` turns into the vehicle's."""
    vertices, triangles = read_mesh(path)
    return transform(np.linalg.inv(pose((0, 0, 0), np.radians(rpy_deg))), vertices), triangles


@pytest.mark.parametrize("path", VEHICLES, ids=lambda path: path.stem)
@pytest.mark.parametrize("rpy_deg", [AS_IS, *TURNS], ids=str)
def test_the_turn_that_brings_a_vehicle_upright_is_found(path, rpy_deg):
    even = path.stem in ("bus", "shuttle")  # from front to rear, too: that they drive sideways cannot be told
    assert likely_rpy_deg(turned(path, rpy_deg)) == (AS_IS if even and rpy_deg == (0, 0, -90) else rpy_deg)


@pytest.mark.parametrize(
    ("rpy_deg", "told"),
    [
        ((90, 0, 0), "is 4.8 × 1.5 × 2.055 m large and not alike on its left and its right, as if y is up"),
        (
            (90, 0, 90),
            "is 2.055 × 1.5 × 4.8 m large and not alike on its left and its right, as if y is up and z forward",
        ),
        ((0, 0, -90), "is 2.055 × 4.8 × 1.5 m large and not alike on its left and its right, as if y is forward"),
    ],
)
def test_it_is_told_with_the_line_to_write(tmp_path, rpy_deg, told):
    vertices, triangles = turned(ROOT / "data/vehicles/sedan.ply", rpy_deg)
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    (tmp_path / "body.obj").write_text("\n".join(lines))
    (message,) = load_vehicle(tmp_path / "body.obj").warnings
    line = f"rpy_deg: [{', '.join(map(str, rpy_deg))}]"
    assert message == f"{tmp_path / 'body.obj'}: 'body' of body.obj {told}; if so, set {line}"
    (tmp_path / "v.yaml").write_text(f"meshes: [{{name: body, file: body.obj, {line}}}]")
    assert load_vehicle(tmp_path / "v.yaml").warnings == ()
    (tmp_path / "v.yaml").write_text("meshes: [{name: body, file: body.obj, rpy_deg: [0, 0, 180]}]")
    (message,) = load_vehicle(tmp_path / "v.yaml").warnings
    assert message.endswith(told)


def test_a_box_and_one_of_several_parts_are_not_doubted():
    box = box_mesh(Box(name="b", reflectivity=20, center_m=(0, 0, 1), size_m=(2, 2, 2)))
    flat = np.zeros((3, 3)), np.array([[0, 1, 2]])
    lying = Triangles.of(turned(ROOT / "data/vehicles/sedan.ply", (90, 0, 0)))
    assert likely_rpy_deg(box) == likely_rpy_deg(flat) == AS_IS
    assert len(Vehicle.from_meshes({"a": lying}).warnings) == 1
    assert Vehicle.from_meshes({"a": lying, "b": box}).warnings == ()


def test_a_vehicle_in_millimetres_that_leaves_nothing_of_a_study_is_told():
    van = Triangles.of(box_mesh(Box(name="b", reflectivity=20, center_m=(0, 0, 900), size_m=(4800, 2000, 1800))))
    study = yaml.safe_load((ROOT / "data/studies/sedan.yaml").read_text())
    study["vehicle"] = {"meshes": [{"name": "body", "file": van, "exclude": True}]}
    with pytest.raises(ConfigError) as told:
        load_study(study)
    assert str(told.value) == (
        "study: vehicle: leaves no cuboid in the region\n"
        "study: vehicle.meshes[0].file: 'body' of a mesh of 12 triangles is 4800 × 2000 × 1800 m large; "
        "if its unit is the millimetre, set scale: 0.001"
    )


def test_an_object_in_millimetres_is_refused():
    vertices, triangles = read_mesh(ROOT / "data/objects/child.ply")
    with pytest.raises(ConfigError, match=r"is 1100.1 m large; allowed: up to 100 m, as a mesh is in metres"):
        mesh_target(ROOT, Triangles.of((1000 * vertices, triangles)))
