"""KITTI's data of the scenes that come along: its labels, read by the devkit's formulas, hold what Open3D finds in them."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

import lidarcfg
from lidarcfg.simulate.scans import simulated_scans
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.world.boxes import boxed_objects
from tests.capture_fixtures import scene

SCENES = Path(__file__).parents[2] / "data/scenes"
RIG = {"name": "one", "sensors": [{"name": "top", "model": "vlp-16", "position_m": [0, 0, 2.0]}]}
FEET_M = 0.005  # the ground is not counted


@pytest.mark.parametrize("name", ["street", pytest.param("suburb", marks=pytest.mark.slow), "depot"])
def test_points_in_kittis_boxes(name, tmp_path):
    """As many as the truth says for what stands; what moves is smeared over the tenth of a second."""
    drive = SceneDrive.load(RIG, SCENES / f"{name}.yaml", 0.1)
    (scan,) = simulated_scans(drive)
    lidarcfg.export(RIG, SCENES / f"{name}.yaml", tmp_path / "k", 0.1, to="kitti-object", on_warning=lambda _: None)
    training = tmp_path / "k/training"
    xyz = np.fromfile(training / "velodyne/000000.bin", "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
    calib = dict(line.split(": ") for line in (training / "calib/000000.txt").read_text().splitlines())
    Tr = np.array(calib["Tr_velo_to_cam"].split(), float).reshape(3, 4)
    in_camera = o3d.utility.Vector3dVector(xyz @ Tr[:, :3].T + Tr[:, 3])
    hit = [one for one in boxed_objects(drive.scene) if (scan.object == one.index).any()]
    lines = (training / "label_2/000000.txt").read_text().splitlines()
    assert len(lines) == len(hit) > 8
    kinds = set()
    for one, line in zip(hit, lines, strict=True):
        kind, *words = line.split()
        height, width, length, x, y, z, turned = map(float, words[7:])
        c, s = np.cos(turned), np.sin(turned)
        rotated = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        middle = np.array([x, y - height / 2 - FEET_M / 2, z])
        size = np.array([length + 0.002, height - FEET_M + 0.002, width + 0.002])
        box = o3d.geometry.OrientedBoundingBox(middle, rotated, size)
        found = len(box.get_point_indices_within_bounding_box(in_camera))
        said = int((scan.object == one.index).sum())
        assert found > 0.4 * said if one.path else said * 0.97 - 2 <= found <= said + 3, (one.name, found, said)
        kinds.add(kind)
    assert {"Car", "Pedestrian"} | ({"Cyclist"} if name != "suburb" else set()) <= kinds  # 16 beams miss it there


def test_a_scene_without_categories_is_told(tmp_path):
    """Data sets of it would be empty: one line names the key, for a data set and none for a cloud."""
    bare = scene(tmp_path, "boxes: [{name: car, center_m: [9, 3, 1], size_m: [4, 2, 2], reflectivity: 30}]")
    told = []
    for form in ("kitti-object", "nuscenes", None):
        output = tmp_path / (form or "a.npz")
        lidarcfg.export(RIG, bare, output, 0.1, to=form, on_warning=told.append)
    said = [line for line in told if "category" in line]
    assert len(said) == 2
    assert all("no object has a category" in line and "`category: car`" in line for line in said)
