"""The compiled loops against plain ones written from the documentation's tables, on packets of every profile."""

import json

import numpy as np
import pytest

from lidarcfg.packets.families import codec
from lidarcfg.packets.ouster.decode import OusterDecoder
from lidarcfg.packets.ouster.telemetry import read_metadata
from tests.naive import ouster as naive
from tests.packets.ouster.test_encode import PROFILES, START_NS, UNRECORDED, mount

LEAST_M = 0.5
MOST_M = 124.75
SCALE = 206  # as sensors/os0-32.yaml has them: between which it reports


def encoded(profile, firmware, fov=None):
    """Two packets around the azimuth window's end, what they are of, and what was measured."""
    one = mount("os0-32", dual="DUAL" in profile, profile=profile, firmware=firmware, columns=512, fov=fov)
    family = codec(one.sensor)
    batch = next(family.schedule(one, START_NS, [range(32)]))
    count = len(batch.firings.time_ns)
    width = 1 + ("DUAL" in profile)
    rng = np.random.default_rng(len(profile))
    range_m = np.sort(rng.uniform(0.3, 135, (count, width)), axis=1)
    range_m[rng.random((count, width)) < 0.1] = np.inf
    gray = rng.integers(0, 256, (count, width)).astype(np.uint8)
    if width == 2:
        same = rng.random(count) < 0.3
        range_m[same, 1] = range_m[same, 0]
        gray[same, 1] = gray[same, 0]
    return one, batch, range_m, gray, family.encode(one, batch, range_m, gray).data, family.sidecar_files(one)[".json"]


