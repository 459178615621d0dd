"""Rays against a plane, a sphere and a box, worked on paper."""

import numpy as np
import pytest

from lidarcfg.capture.raycast import Raycaster
from lidarcfg.geometry import directions
from tests.capture_fixtures import scene

TEXT = """
ground: {z_m: -1, reflectivity: 12}
boxes: [{name: box, center_m: [10, 0, 0], size_m: [2, 2, 1.5], reflectivity: 30}]
spheres: [{name: ball, center_m: [0, 20, 0], radius_m: 3, reflectivity: 40}]
"""


@pytest.fixture
def caster(tmp_path):
    return Raycaster(scene(tmp_path, TEXT), np.zeros(3))


def test_by_hand(caster):
    down = np.array([3, 4, -1]) / np.sqrt(26)
    rays = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], down])
    range_m, reflectivity, objects, _ = caster.cast(np.zeros((5, 3)), rays)
    np.testing.assert_allclose(range_m, [9, 17, np.inf, np.inf, np.sqrt(26)], atol=1e-3)
    assert reflectivity.tolist() == [30, 40, 0, 0, 12]
    assert objects.tolist() == [1, 2, -1, -1, 0]


def test_sphere_off_centre(caster):
    """A ray that passes the centre at distance d enters sqrt(r² - d²) before the nearest point."""
    d = np.linspace(-2.5, 2.5, 21)
    origins = np.stack([d, 0 * d, 0 * d], axis=1)
    range_m, *_ = caster.cast(origins, np.tile([0.0, 1, 0], (21, 1)))
    slant = 3 / np.sqrt(9 - d**2)  # the facets' millimetre, seen aslant
    assert (abs(range_m - (20 - np.sqrt(9 - d**2))) <= 0.001 * slant).all()


def test_ground_is_good_to_100_m(tmp_path):
    caster = Raycaster(scene(tmp_path, "ground: {reflectivity: 12}"), np.array([0.0, 0, 2]))
    rng = np.random.default_rng(1)
    elevation, azimuth = -np.arcsin(2 / rng.uniform(2.01, 100, 50_000)), rng.uniform(0, 2 * np.pi, 50_000)
    rays = directions(azimuth, elevation)
    range_m, *_ = caster.cast(np.tile([0.0, 0, 2], (50_000, 1)), rays)
    error = abs(range_m + 2 / rays[:, 2])
    assert np.median(error) < 5e-6
    assert error.max() < 1e-4


def test_far_from_the_world_origin(tmp_path):
    """The same scene a million metres away, and back: the local frame keeps the millimetres."""
    far = np.array([1e6, -2e6, 50.0])
    text = "boxes: [{name: b, center_m: [1000007.5, -2000000, 50], size_m: [1, 9, 9], reflectivity: 1}]"
    caster = Raycaster(scene(tmp_path, text + "\nground: {z_m: 40, reflectivity: 1}"), far)
    range_m, *_ = caster.cast(np.array([far, far]), np.array([[1.0, 0, 0], [0, 0, -1]]))
    np.testing.assert_allclose(range_m, [7, 10], atol=1e-5)
