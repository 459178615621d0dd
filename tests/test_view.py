"""Stills: a pinhole worked by hand, points and bodies where they belong, and what cannot be drawn."""

import matplotlib.image
import numpy as np
import pytest

from lidarcfg.cloud import PointCloud
from lidarcfg.errors import CloudError
from lidarcfg.view.colours import BACKGROUND
from lidarcfg.view.stage import Stage
from lidarcfg.view.still import Camera, save_still


def cloud(xyz, names=("a", "b")):
    xyz = np.asarray(xyz, np.float64).reshape(-1, 3)
    zeros = np.zeros(len(xyz), np.uint8)
    sensor = (np.arange(len(xyz)) % len(names)).astype(np.uint16)
    return PointCloud(xyz, zeros + 50, zeros, np.zeros(len(xyz), np.int64), sensor, names, zeros)


def stage(points=(), **parts):
    empty = {"objects": None, "rigs": (), "study": None, "scenes": (), "T_world_vehicle": np.eye(4)}
    return Stage(cloud(points), **(empty | parts))


def drawn(path):
    return np.round(matplotlib.image.imread(path)[..., :3] * 255)


def test_a_pinhole_by_hand():
    camera = Camera(np.zeros(3), np.array([10.0, 0, 0]), 90.0)
    column, row, depth = camera.project(np.array([[5, 0, 0], [5, -5, 0], [5, 0, 2.5], [-1, 0, 0]]), 200, 100)
    assert depth == pytest.approx([5, 5, 5, -1])
    assert column[:3] == pytest.approx([100, 200, 100])  # 45 degrees to the right is the right edge
    assert row[:3] == pytest.approx([50, 50, 0])  # up is up


def test_both_sensors_colours_are_in_the_picture(tmp_path):
    rng = np.random.default_rng(1)
    save_still(stage(rng.uniform((-20, -10, 0), (20, 10, 3), (20_000, 3))), tmp_path / "p.png")
    image = drawn(tmp_path / "p.png")
    assert image.shape == (1080, 1920, 3)
    blue, orange = ((image[..., 2] > image[..., 0] + 60).sum(), (image[..., 0] > image[..., 2] + 60).sum())
    assert blue > 10_000
    assert orange > 10_000
    assert (image == BACKGROUND).all(axis=-1).sum() > 100_000


def test_an_empty_stage_is_refused(tmp_path):
    with pytest.raises(CloudError, match="the cloud is empty"):
        save_still(stage(), tmp_path / "p.png")
    assert list(tmp_path.iterdir()) == []
