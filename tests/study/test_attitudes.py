"""Sensors that may be tilted any way: their axes as a formula gives them, and where bounds are taken as they are."""

import numpy as np
import pytest

from lidarcfg.geometry import up
from tests.studies import study_of

STUDY = """
region: {{min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 0.5, 0.25]}}
sensors:
  - {{elevation_deg: {beams}, count: 2, min: {{position_m: [5, 3, 1], rpy_rad: {lower}}}, max: {{position_m: [7, 5, 2.5], rpy_rad: {upper}}}}}
solver: {{method: {method}, evaluations: 10, seed: 1}}
"""
ANY_WAY = {"method": "auto", "beams": [-8, 0, 8], "lower": [0, 0, 0], "upper": [3.1415, 3.1415, 0]}


def study(tmp_path, **changes):
    return study_of(tmp_path, STUDY.format(**ANY_WAY | changes))


def test_upright_is_in_the_middle_and_the_axis_is_that_of_angles_around_it(tmp_path):
    """Rotations by roll, then pitch, of −90 to 90°, up to the axis's sign: the beams are symmetric."""
    found = study(tmp_path)
    x = np.random.default_rng(1).random((500, 10))
    poses = found.space.poses(x)
    assert (poses >= found.space.lower).all()
    assert (poses <= found.space.upper).all()
    roll, pitch = np.moveaxis((x.reshape(500, 2, 5)[..., 3:] - 0.5) * np.pi, -1, 0)
    axis = np.stack([np.sin(pitch) * np.cos(roll), -np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=-1)
    along = (up(poses[..., 3:]) * axis).sum(axis=-1)
    assert np.abs(along) == pytest.approx(np.ones((500, 2)), abs=1e-8)  # 3.1415 is not quite half a turn
    place = found.space.lower[:, :3] + x.reshape(500, 2, 5)[..., :3] * (found.space.upper - found.space.lower)[:, :3]
    assert poses[..., :3] == pytest.approx(place, abs=1e-12)


def test_a_small_step_is_a_small_turn_everywhere_but_at_the_horizon(tmp_path):
    found = study(tmp_path)
    rng = np.random.default_rng(2)
    x = rng.uniform(0.02, 0.98, (2000, 10))
    step = rng.uniform(-0.01, 0.01, x.shape)
    before, after = (up(found.space.poses(at)[..., 3:]) for at in (x, x + step))
    assert np.abs((before * after).sum(axis=-1)).min() > np.cos(0.02 * np.pi)


def test_every_pose_between_the_bounds_is_one_of_some_point(tmp_path):
    found = study(tmp_path)
    edges = np.linspace(0, 1, 41)[:-1] + 0.0125
    roll, pitch = (one.ravel() for one in np.meshgrid(edges, edges))
    x = np.full((len(roll), 10), 0.5)
    x[:, 3] = roll
    x[:, 4] = pitch
    angles = found.space.poses(x)[:, 0, 3:5] / 3.1415
    assert np.unique(np.rint((angles - 0.0125) * 40), axis=0).shape == (1600, 2)


@pytest.mark.parametrize(
    "changes",
    [
        {"method": "abc"},
        {"beams": [-8, 0, 9]},
        {"lower": [0.1, 0, 0]},
        {"upper": [3.1415, 1.5, 0]},
        {"upper": [3.1415, 0, 0]},
        {"lower": [-1.5707, -1.5707, 0], "upper": [1.5708, 1.5708, 0]},
    ],
)
def test_otherwise_coordinates_go_from_bound_to_bound(tmp_path, changes):
    """The paper's solver has the paper's coordinates; other beams or bounds leave no symmetry to make use of."""
    found = study(tmp_path, **changes)
    x = np.random.default_rng(3).random((20, found.space.dimensions))
    poses = found.space.poses(x)
    low, high = found.space.lower[found.space.free], found.space.upper[found.space.free]
    assert poses[:, found.space.free] == pytest.approx(low + x * (high - low), abs=1e-12)
    assert found.space.poses(np.ones_like(x[:1]))[0].tolist() == found.space.upper.tolist()
