"""The picture of a beam table: what is drawn is what the file and the manuals say."""

import matplotlib.image
import numpy as np
import pytest
import yaml

from lidarcfg.report.sensors import draw_sensor, print_sensor
from lidarcfg.sensors.sensor import catalogue, load_sensor
from tests.command_line import lidarcfg

FIRES_US = {  # by laser, as the manuals' formulas and tables have it; counted from the first one or from the stamp
    "vlp-16": 2.304 * np.arange(16),
    "pandar-xt32": 1.512 * np.arange(32),
    "helios-32": 1.73 * np.arange(32),
    "os1-64": np.zeros(64),
}


def drawn(name):
    """What each panel shows: (across, elevations), or None where it says that there is nothing to show."""
    figure = draw_sensor(load_sensor(name))
    return [axes.lines[0].get_data() if axes.lines else None for axes in figure.axes]


TURNING = [name for name, path in catalogue().items() if "beams" in yaml.safe_load(path.read_text())]


MIRRORS = [name for name, path in catalogue().items() if path.with_suffix(".dat").exists()]


@pytest.mark.parametrize("name", sorted(catalogue().keys() - {*TURNING, *MIRRORS}))
def test_scan_patterns_of_the_catalogue(name):
    """The directions of one frame, as its table has them, and when it points where."""
    file = yaml.safe_load(catalogue()[name].read_text())["scan_pattern"]
    with np.load(catalogue()[name].with_name(file["file"])) as table:
        if "rate_hz" in table:  # packed
            count = round(table["rate_hz"] * file["frame_ms"] / 1000)
            steps = table["azimuth_steps"], table["elevation_steps"]
            azimuth_deg, elevation_deg = (one.cumsum(axis=1, dtype=int).T.ravel()[:count] / 100 for one in steps)
            time_ms = np.arange(count) * (1000 / table["rate_hz"])
        else:
            first = table["time_ns"] < file["frame_ms"] * 1e6  # of several frames
            azimuth_deg, elevation_deg = table["azimuth_deg"][first], table["elevation_deg"][first]
            time_ms = table["time_ns"][first] / 1e6
    one, whole, by_time = draw_sensor(load_sensor(name)).axes
    shown = one.collections[0].get_offsets()
    np.testing.assert_allclose(shown[:, 0], (azimuth_deg + 180) % 360 - 180, atol=1e-4)
    np.testing.assert_allclose(shown[:, 1], elevation_deg, atol=1e-4)
    assert len(whole.collections[0].get_offsets()) >= min(len(shown), 100_000)  # of many, a part is drawn
    np.testing.assert_allclose(by_time.lines[0].get_xdata(), time_ms, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "firings", "last_ms"),
    [("at128e2x", 1250 * 128, 1249 / 24 + 0.014928), ("atx", 1280 * 100, 1279 / 15 + 0.05916)],
)
def test_frames_over_a_mirror(name, firings, last_ms):
    """By hand: columns times lasers; 24 columns a millisecond of an AT128, 15 of an ATX; the fields of view."""
    one, whole, by_time = draw_sensor(load_sensor(name)).axes
    shown = one.collections[0].get_offsets()
    assert len(shown) == firings
    assert len(whole.collections[0].get_offsets()) >= len(shown)
    assert np.abs(shown[:, 0]).max() == pytest.approx(65, abs=5)
    time_ms = by_time.lines[0].get_xdata()
    assert (time_ms[0], time_ms[-1]) == pytest.approx((0, last_ms), abs=1e-3)


@pytest.mark.parametrize("name", TURNING)
def test_each_sensor_of_the_catalogue(name):
    """Each laser stands at its place in the file, in all panels; times where the file names a codec."""
    beams = yaml.safe_load(catalogue()[name].read_text())["beams"]
    by_laser, by_azimuth, by_time = drawn(name)
    np.testing.assert_array_equal(by_laser[0], np.arange(len(beams["elevation_deg"])))
    for _, elevation in filter(None, (by_laser, by_azimuth, by_time)):
        np.testing.assert_array_equal(elevation, beams["elevation_deg"])
    np.testing.assert_allclose(by_azimuth[0], beams.get("azimuth_offset_deg", np.zeros(len(by_azimuth[0]))), atol=1e-9)
    assert (by_time is None) == (load_sensor(name).codec is None)


@pytest.mark.parametrize("name", FIRES_US)
def test_firing_times_of_the_manuals(name):
    across, _ = drawn(name)[2]
    np.testing.assert_allclose(across - across[0], FIRES_US[name], atol=1e-9)


def test_the_command_writes_a_picture(tmp_path):
    lidarcfg("sensors", "show", "qt128", "--png", tmp_path / "a.png", "--quiet")
    picture = matplotlib.image.imread(tmp_path / "a.png")
    assert picture.shape[:2] == (780, 1560)
    assert 0.001 < (picture[..., :3].mean(axis=2) < 0.9).mean() < 0.2  # marks and letters on white


def sources(part):
    """Every source that a part of a sensor's file names, of lists of parts too."""
    if isinstance(part, dict) and isinstance(part.get("source"), str):
        yield part["source"]
    for one in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from sources(one)


@pytest.mark.slow
@pytest.mark.parametrize("name", catalogue())
def test_each_source_of_the_catalogue_is_printed(name, capsys):
    print_sensor(load_sensor(name))
    shown = "".join(capsys.readouterr().out.split())
    for source in sources(yaml.safe_load(catalogue()[name].read_text())):
        assert "".join(source.split()) in shown