@pytest.mark.parametrize("fov", [None, (300.0, 80.0)])
@pytest.mark.parametrize("firmware", ["2.3", "3.2"])
@pytest.mark.parametrize("profile", PROFILES)
def test_packets_are_those_of_the_tables(profile, firmware, fov):
    if firmware == "2.3" and profile in ("RNG15_RFL8_NIR8_DUAL", "FUSA_RNG15_RFL8_NIR8_DUAL", *UNRECORDED):
        firmware = "3.2"
        fov = (10.0, 200.0)
    _, batch, range_m, gray, data, metadata = encoded(profile, firmware, fov)
    said = json.loads(metadata)
    form = said["lidar_data_format"]
    start_mm, (first, last) = said["beam_intrinsics"]["lidar_origin_to_beam_origin_mm"], form["column_window"]
    unit_mm = PROFILES[profile]
    bits = {"LEGACY": 20}.get(profile, 19 if PROFILES[profile] == 1 else 15)
    head = {
        "init": said["sensor_info"]["initialization_id"],
        "serial": int(said["sensor_info"]["prod_sn"]),
        "alerts": 0x90 if firmware == "3.2" else 0,
    }
    footer = "zero" if "FUSA" in profile else "crc" if firmware == "3.2" else "constant"
    assert len(data) == len(batch.number) > 8
    for p in (0, len(data) // 2, len(data) - 1):
        columns = []
        for c in range(16):
            at = (p * 16 + c) * 32
            measurement = int(batch.number[p]) * 16 % 512 + c
            valid = first <= measurement <= last if first <= last else not last < measurement < first
            pixels = []
            for n in range(at, at + 32):
                returns = [
                    naive.measured(float(m), int(g), LEAST_M, MOST_M, start_mm, unit_mm, bits, SCALE)
                    for m, g in zip(range_m[n], gray[n], strict=True)
                ]
                if len(returns) == 2 and returns[0] == returns[1]:
                    returns[1] = 0, 0, 0
                if firmware == "2.3" and len(returns) == 2 and all(one[0] for one in returns):
                    strength = [
                        naive.light(g) / m**2 for m, g in zip(range_m[n].tolist(), gray[n].tolist(), strict=True)
                    ]
                    returns = returns if strength[0] >= strength[1] else returns[::-1]
                pixels.append(naive.pixel(profile, returns if valid else [(0, 0, 0)] * len(returns)))
            columns.append((int(batch.firings.time_ns[at]), measurement, valid, pixels))
        frame = int(batch.number[p]) * 16 // 512
        assert naive.packet(profile, head | {"frame": frame}, columns, 512, footer) == data[p].tobytes()


TILTED = [-0.8, 0, 0.6, 1, 0, -1, 0, 2, 0.6, 0, 0.8, 3, 0, 0, 0, 1]  # about y by a triangle of 3, 4 and 5


@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize("profile", PROFILES)
def test_points_are_those_of_the_formulas(profile, tilted):
    """Of packets as they are written, and of the same with odd bytes; of a lidar that is tilted in its sensor, too."""
    _, _, _, _, data, metadata = encoded(profile, "3.2")
    if tilted:
        changed = json.loads(metadata)
        changed["lidar_intrinsics"]["lidar_to_sensor_transform"] = TILTED
        metadata = json.dumps(changed).encode()
    rng = np.random.default_rng(3)
    odd = data.copy()
    odd.reshape(-1)[rng.integers(0, odd.size, odd.size // 20)] = rng.integers(0, 256, odd.size // 20)
    decoder = OusterDecoder("a", read_metadata("a.json", metadata), "os0-32")
    kinds = [0, 2] if read_metadata("a.json", metadata).nearest_first is False else [0, 1]
    for packets in (data[:3], odd[:5]):
        found = decoder.decode(packets, np.empty(0, np.int64), np.ones(len(packets), np.bool_))
        theirs = [point for payload in packets for point in naive.points(payload.tobytes(), metadata)]
        assert len(found.time_ns) == len(theirs) > 500
        x, y, z, time_ns, laser, gray, number = zip(*theirs, strict=True)
        np.testing.assert_allclose(found.xyz_m, np.stack([x, y, z], axis=1), rtol=0, atol=1e-9)
        np.testing.assert_array_equal(found.time_ns.view(np.uint64), np.array(time_ns, np.uint64))
        np.testing.assert_array_equal(found.ring, 31 - np.array(laser))  # altitudes descend
        np.testing.assert_array_equal(found.intensity, gray)
        np.testing.assert_array_equal(found.return_type, np.array(kinds)[list(number)])


@pytest.mark.parametrize("pixels", [3, 8, 21])
@pytest.mark.parametrize("profile", ["LEGACY", "RNG15_RFL8_NIR8", "RNG19_RFL8_SIG16_NIR16_DUAL"])
def test_points_of_any_number_of_pixels(profile, pixels):
    """Of the first pixels of each column, as of a sensor with no more; loops take eight of them together."""
    _, _, _, _, data, metadata = encoded(profile, "3.2")
    layout = read_metadata("a.json", metadata).layout
    begin = layout.head
    end = layout.head + 16 * layout.column
    wide = layout.profile.pixel
    columns = data[:4, begin:end].reshape(4, 16, layout.column)
    gone = np.s_[layout.column_head + pixels * wide : layout.column_head + 32 * wide]
    columns = np.delete(columns, gone, axis=2)
    few = np.concatenate([data[:4, :begin], columns.reshape(4, -1), data[:4, end:]], axis=1)
    said = json.loads(metadata)
    said["lidar_data_format"]["pixels_per_column"] = pixels
    for key in ("beam_altitude_angles", "beam_azimuth_angles"):
        said["beam_intrinsics"][key] = said["beam_intrinsics"][key][:pixels]
    metadata = json.dumps(said).encode()
    decoder = OusterDecoder("a", read_metadata("a.json", metadata), "os0-32")
    found = decoder.decode(few, np.empty(0, np.int64), np.ones(4, np.bool_))
    theirs = [point for payload in few for point in naive.points(payload.tobytes(), metadata)]
    x, y, z, time_ns, laser, gray, _ = zip(*theirs, strict=True)
    np.testing.assert_allclose(found.xyz_m, np.stack([x, y, z], axis=1), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.time_ns.view(np.uint64), np.array(time_ns, np.uint64))
    np.testing.assert_array_equal(found.ring, pixels - 1 - np.array(laser))
    np.testing.assert_array_equal(found.intensity, gray)
