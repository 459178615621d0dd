"""Elementary functions: beside the system's, which differ in the last place, and at the edges of IEEE 754."""

import math

import numpy as np
import pytest

from lidarcfg.core import maths
from lidarcfg.maths import hypot, power

ULPS = {"sin": 3, "cos": 3, "tan": 4, "asin": 3, "acos": 3, "exp": 2, "log": 2}
INSIDE = {"asin": (-1, 1), "acos": (-1, 1), "tan": (-1.5, 1.5), "exp": (-700, 700), "log": (1e-300, 10)}
EDGES = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 1e-310, 1e308]


def mapped(name, *values):
    columns = [np.array(value, np.float64) for value in values]
    out = np.empty(len(columns[0]))
    getattr(maths, name)(*columns, out)
    return out


@pytest.mark.parametrize("name", ULPS)
def test_functions_are_the_systems_but_for_the_last_place(name):
    values = np.random.default_rng(1).uniform(*INSIDE.get(name, (-7, 7)), 20_000)
    expected = np.array([getattr(math, name)(value) for value in values])
    assert (abs(mapped(name, values) - expected) <= ULPS[name] * np.spacing(abs(expected))).all()


@pytest.mark.parametrize("name", ["cos", "sin"])
def test_cosines_and_sines_within_two_units_of_the_last_digit(name):
    """Those of the C library, also at the very quarters."""
    angles = np.concatenate([np.random.default_rng(4).uniform(-20, 20, 20_000), np.arange(-8, 9) * np.pi / 4])
    expected = np.array([getattr(math, name)(angle) for angle in angles])
    assert abs(mapped(name, angles) - expected).max() <= 2.5e-16


def test_atan2_is_the_systems_but_for_the_last_place():
    points = np.random.default_rng(1).normal(size=(20_000, 2))
    expected = np.array([math.atan2(y, x) for y, x in points])
    found = mapped("atan2", points[:, 0], points[:, 1])
    assert (abs(found - expected) <= 3 * np.spacing(abs(expected))).all()


def test_powers_and_lengths_are_the_systems_but_for_the_last_places():
    """An error of the logarithm counts in a power as often as the power's own logarithm says."""
    rng = np.random.default_rng(1)
    for base in (0.05, 2.0, 300.0):
        exponent = rng.uniform(-3, 3, 1000)
        expected = np.array([base**one for one in exponent.tolist()])
        most = 4 + 2 * abs(exponent * math.log(base))
        assert (abs(power(base, exponent) - expected) <= most * np.spacing(expected)).all()
    x, y = rng.normal(size=(2, 20_000))
    expected = np.array([math.hypot(*both) for both in zip(x, y, strict=True)])
    assert (abs(hypot(x, y) - expected) <= np.spacing(expected)).all()
    assert hypot(3.0, -4.0) == 5.0
    assert power(7.0, 0.0) == 1.0


@pytest.mark.parametrize("y", EDGES)
@pytest.mark.parametrize("x", EDGES)
def test_atan2_at_the_edges(y, x):
    (found,) = mapped("atan2", [y], [x])
    assert found == pytest.approx(math.atan2(y, x), rel=1e-15, nan_ok=True)
    assert math.isnan(found) or math.copysign(1, found) == math.copysign(1, math.atan2(y, x))


def test_edges():
    assert mapped("exp", [math.inf, -math.inf, 0.0, 710.0, -746.0]).tolist() == [math.inf, 0.0, 1.0, math.inf, 0.0]
    assert mapped("log", [0.0, 1.0, math.inf]).tolist() == [-math.inf, 0.0, math.inf]
    assert mapped("asin", [1.0, -1.0]).tolist() == [math.pi / 2, -math.pi / 2]
    assert mapped("acos", [1.0, -1.0]).tolist() == [0.0, math.pi]
    large = np.array([1e5, -3e7, 1e300])
    assert np.allclose(mapped("sin", large) ** 2 + mapped("cos", large) ** 2, 1.0, rtol=1e-14)
    assert mapped("sin", [1e6, -1e9]) == pytest.approx([-0.3499935021712929521, -0.5458434494486996], rel=1e-13)
    for name in ULPS:
        assert np.isnan(mapped(name, [math.nan])).all()
    assert np.isnan(mapped("log", [-1.0])).all()
    assert np.isnan(mapped("acos", [1.1])).all()


def test_bad_arguments():
    with pytest.raises(ValueError, match="out: one for each x"):
        maths.sin(np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match="x: one for each y"):
        maths.atan2(np.zeros(2), np.zeros(3), np.zeros(2))
    with pytest.raises(TypeError, match=r"x: float32 of shape \(2,\); allowed: ndarray\[dtype=float64"):
        maths.cos(np.zeros(2, np.float32), np.zeros(2))
    with pytest.raises(TypeError, match=r"x: .*order='C'"):
        maths.cos(np.zeros(4)[::2], np.zeros(2))
    with pytest.raises(TypeError, match="out: "):
        maths.cos(np.zeros(2), np.broadcast_to(0.0, 2))
