"""The shipped patterns against what the makers say of them, and a packed pattern unpacked by hand."""

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.sensors.scan_pattern import load_scan_pattern
from lidarcfg.sensors.sensor import load_sensor


@pytest.mark.parametrize(
    ("model", "lasers", "rate_hz", "azimuth_deg", "elevation_deg"),
    [("mid-360", 4, 200_000, (-180, 180), (-7, 52)), ("hap", 6, 452_000, (-60, 60), (-12.5, 12.5))],
)
def test_patterns_are_as_the_data_sheets_say(model, lasers, rate_hz, azimuth_deg, elevation_deg):
    pattern = load_sensor(model).pattern
    assert pattern.channels == lasers
    assert pattern.frame_ns == 100_000_000
    assert len(pattern.time_ns) == rate_hz * pattern.period_ns // 10**9
    assert (pattern.channel == np.arange(len(pattern.time_ns)) % lasers).all()
    azimuth = (np.degrees(pattern.azimuth_rad) + 180) % 360 - 180
    elevation = np.degrees(pattern.elevation_rad)
    for angles, said in ((azimuth, azimuth_deg), (elevation, elevation_deg)):
        assert np.abs(np.subtract((angles.min(), angles.max()), said)).max() < 0.8
    swing = np.abs(np.fft.rfft(elevation[::lasers] - elevation.mean()))
    swing[int(50 * pattern.period_ns / 1e9) :] = 0  # slower than 50 Hz
    assert swing.argmax() / (pattern.period_ns / 1e9) == pytest.approx(10, abs=0.5)  # the frame rate


def test_a_packed_pattern(tmp_path):
    path = tmp_path / "packed.npz"
    steps = {"azimuth_steps": np.array([[100, -200, 17_900], [0, 50, 50]], np.int16)}
    steps["elevation_steps"] = np.array([[1000, -1, 0], [-500, 2, 3]], np.int16)
    np.savez_compressed(path, rate_hz=np.array(2_000_000), **steps)
    pattern = load_scan_pattern(path, 100_000_000)
    assert pattern.time_ns.tolist() == [0, 500, 1000, 1500, 2000, 2500]
    assert pattern.channel.tolist() == [0, 1, 0, 1, 0, 1]
    np.testing.assert_allclose(np.degrees(pattern.azimuth_rad), [1, 0, 359, 0.5, 178, 1])
    np.testing.assert_allclose(np.degrees(pattern.elevation_rad), [10, -5, 9.99, -4.98, 9.99, -4.95])
    np.savez_compressed(path, rate_hz=np.array(0), **steps)
    with pytest.raises(ConfigError, match="rate_hz"):
        load_scan_pattern(path, 100_000_000)
    np.savez_compressed(path, rate_hz=np.array(10), **steps | {"elevation_steps": np.zeros((3, 2), np.int16)})
    with pytest.raises(ConfigError, match="elevation_steps"):
        load_scan_pattern(path, 100_000_000)
