"""Python takes what the command line takes: paths, dicts and objects; anything else is our error, in one line."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
import yaml

import lidarcfg
from lidarcfg.capture.pcap import read_datagrams
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.geometry import rotation
from tests.test_tools import ROOT

RIG = ROOT / "data/rigs/roof.yaml"
SCENE = {"name": "box", "ground": {"reflectivity": 10}, "boxes": [
    {"name": "box", "center_m": [5, 0, 1], "size_m": np.array([1, 2, 2]), "reflectivity": np.int64(50)}
]}  # fmt: skip
STUDY = {
    "region": {"min_m": [-6, -6, 0], "max_m": [6, 6, 4], "cuboid_m": [1, 1, 1]},
    "sensors": [
        {
            "model": "vlp-16",
            "min": {"position_m": (0, 0, 2), "rpy_deg": [0, 0, 0]},
            "max": {"position_m": (1, 1, 3), "rpy_deg": [0, 9, 0]},
        }
    ],
    "solver": {"evaluations": 30},
}


def test_a_dict_is_what_its_file_is(tmp_path):
    """PyYAML reads the file's text here, as YAML 1.1, which these files are, too."""
    assert lidarcfg.load_rig(yaml.safe_load(RIG.read_text())) == lidarcfg.load_rig(RIG)
    path = tmp_path / "study.yaml"
    path.write_text(yaml.safe_dump(STUDY | {"sensors": [*map(plain, STUDY["sensors"])]}))
    assert lidarcfg.load_study(STUDY).file == lidarcfg.load_study(path).file
    found = lidarcfg.optimize(STUDY)
    assert found.rig == lidarcfg.optimize(path).rig
    again = lidarcfg.evaluate(STUDY, yaml.safe_load(RIG.read_text()))
    assert again.max_vsr_m == lidarcfg.evaluate(path, RIG).max_vsr_m
    assert lidarcfg.load_scene(SCENE).names == ("ground", "box")


def plain(group):
    return {k: {n: list(p) for n, p in v.items()} if isinstance(v, dict) else v for k, v in group.items()}


def test_a_study_s_vehicle_may_be_a_mesh():
    ball = o3d.geometry.TriangleMesh.create_sphere(1.0).translate((0, 0, 1))
    body = {"meshes": [{"name": "ball", "file": ball, "exclude": True}]}
    study = lidarcfg.load_study(STUDY | {"vehicle": body})
    assert 0 < (~study.region.included).sum() < 20
    assert study.vehicle.scene.triangles.shape == np.asarray(ball.triangles).shape


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: lidarcfg.load_study(3), "an int is no study; allowed: the path of its file, a dict"),
        (lambda: lidarcfg.evaluate(lidarcfg.load_rig(RIG), RIG), "a Rig is no study; allowed"),
        (lambda: lidarcfg.evaluate(STUDY, lidarcfg.load_study(STUDY)), "a Study is no rig; allowed"),
        (lambda: lidarcfg.optimize([1]), "a list is no study; allowed"),
        (
            lambda: lidarcfg.export(RIG, o3d.geometry.TriangleMesh(), "out.pcap", 1.0),
            "a TriangleMesh is no scene; allow",
        ),
        (lambda: lidarcfg.evaluate(RIG, RIG), "this is a rig; a study belongs here"),
        (lambda: lidarcfg.evaluate(STUDY, STUDY), "rig: this is a study; a rig belongs here"),
        (lambda: lidarcfg.load_study(STUDY | {"sensor": []}), r"study: sensor: unknown key; did you mean sensors\?"),
        (
            lambda: lidarcfg.load_study(STUDY | {"sensors": [STUDY["sensors"][0] | {"model": "vlp-17"}]}),
            r"study: sensors\[0\].model: .*vlp-17",
        ),
        (lambda: lidarcfg.load_scene({"name": "x"}), "the scene is empty"),
        (
            lambda: lidarcfg.load_scene(SCENE | {"boxes": [{"name": object()}]}),
            r"scene: boxes\[0\].name: an object is not a text",
        ),
    ],
)
def test_anything_else_is_our_error(call, what):
    with pytest.raises(LidarcfgError, match=what):
        call()


def test_an_export_returns_what_it_wrote(tmp_path):
    """Frames as the reader of captures counts them, points as numpy does; every file is there, and no other."""
    found = lidarcfg.export(RIG, SCENE, tmp_path / "a.pcap", 0.2)
    assert found.what == "frames"
    assert found.count == sum(1 for _ in read_datagrams(tmp_path / "a.pcap", print))
    assert found.files[0] == tmp_path / "a.pcap"
    assert sorted(found.files) == sorted(tmp_path.iterdir())
    folder = tmp_path / "points"
    folder.mkdir()
    found = lidarcfg.export(RIG, SCENE, folder / "a.npz", 0.2)
    assert (found.count, found.what) == (len(np.load(folder / "a.npz")["xyz"]), "points")
    assert sorted(found.files) == sorted(folder.iterdir())


def test_a_rig_without_a_sensor_and_with_one_elsewhere():
    rig = lidarcfg.load_rig(RIG)
    assert [mount.name for mount in rig.without("left").mounts] == ["right"]
    moved = rig.moved("left", position_m=(0.5, 0.6, 2), rpy_deg=[0, 0, 90])
    assert moved.mounts[1] == rig.mounts[1]
    assert moved.mounts[0].position_m == (0.5, 0.6, 2.0)
    np.testing.assert_allclose(rotation(moved.mounts[0].rpy_rad) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert replace(moved.mounts[0], position_m=rig.mounts[0].position_m, rpy_rad=rig.mounts[0].rpy_rad) == rig.mounts[0]
    assert rig.moved("left") == rig
    assert rig.moved("left", rpy_deg=(0, 0, 90)).mounts[0].position_m == rig.mounts[0].position_m


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda rig: rig.without("roof"), "rig 'roof': no sensor is called 'roof'; allowed: left, right"),
        (lambda rig: rig.without("left", "right"), "rig 'roof': without left, right no sensor is left"),
        (lambda rig: rig.moved("roof"), "no sensor is called 'roof'"),
        (lambda rig: rig.moved("left", position_m=(1, 2)), r"left: position_m is \(1, 2\); allowed: three numbers"),
        (lambda rig: rig.moved("left", rpy_deg="abc"), "left: rpy_deg is 'abc'; allowed: three numbers"),
        (lambda rig: rig.moved("left", position_m=(1, 2, float("nan"))), "allowed: three numbers up to"),
    ],
)
def test_changes_that_a_rig_does_not_allow(change, what):
    with pytest.raises(ConfigError, match=what):
        change(lidarcfg.load_rig(RIG))
