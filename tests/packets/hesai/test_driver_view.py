"""Where lasers point while the head turns, by plain loops: by the manuals, as Hesai's SDK has it, and without."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config.models import Section
from lidarcfg.sensors.rig import Rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import datagrams_of, no_warning, recording
from tests.naive import hesai as naive
from tests.packets.hesai.recorded import BY_BLOCK, mount
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
def test_where_lasers_point(model, mode, tmp_path):
    """The head has turned up to 0.3 degrees when a laser fires, by the manuals and Hesai's SDK.

    Nebula and hydra4 take the block's azimuth for all lasers.
    """
    of = mount(model, mode)
    path = tmp_path / "drive.pcap"
    capture(of, path, 20)
    payloads = [datagram.payload for datagram in datagrams_of(path)]
    loops = loops_of(model, len(payloads[0]))
    (angles,) = tmp_path.glob("*-angles.csv")
    table = naive.angles(angles.read_text())
    theirs = [point for payload in payloads for point in naive.driver_points(payload, table, loops)]
    xyz = np.array([point[:3] for point in theirs])
    driver = decode(path, on_warning=no_warning, driver_view=True)
    assert len(driver.xyz) == len(theirs) > 1500
    np.testing.assert_allclose(driver.xyz, xyz, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(driver.time_ns, [point[3] for point in theirs])
    found = decode(path, on_warning=no_warning)
    np.testing.assert_allclose(found.xyz, xyz, rtol=0, atol=1e-6)
    by_block = replace(of, settings=BY_BLOCK)
    blocks = np.array([point for payload in payloads for point in naive.points(payload, table)])
    plain = decode(path, Rig("one", (by_block,)), on_warning=no_warning)
    np.testing.assert_allclose(plain.xyz, blocks[:, :3], rtol=0, atol=1e-9)
    assert np.linalg.norm(plain.xyz - found.xyz, axis=1).max() > 0.03
    np.testing.assert_array_equal(plain.ring, driver.ring)


@pytest.mark.parametrize(("model", "turns"), [("pandar-xt32", None), ("pandar-xt32", False), ("jt128", None)])
def test_a_wall_stands_where_it_is(model, turns, tmp_path):
    """Rays, packets and points agree in either reading: a wall 20 m ahead is flat, as packets have it, to 0.01 degrees.

    Read the other way it leans by the turn: 0.17 degrees (JT128: 0.4) at 30 m across.
    """
    of = replace(mount(model), settings=Section({} if turns is None else {"turns_while_firing": turns}))
    wall = load_scene(
        {"name": "wall", "boxes": [{"name": "wall", "center_m": [21, 0, 0], "size_m": [2, 80, 80], "reflectivity": 50}]}
    )
    path = tmp_path / "wall.pcap"
    rig = Rig("one", (of,))
    write_pcap(path, in_time_order(simulated_packets(rig, wall, np.eye(4), 100_000_000)))
    save_sidecar_files(path, rig.mounts)
    cloud = decode(path, rig, on_warning=no_warning)
    other = Section({"turns_while_firing": not (turns is None and model != "jt128")})
    turned = decode(path, Rig("one", (replace(of, settings=other),)), on_warning=no_warning)
    across = (abs(cloud.xyz[:, 1]) > 25) & (abs(cloud.xyz[:, 1]) < 38)
    assert abs(cloud.xyz[across, 0] - 20).max() < 0.02
    assert abs(turned.xyz[across, 0] - 20).max() > 0.06
