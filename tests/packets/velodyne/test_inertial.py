"""What an HDL-32E's gyroscopes and accelerometers say: a recording at rest, another driver's formulas, motion by hand."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.packets.families import codec
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import SECOND_NS
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.motion import Motion, Trajectory, build_path
from tests.capture_fixtures import AT_NS, datagrams_of, mount, recording

KINDS = [0, 1, 2, 3] * 3  # gyroscope, temperature, accelerometer x, y


def read(payload):
    """Rates in degrees a second and acceleration in g, ahead, to the left and up: as jmaye/velodyne_ros has them.

    Its x points to the right and its y ahead, as those of its points do.
    """
    words = struct.unpack_from("<12H", payload, 14)
    assert [word >> 12 for word in words] == KINDS
    signed = [(word & 0xFFF) - (4096 if word & 0x800 else 0) for word in words]
    gyro1, _, x1, y1, gyro2, _, x2, y2, gyro3, _, x3, y3 = signed
    right = -(y1 - x3) / 2
    ahead = -(y2 + y3) / 2
    up = (x1 + x2) / 2
    rate = np.array([gyro1, gyro2, gyro3]) * 0.09766
    return rate, np.array([ahead, -right, up]) * 0.001221


def sent(trajectory, rpy_deg=(0.0, 0.0, 0.0), model="hdl-32e"):
    sensor = load_sensor(model)
    one = replace(mount(position_m=(1.0, 0.5, 2.0), rpy_deg=rpy_deg), sensor=sensor, model=model)
    packets = codec(sensor).housekeeping(one, trajectory, GeoOrigin(), AT_NS, range(SECOND_NS // 2))
    return [row.tobytes() for some in packets for row in some.data]


def moving(**motion):
    return Trajectory(np.eye(4), build_path(Motion.model_validate(motion)), AT_NS)


def test_a_recording_at_rest():
    """The car stands: 1 g within 5 %, in the field that is up; leaning as the ground that its points show."""
    payloads = [one.payload for one in datagrams_of(recording("veloview_hdl32e_monterey.pcap")) if one.port == 8308]
    rates, g = map(np.array, zip(*map(read, payloads), strict=True))
    assert len(payloads) == 166
    assert np.linalg.norm(g.mean(axis=0)) == pytest.approx(1, abs=0.05)
    assert g.mean(axis=0).tolist() == pytest.approx([0.085, 0.015, 0.957], abs=0.001)
    assert rates.mean(axis=0).tolist() == pytest.approx([-5.4, -3.9, -29.4], abs=0.1)  # errors of the unit
    for motion in ({"velocity_m_s": (0, 0, 0)}, {"velocity_m_s": (9, 2, 0)}):
        ours = sent(moving(**motion))
        assert len(ours) == 101  # 201 a second
        for payload in ours:
            rate, at_rest = read(payload)
            assert rate.tolist() == [0, 0, 0]
            assert at_rest.tolist() == pytest.approx([0, 0, 1], abs=0.001221 / 2)
            assert payload[:14] == bytes(14)
            assert payload[38:198] == payloads[0][38:198] == bytes(160)


def test_a_bend_to_the_left():
    """v ω towards its centre and ω about the vertical, at where the sensor is: 0.5 m nearer to the centre."""
    speed = 10.0
    turn = math.radians(15)
    radius = speed / turn
    rate, g = map(np.array, zip(*map(read, sent(moving(arc={"speed_m_s": 10, "yaw_rate_deg_s": 15}))), strict=True))
    inward = turn**2 * (radius - 0.5) / 9.80665
    behind = -(turn**2) * 1.0 / 9.80665  # and 1 m ahead of the origin: towards the centre is also backwards
    assert abs(rate - [0, 0, 15]).max() <= 0.09766 / 2
    assert abs(g - [behind, inward, 1]).max() <= 0.001221 / 2 + 1e-4


@pytest.mark.parametrize(
    ("rpy_deg", "g"), [((0, -30, 0), (0.5, 0, 0.75**0.5)), ((30, 0, 0), (0, 0.5, 0.75**0.5)), ((0, 0, 90), (0, 0, 1))]
)
def test_a_sensor_that_leans_feels_gravity_ahead_or_beside(rpy_deg, g):
    """With its nose up what holds it up points ahead of its own up; rolled to its right, to its left."""
    for payload in sent(moving(velocity_m_s=(0, 0, 0)), rpy_deg):
        assert read(payload)[1].tolist() == pytest.approx(g, abs=0.001221 / 2 + 1e-9)


def test_what_12_bits_cannot_say_is_held():
    """A rate of 300 degrees a second is the greatest that there is, 2047 units."""
    rate, _ = read(sent(moving(arc={"speed_m_s": 1, "yaw_rate_deg_s": 300}))[5])
    assert rate[2] == pytest.approx(2047 * 0.09766)


def test_others_say_nothing():
    for payload in sent(moving(arc={"speed_m_s": 10, "yaw_rate_deg_s": 15}), model="vlp-16"):
        assert payload[14:38] == bytes(24)
    for name in ("mrpt_vlp16_gps.pcap", "jerry_vlp16.pcap"):
        recorded = [one.payload for one in datagrams_of(recording(name)) if one.port == 8308]
        assert recorded
        assert all(payload[14:38] == bytes(24) for payload in recorded)
