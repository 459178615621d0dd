"""Frames and rotations against matrices multiplied by hand and SciPy's."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lidarcfg import geometry
from tests.naive import vsr as naive

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


@given(st.lists(angles, min_size=1, max_size=5))
def test_rotation_vectors_are_those_of_scipy(many):
    """By the rotations that they say; half a turn may be about either end of its axis."""
    R = np.array([geometry.rotation(rpy) for rpy in many])
    found = geometry.rotation_vectors(R)
    assert Rotation.from_rotvec(found).as_matrix() == pytest.approx(R, abs=1e-14)
    theirs = Rotation.from_matrix(R).as_rotvec()
    less = np.linalg.norm(theirs, axis=1) < 3.1
    assert found[less] == pytest.approx(theirs[less], abs=1e-13)


def test_rotation_vectors_of_nothing_and_of_little():
    assert geometry.rotation_vectors(np.eye(3)[None]).tolist() == [[0.0, 0.0, 0.0]]
    turned = Rotation.from_rotvec([3e-9, 0, -4e-9]).as_matrix()[None]
    assert geometry.rotation_vectors(turned)[0] == pytest.approx([3e-9, 0, -4e-9], abs=1e-16)


def test_products_are_those_of_plain_loops():
    """Each term rounded, and each sum, in order: not as a processor may fuse them."""
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 3, 2))
    found = geometry.product(first, second)
    vectors = geometry.rotated(first[0, :3], second.swapaxes(1, 2).reshape(-1, 3))
    for n, i, k in np.ndindex(4, 5, 2):
        terms = [float(first[n, i, j]) * float(second[n, j, k]) for j in range(3)]
        assert found[n, i, k] == terms[0] + terms[1] + terms[2]
        if i < 3:
            terms = [float(first[0, i, j]) * float(second[n, j, k]) for j in range(3)]
            assert vectors[2 * n + k, i] == terms[0] + terms[1] + terms[2]
    many = rng.normal(size=(10_000, 3))
    assert geometry.rotated(first[0, :3], many) == pytest.approx(many @ first[0, :3].T, abs=1e-14)


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
