"""What Seyond's SDK reads in packets of random bytes: judged.npz.

inno-lidar-sdk 3.103.4, unmodified, with its tool get_pcd, was given captures, here two packets a model and return mode,
whose blocks are random, but for a Robin W's numbers of sets, facets and polygon's angles, which are some that it has; a
Robin W's table has random errors. The points are those of its .pcd.
"""

from pathlib import Path

import numpy as np
import pytest

from lidarcfg.packets.families import codec
from lidarcfg.packets.seyond.decode import SeyondDecoder, form_of
from lidarcfg.packets.seyond.layout import TABLE_PACKET, crcs
from tests.naive import seyond as naive
from tests.packets.seyond.fixtures import MODELS, mount, starts

FILE = Path(__file__).parent / "judged.npz"
FLOAT32 = 1e-7  # of a distance: the SDK's sines and coordinates


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("return_mode", ["strongest", "dual"])
def test_points_are_the_sdks(model, return_mode):
    name = f"{model}-{return_mode}".replace("-", "_")
    with np.load(FILE) as file:
        packets, said = file[f"{name}_packets"], file[f"{name}_points"]
        table = file[f"{name}_table"] if model == "robin-w" else None
    count = len(packets)
    angles = None if table is None else table.view(TABLE_PACKET)["table"]["angles"][0]
    unit = codec(mount(model).sensor).unit
    decoder = SeyondDecoder("here", unit, form_of("here", packets), packets.shape[1], angles)
    decoder.check(packets)
    found = decoder.decode(packets, np.zeros(count, np.int64), np.ones(count, np.bool_))
    xyz = np.stack([said["z"], -said["y"], said["x"]], axis=1)
    assert len(xyz) == len(found.xyz_m) > 200
    away = np.linalg.norm(found.xyz_m, axis=1)
    assert np.abs(xyz - found.xyz_m).max(axis=1) == pytest.approx(0, abs=1e-5 + FLOAT32 * away.max())
    assert np.abs(said["timestamp"] - found.time_ns / 1e9).max() < 1e-6
    assert (said["channel"] == found.ring).all()
    columns = decoder.driver_columns(packets, np.ones(count, np.bool_))
    others = ("scan_id", "scanline"), ("scan_idx", "scan_idx"), ("roi", "roi"), ("is_2nd_return", "is_2nd_return")
    for ours, theirs in (("strength", "reflectance"), *others):
        assert (columns[ours] == said[theirs]).all(), ours
    second = [
        one
        for row in packets
        for one in naive.points(row.tobytes(), starts(), table.tobytes() if model == "robin-w" else b"")
    ]
    assert len(second) == len(said)
    assert crcs(packets).tolist() == [naive.header(row.tobytes())["crc"] for row in packets]
