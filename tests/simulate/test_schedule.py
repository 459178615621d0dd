"""When and where: the manual's numbers, and no drift over hours."""

import math
from fractions import Fraction

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose
from lidarcfg.packets.codec import codec
from lidarcfg.sensor import load_sensor
from lidarcfg.simulate.simulator import aimed
from lidarcfg.world.kernels import chained
from lidarcfg.world.motion import Arc, Motion, TimedPose, Trajectory, prepared
from tests.naive.capture import ELEVATION_DEG, VERTICAL_MM, firing_ns, head_deg
from tests.packets.velodyne.shaped import firings, packet_period_ns

VLP16 = load_sensor("vlp-16")


def rays(sensor, fired):
    """Those of all firings, in the sensor frame."""
    found = aimed(sensor, fired.flat, np.arange(fired.time_ns.size), np.eye(3)[None], np.zeros((1, 3)))
    return [values.reshape(*fired.time_ns.shape, 3) for values in found]


def test_packet_period():
    assert packet_period_ns(VLP16) == 1_327_104


@pytest.mark.parametrize("rpm", [300, 600, 1200])
def test_times_and_azimuths_are_the_twins(rpm):
    start, numbers = 1_700_000_000_000_000_123, range(5, 9)
    fired = firings(VLP16, rpm, start, numbers)
    assert fired.time_ns.shape == (4, 24, 16)
    for p, number in enumerate(numbers):
        for sequence in range(24):
            for laser in range(16):
                since = number * 1_327_104 + firing_ns(sequence, laser)
                assert fired.time_ns[p, sequence, laser] == start + since
                got = np.degrees(fired.azimuth_rad[p, sequence, laser])
                assert got == pytest.approx(head_deg(since, rpm), abs=1e-10)


@pytest.mark.parametrize("rpm", [600.0, 599.9, 1199.999, 617.123456789])
def test_no_drift_after_a_day(rpm):
    number = 65_104_166  # 24 hours
    fired = firings(VLP16, rpm, 0, range(number, number + 1))
    turns = Fraction(rpm) * (number * 1_327_104 + firing_ns(23, 15)) / (60 * 10**9)
    assert fired.azimuth_rad[0, 23, 15] == pytest.approx(2 * np.pi * float(turns % 1), abs=1e-12)


def test_chunks_are_the_whole():
    whole = firings(VLP16, 660, 17, range(40))
    parts = [firings(VLP16, 660, 17, range(n, n + 1)) for n in range(40)]
    assert (whole.azimuth_rad == np.concatenate([part.azimuth_rad for part in parts])).all()
    assert (whole.time_ns == np.concatenate([part.time_ns for part in parts])).all()


def test_rays():
    fired = firings(VLP16, 600, 0, range(100))
    origins, directions = rays(VLP16, fired)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1)
    np.testing.assert_allclose(np.degrees(np.arcsin(directions[7, 3, :, 2])), ELEVATION_DEG)
    np.testing.assert_allclose(origins[7, 3, :, 2] * 1000, VERTICAL_MM)
    turned = np.degrees(np.arctan2(-directions[..., 1], directions[..., 0])) % 360  # clockwise from above
    np.testing.assert_allclose(turned, np.degrees(fired.azimuth_rad), atol=1e-9)


@pytest.mark.parametrize("name", ["vlp-16", "vls-128", "hdl-64e-s3"])
def test_rays_are_the_twins(name):
    """Angle by angle, each with its own sine and cosine; offsets to the side are at right angles to the beam."""
    sensor = load_sensor(name)
    fired = firings(sensor, 1200, 5, range(3, 6))
    origins, directions = (values.reshape(-1, 3) for values in rays(sensor, fired))
    for i, head in enumerate(fired.azimuth_rad.ravel()):
        laser = i % sensor.count
        a, w = head + sensor.azimuth_offset_rad[laser], sensor.elevation_rad[laser]
        expected = math.cos(w) * math.cos(a), -math.cos(w) * math.sin(a), math.sin(w)
        assert directions[i] == pytest.approx(expected, abs=3e-15)
        left = sensor.lateral_offset_m[laser]
        expected = left * math.sin(a), left * math.cos(a), sensor.vertical_offset_m[laser]
        assert origins[i] == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(
    "motion",
    [
        Motion(velocity_m_s=(0.0, 0.0, 0.0)),
        Motion(velocity_m_s=(9.0, -2.0, 0.5)),
        Motion(arc=Arc(speed_m_s=12, yaw_rate_deg_s=40)),
        Motion(poses=(TimedPose(time_s=0, position_m=(0, 0, 0)), TimedPose(time_s=1, position_m=(5, 1, 0), rpy_deg=(3, 20, 70)))),
    ],
)  # fmt: skip
def test_rays_of_a_sensor_that_moves(motion):
    """As each pose has it, by matrices of 4 × 4, and the same whichever rays are asked for."""
    sensor, start_ns = load_sensor("hdl-64e-s3"), 1_700_000_000 * 10**9
    way = Trajectory(pose((3, -2, 1), (0.1, -0.2, 1)), prepared(motion), start_ns)
    T_vehicle_sensor = pose((0.3, -1, 2), (0.2, 0.1, -0.4))
    fired = firings(sensor, 600, start_ns, range(2))
    outer, inner = way.T_world_start, T_vehicle_sensor
    found = []
    for rows in (np.arange(fired.time_ns.size), np.arange(1, fired.time_ns.size, 7)):
        R, t = way.motion(fired.time_ns.ravel()[rows])
        R, t = chained(
            outer[None, :3, :3].copy(), outer[:3, 3].copy(), R, t, inner[None, :3, :3].copy(), inner[:3, 3].copy()
        )
        found.append(np.concatenate(aimed(sensor, fired.flat, rows, R, t), axis=1))
    assert (found[0][1::7] == found[1]).all()
    origins, directions = (values.reshape(-1, 3) for values in rays(sensor, fired))
    for i, time_ns in enumerate(fired.time_ns.ravel().tolist()):
        T = way.pose(time_ns) @ T_vehicle_sensor
        assert found[0][i, :3] == pytest.approx(T[:3, :3] @ origins[i] + T[:3, 3], abs=1e-13)
        assert found[0][i, 3:] == pytest.approx(T[:3, :3] @ directions[i], abs=1e-14)


def test_placement_only_sensors_are_refused():
    with pytest.raises(ConfigError, match="'fan-16' is for placement only: it has no codec"):
        codec(load_sensor("fan-16"))
