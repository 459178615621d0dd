"""What the makers' and others' drivers say of these packets.

sdk.npz has packets of ours and their points by HesaiLidar_SDK_2.0 2.0.11, an ATX's with its file of firing times.
nebula.npz has a unit's angles (calibration/PandarAT128.dat) and every twentieth point of Nebula's cloud of a recording
of that unit, which is not public (decoder_ground_truth/at128/1679653308704927652.pcd).
"""

from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import save_sidecar_files
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.sensors.mirror import CIRCLE, UNITS, parse_mirror_angles
from lidarcfg.units import START_NS
from tests.capture_fixtures import no_warning
from tests.naive import hesai_at as naive
from tests.packets.hesai_at.fixtures import mount

CASES = (
    *("at128e2x_strongest_0", "at128e2x_strongest_1", "at128e3x_last_2", "at128e3x_dual_0"),
    *("atx_first_0", "atx_dual_1"),
)


@pytest.mark.parametrize("case", CASES)
def test_points_as_hesais_sdk_has_them(case, tmp_path):
    """It takes both of two equal returns. It computes angles in float32, to 0.0002 degrees."""
    with np.load(Path(__file__).with_name("sdk.npz")) as said:
        data, xyz_m, ring, intensity, time_us = (
            said[f"{case}_{key}"] for key in ("payloads", "xyz_m", "ring", "intensity", "time_us")
        )
    model, mode, _ = case.split("_")
    of = mount(model, mode)
    headers = codec(of.sensor).unit.facts.headers
    path = tmp_path / "drive.pcap"
    sent_ns = START_NS + np.arange(len(data)) * 100_000
    write_pcap(path, [ethernet_frames(of.host, Payloads(sent_ns, data, of.data_port, headers, headers.data))])
    save_sidecar_files(path, [of])
    cloud = concatenate(list(decode_pcap(path, no_warning, driver_view=True)))
    there = xyz_m.any(axis=1)
    if of.dual:
        half = len(xyz_m) // (2 * len(data))
        pairs = np.column_stack([xyz_m, intensity]).reshape(len(data), 2, half, 4)
        again = np.zeros((len(data), 2, half), np.bool_)
        again[:, 1] = (pairs[:, 0] == pairs[:, 1]).all(axis=2)
        there &= ~again.ravel()
    assert len(cloud.xyz) == there.sum() > 0.7 * len(there) / (1 + of.dual)
    away_m = np.linalg.norm(cloud.xyz - xyz_m[there], axis=1)
    assert (away_m / np.linalg.norm(cloud.xyz, axis=1)).max() < np.radians(2e-4)
    np.testing.assert_array_equal(cloud.ring, ring[there])
    np.testing.assert_array_equal(cloud.intensity, intensity[there])
    stamps_us = [naive.stamp_us(payload.tobytes()) - START_NS // 1000 for payload in data]
    assert np.abs(np.unique(time_us) - stamps_us).max() <= 1


def test_points_of_a_recording_lie_on_one_facets_rays():
    """Nebula rounds corrections to hundredths of a degree. The other two facets' rays miss by several times as much."""
    with np.load(Path(__file__).with_name("nebula.npz")) as said:
        angles = parse_mirror_angles("nebula", said["angles"].tobytes())
        xyz_m = said["xyz_m"].astype(np.float64)
    azimuth_deg = np.degrees(np.arctan2(xyz_m[:, 0], xyz_m[:, 1]))
    elevation_deg = np.degrees(np.arcsin(xyz_m[:, 2] / np.linalg.norm(xyz_m, axis=1)))
    missed_deg = []
    for facet in range(3):
        angle = angles.start[facet] + np.arange(12 * UNITS, 78 * UNITS, 320)
        further, higher = angles.pointing_deg(angle % CIRCLE, np.full(len(angle), facet))
        missed_deg.append(
            np.min(
                [
                    np.abs(np.interp(azimuth_deg, further[:, laser], higher[:, laser]) - elevation_deg)
                    for laser in range(128)
                ],
                axis=0,
            )
        )
    assert missed_deg[0].max() < 0.0055
    assert np.median(missed_deg[1]) > 0.05
    assert np.median(missed_deg[2]) > 0.02
