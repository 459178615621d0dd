"""Frames and rotations against matrices multiplied by hand and SciPy's."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidarcfg import geometry
from tests.naive import placement as naive

angles = st.tuples(*[st.floats(-10, 10)] * 3)
places = st.tuples(*[st.floats(-1e3, 1e3)] * 3)


@given(angles)
def test_rotation_is_rz_ry_rx(rpy):
    assert geometry.rotation(rpy) == pytest.approx(np.array(naive.matrix(rpy)), abs=1e-15)
    assert geometry.rotation(rpy) == pytest.approx(Rotation.from_euler("xyz", rpy).as_matrix(), abs=1e-14)


@given(angles)
def test_rotation_is_proper_and_orthonormal(rpy):
    R = geometry.rotation(rpy)
    assert R @ R.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)


@given(st.lists(angles, min_size=1, max_size=5))
def test_quaternions_are_those_of_scipy(many):
    """Of either sign, which is rounding's where two of the four are equally large."""
    R = np.array([geometry.rotation(rpy) for rpy in many])
    found = geometry.quaternions(R)
    theirs = Rotation.from_matrix(R).as_quat()
    assert found * np.sign((found * theirs).sum(axis=1, keepdims=True)) == pytest.approx(theirs, abs=1e-14)
    assert geometry.quaternions(R[0]) == pytest.approx(found[0], abs=0)


@pytest.mark.parametrize("half", [(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0.5, -0.5, 0.5, 0.5)])
def test_quaternions_of_half_and_third_turns(half):
    """By the quaternion itself, of either sign."""
    found = geometry.quaternions(Rotation.from_quat(half).as_matrix())
    assert abs(found @ np.array(half)) == pytest.approx(1.0, abs=1e-15)
    assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)


@given(places, angles)
def test_a_pose_times_its_inverse_is_nothing(position, rpy):
    T = geometry.pose(position, rpy)
    assert T @ geometry.inverse(T) == pytest.approx(np.eye(4), abs=1e-12)
    assert geometry.transform(geometry.inverse(T), geometry.transform(T, [position])) == pytest.approx(
        np.array([position]), abs=1e-9
    )


def test_quarter_turns():
    yaw, pitch, roll = (geometry.rotation(a) for a in ((0, 0, math.pi / 2), (0, math.pi / 2, 0), (math.pi / 2, 0, 0)))
    assert yaw @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-15)  # forward turns to the left
    assert pitch @ [1, 0, 0] == pytest.approx([0, 0, -1], abs=1e-15)  # the nose goes down
    assert roll @ [0, 1, 0] == pytest.approx([0, 0, 1], abs=1e-15)  # the left side goes up


def test_the_makers_azimuth_turns_clockwise():
    ahead, right, up = geometry.directions([0, math.pi / 2, 0], [0, 0, math.pi / 2])
    assert ahead == pytest.approx([1, 0, 0], abs=1e-15)
    assert right == pytest.approx([0, -1, 0], abs=1e-15)
    assert up == pytest.approx([0, 0, 1], abs=1e-15)
