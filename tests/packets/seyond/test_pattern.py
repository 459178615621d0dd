"""The shipped patterns against what docs/seyond.md says of them, and where their beams start."""

import numpy as np
import pytest

from lidarcfg.packets.families import codec
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS
from tests.naive import seyond as naive
from tests.packets.seyond.fixtures import MODELS, mount, starts

UNIT_DEG = 180 / 32768


@pytest.mark.parametrize(
    ("model", "rate_hz", "azimuth_deg", "elevation_deg", "lines", "apart"),
    [("falcon-k1", 1_401_120, 120, 25, 144, 28), ("robin-w", 1_228_800, 120, 70, 192, 66)],
)
def test_patterns_are_as_the_page_says(model, rate_hz, azimuth_deg, elevation_deg, lines, apart):
    pattern = load_sensor(model).pattern
    assert (pattern.frames, len(pattern.time_ns) * 10) == (1, rate_hz)
    units = [np.degrees(angle) / UNIT_DEG for angle in (pattern.azimuth_rad, pattern.elevation_rad)]
    assert max(np.abs(one - np.rint(one)).max() for one in units) < 1e-3
    azimuth, elevation = (np.rint(one) * UNIT_DEG for one in units)
    assert np.ptp(azimuth) == pytest.approx(azimuth_deg, abs=0.6)
    assert np.ptp(elevation) == pytest.approx(elevation_deg, abs=0.8)
    assert azimuth.max() == pytest.approx(-azimuth.min(), abs=0.04)
    heights = np.unique(np.rint(units[1]))
    if model == "robin-w":
        assert len(heights) == lines
        assert set(np.diff(heights)) == {apart}
    else:  # at the top and the bottom some lines have no neighbour
        assert len(heights) == lines
        assert set(np.diff(heights)[30:-30]) == {apart}
    assert np.diff(pattern.time_ns).max() < (10_000_000 if model == "robin-w" else 600_000)  # from facet to facet


@pytest.mark.parametrize("model", MODELS)
def test_beams_start_where_the_sdk_says(model):
    """In the simulation as in placement, which turns starts by where beams point."""
    of = mount(model)
    maker = codec(of.sensor)
    packets = maker.unit.packets_of(of)
    (batch,) = maker.schedule(of, START_NS, [range(packets)])
    fired = batch.firings
    beams = maker.pattern(of).beams(of.sensor, 4)
    assert (beams.lag_rad == fired.encoder_rad).all()
    ahead, left, up = beams.start_m.T
    c, s = np.cos(fired.encoder_rad), np.sin(fired.encoder_rad)
    turned = np.stack([ahead * c + left * s, left * c - ahead * s, up], axis=1)
    np.testing.assert_allclose(turned, fired.start_m, atol=1e-15)
    tables = starts()
    for i in range(0, len(fired.time_ns), 997):
        h, v = (round(np.degrees(angle[i]) / UNIT_DEG) for angle in (fired.encoder_rad, fired.elevation_rad))
        if model == "robin-w":
            up, right, forward = naive.robin_start(tables["robin_w"], h, (6303 - v) // 66)
        else:
            up, right, forward = naive.falcon_start(tables["falcon"], h, v, int(fired.laser[i]))
        np.testing.assert_allclose(fired.start_m[i], (forward, -right, up), atol=1e-12)
