"""Beams around an object, one by one, beside plain loops over all rays and triangles."""

import math

import numpy as np
import pytest

from lidarcfg.packets.families import pattern
from lidarcfg.returns.beams import Outcome, passing_beams
from lidarcfg.returns.counts import returns
from lidarcfg.returns.scanners import Poses, compiled, scanner
from lidarcfg.returns.target import Target
from tests.naive import returns as naive
from tests.returns_cases import at_place, box
from tests.simulate.test_returns import BODY, MOUNTS, obstacles

OBJECT = box(0.5, 0.5, 1.75)
PLACES = np.array([[6.0, 1.0, 0.0, 0.4], [-4.0, -2.0, 0.0, 1.0], [0.0, 3.0, 0.0, 0.0], [3.2, 0.2, 0.0, 0.3]])
AROUND = obstacles(BODY)


@pytest.mark.slow
@pytest.mark.parametrize("mount", MOUNTS, ids=lambda one: one.model)
def test_they_are_as_many_as_are_counted(mount):
    target = Target(OBJECT)
    T = mount.T_vehicle_sensor
    poses = Poses(np.ascontiguousarray(T[None, :3, :3]), np.ascontiguousarray(T[None, :3, 3]))
    counted = returns(PLACES, target, compiled([scanner(mount)]), poses, AROUND)
    for place, by_phase in zip(PLACES, counted.counts[:, 0], strict=True):
        phases = range(0, counted.phases[0], 3)
        found = [passing_beams(place, target, mount, phase, AROUND).returns for phase in phases]
        assert found == by_phase[phases].tolist()


@pytest.mark.slow
def test_plain_loops_count_as_many():
    mount = MOUNTS[0]
    target = Target(OBJECT)
    corners = BODY[0][BODY[1]]
    moved = at_place(OBJECT, PLACES[0])
    want = naive.returns(mount, pattern(mount), 0.0, scanner(mount).range_m, moved[0][moved[1]], corners)
    assert passing_beams(PLACES[0], target, mount, 0, AROUND).returns == want > 0


def test_what_hits_is_inside_the_silhouette():
    """Of a convex object: in one of its triangles as they are projected; and nothing that passes it is, by far."""
    target = Target(OBJECT)
    for mount in MOUNTS[:3]:
        found = passing_beams(PLACES[0], target, mount, 0, AROUND)
        inside = np.zeros(len(found.at_rad), np.bool_)
        for triangle in found.triangles_rad:
            a, b, c = triangle
            turns = [
                np.cross(np.append(q - p, 0), np.c_[found.at_rad - p, np.zeros(len(found.at_rad))])[:, 2]
                for p, q in ((a, b), (b, c), (c, a))
            ]
            inside |= (np.array(turns) >= -1e-5).all(axis=0) | (np.array(turns) <= 1e-5).all(axis=0)
        assert found.returns > 5
        assert inside[found.outcome != Outcome.PASSES].all()


def test_directions_are_the_vehicles():
    """Whatever the sensor's tilt. Behind the sensor azimuths go on across half a turn."""
    for mount in (MOUNTS[0], MOUNTS[3], MOUNTS[9]):
        for place in PLACES:
            found = passing_beams(place, Target(OBJECT), mount, 0, AROUND)
            away = place[:3] + np.array([0, 0, 1.75 / 2]) - mount.position_m
            seen = found.triangles_rad.reshape(-1, 2)
            middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
            azimuth = math.atan2(away[1], away[0])
            assert math.remainder(middle[0] - azimuth, 2 * math.pi) == pytest.approx(0, abs=0.1)
            assert np.ptp(seen[:, 0]) < math.radians(60)


def test_nothing_returns_from_behind_the_body():
    target = Target(box(0.3, 0.3, 0.3))
    low = MOUNTS[5]  # in the front bumper, looking ahead
    found = passing_beams(np.array([-4.0, 0.0, 0.0, 0.0]), target, low, 0, AROUND)
    assert found.returns == 0
