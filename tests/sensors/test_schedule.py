"""When and where: the manual's numbers, and no drift over hours."""

from fractions import Fraction

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.packets.families import codec
from lidarcfg.sensors.sensor import load_sensor
from tests.naive.capture import firing_ns, head_deg
from tests.packets.velodyne.shaped import firings, packet_period_ns

VLP16 = load_sensor("vlp-16")


def test_packet_period():
    assert packet_period_ns(VLP16) == 1_327_104


@pytest.mark.parametrize("rpm", [300, 600, 1200])
def test_times_and_azimuths_are_the_twins(rpm):
    start = 1_700_000_000_000_000_123
    numbers = range(5, 9)
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


def test_placement_only_sensors_are_refused():
    with pytest.raises(ConfigError, match="'fan-16' has no codec, and so no packets"):
        codec(load_sensor("fan-16"))
