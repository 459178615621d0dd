"""The driver's view: angles and times as Hesai's SDK computes them with its firing time file, by a plain loop."""

import csv

import numpy as np
import pytest

from lidarcfg.capture.decode import decode
from tests.capture_fixtures import datagrams_of, no_warning, recording
from tests.naive import hesai as naive
from tests.packets.hesai.recorded import mount
from tests.packets.hesai.test_encode import capture

XT = "pandar-xt32", "pandar-xt16", "xt32m2x"


def loops_of(model: str, size: int) -> list[list[float]]:
    """The firing times, in microseconds by channel; a QT128's from the maker's own file."""
    if model in XT:
        return [naive.fire_times_us(size)]
    loops = [[0.0] * 128, [0.0] * 128]
    with recording("hesai/correction/QT128C2X_Firetime_Correction_File.csv").open() as file:
        for row in csv.reader(file):
            for loop in range(2 if len(row) == 4 and row[0].isdigit() and row[0] != "0" else 0):  # the rest is padding
                loops[loop][int(row[2 * loop]) - 1] = float(row[2 * loop + 1])
    return loops


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["strongest", "dual"])
@pytest.mark.parametrize("model", [*XT, "qt128"])
def test_points_and_times_are_those_of_hesais_sdk(model, mode, tmp_path):
    """The head has turned up to 0.3 degrees when a laser fires, 44 mm at 8 m; without the view, it has not."""
    of = mount(model, mode)
    path = tmp_path / "drive.pcap"
    capture(of, path, 60)
    payloads = [datagram.payload for datagram in datagrams_of(path)]
    loops = loops_of(model, len(payloads[0]))
    (angles,) = tmp_path.glob("*-angles.csv")
    table = naive.angles(angles.read_text())
    points = [point for payload in payloads for point in naive.driver_points(payload, table, loops)]
    xyz = np.array([point[:3] for point in points])
    found = decode(path, on_warning=no_warning, driver_view=True)
    assert len(found.xyz) == len(points) > 5000
    np.testing.assert_allclose(found.xyz, xyz, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found.time_ns, [point[3] for point in points])
    plain = decode(path, on_warning=no_warning)
    assert np.linalg.norm(plain.xyz - found.xyz, axis=1).max() > 0.03
    np.testing.assert_array_equal(plain.ring, found.ring)
