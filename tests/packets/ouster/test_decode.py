"""Recordings with metadata beside them: points, fields and stamps are those of ouster-sdk; and they encode again."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.errors import PacketError
from lidarcfg.packets.ouster.layout import assemble, column_headers, packet_headers, unpack
from lidarcfg.packets.ouster.telemetry import read_metadata
from tests.capture_fixtures import decoded, no_warning, recording
from tests.packets.ouster.judge import judged

SINGLE = "OS-2-128-U1_v2.3.0_1024x10"
DUAL = "OS-0-32-U1_v2.2.0_1024x10"
LOW = "crc_test"
LEGACY = "OS-2-32-U0_v2.0.0_1024x10"
FUSA = "OS-1-128_767798045_1024x10_20230712_120049"
RECORDINGS = {  # points, and the footer that the firmware writes
    SINGLE: (119_682, "constant"),
    DUAL: (21_803, "zero"),
    LOW: (29_692, "crc"),
    LEGACY: (28_541, "zero"),
    FUSA: (17_462, "zero"),
}
UNDOCUMENTED = {  # pixel bits that no field of the profile has, and how many bytes of pixels differ for them
    SINGLE: ({28}, 3021),
    LEGACY: ({*range(40, 48)}, 28_258),
}


def files(name):
    return recording(f"ouster/{name}.pcap"), recording(f"ouster/{name}.json")


def packed(layout, headers, packets, footer):
    """The packets with these headers, from their columns' headers and all fields of their pixels."""
    fields = unpack(layout, packets)
    raw = np.stack([values.ravel() >> layout.profile.fields[name].dropped for name, values in fields.items()])
    return assemble(layout, headers, column_headers(layout, packets), raw, layout.bits_of(list(fields)), footer)


@pytest.mark.parametrize("name", RECORDINGS)
def test_points_fields_and_stamps_are_those_of_ouster_sdk(name):
    pcap, metadata = files(name)
    theirs = judged(pcap, metadata)
    layout = read_metadata(metadata.name, metadata.read_bytes()).layout
    ours = unpack(layout, theirs.packets)
    said = column_headers(layout, theirs.packets)
    assert set(theirs.fields) - {"window"} <= set(ours)
    for key, values in theirs.fields.items():
        np.testing.assert_array_equal(ours[key], values, err_msg=key)
    np.testing.assert_array_equal(said.time_ns, theirs.time_ns)
    np.testing.assert_array_equal(said.measurement, theirs.measurement)
    np.testing.assert_array_equal(packet_headers(layout, theirs.packets).frame, theirs.frame)
    cloud = decoded(pcap)
    both = [theirs.points(key) for key in ("range", "range2") if key in theirs.fields]
    points = np.stack(both, axis=3)
    found = ~np.isnan(points[..., 0])
    assert len(cloud.xyz) == found.sum() == RECORDINGS[name][0]
    np.testing.assert_allclose(cloud.xyz, points[found], rtol=0, atol=1e-4)
    column, pixel, which = np.nonzero(found.reshape(-1, *found.shape[2:]))
    np.testing.assert_array_equal(cloud.time_ns, theirs.time_ns.ravel()[column])
    np.testing.assert_array_equal(cloud.return_type, np.where(which == 0, 0, 2))
    bright = np.stack([theirs.fields[key] for key in ("reflectivity", "reflectivity2") if key in theirs.fields], 3)
    np.testing.assert_array_equal(cloud.intensity, bright[found])
    elevation = theirs.info.beam_altitude_angles
    np.testing.assert_array_equal(cloud.ring, len(elevation) - 1 - pixel)  # altitudes descend


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_encode_again_but_for_undocumented_bits(name):
    pcap, metadata = files(name)
    packets = judged(pcap, metadata).packets
    layout = read_metadata(metadata.name, metadata.read_bytes()).layout
    again = packed(layout, packet_headers(layout, packets), packets, RECORDINGS[name][1])
    if name not in UNDOCUMENTED:
        np.testing.assert_array_equal(again, packets)
        return
    start = layout.head + layout.column_head
    rows = (again ^ packets)[:, layout.head : layout.head + 16 * layout.column].reshape(-1, layout.column)
    pixels = rows[:, layout.column_head : layout.column_head + layout.pixels * layout.profile.pixel]
    bits = np.unpackbits(pixels.reshape(-1, layout.profile.pixel), axis=1, bitorder="little").any(axis=0)
    allowed, count = UNDOCUMENTED[name]
    assert set(np.flatnonzero(bits)) <= allowed
    assert (again != packets).sum() == (pixels > 0).sum() == count  # nothing outside of the pixels
    assert start < layout.size


def test_fragments_of_two_sensors_behind_one_port():
    pcap = recording("ouster/same_ports_legacy.pcap")
    cloud = decoded(pcap)
    for name, host in (("1", "169.254.92.158"), ("2", "169.254.238.111")):
        theirs = judged(pcap, pcap.with_name(f"same_ports_legacy.{name}.json"))
        points = theirs.points()
        mine = cloud.xyz[cloud.sensor == cloud.sensor_names.index(f"{host}:7502")]
        np.testing.assert_allclose(mine, points[~np.isnan(points[..., 0])], rtol=0, atol=1e-4)


def test_packets_from_fragments_encode_again():
    """Of both sensors, byte for byte."""
    pcap = recording("ouster/same_ports_legacy.pcap")
    for name in ("1", "2"):
        metadata = pcap.with_name(f"same_ports_legacy.{name}.json")
        packets = judged(pcap, metadata).packets
        layout = read_metadata(metadata.name, metadata.read_bytes()).layout
        assert len(packets) > 0
        np.testing.assert_array_equal(packed(layout, packet_headers(layout, packets), packets, "zero"), packets)


def test_without_metadata_it_says_what_is_missing(tmp_path):
    pcap, _ = files(LOW)
    alone = shutil.copy(pcap, tmp_path / "alone.pcap")
    with pytest.raises(PacketError, match=r"packets of 8448 bytes need the sensor's metadata, a \.json named as"):
        list(decode_pcap(alone, no_warning))


def test_metadata_of_another_sensor(tmp_path):
    pcap, metadata = files(LOW)
    shutil.copy(pcap, tmp_path / "a.pcap")
    (tmp_path / "a.json").write_text(metadata.read_text().replace("122247000785", "122247000786"))
    with pytest.raises(PacketError, match=r"its packets are of 122247000785; .*/a\.json is of OS-0-128 122247000786"):
        list(decode_pcap(tmp_path / "a.pcap", no_warning))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"columns_per_frame": 512', '"columns_per_frame": "512"', "columns_per_frame is '512'; allowed"),
        ("45.16,", "", "128 pixels a column, 127 altitude"),
        ("45.16,", "NaN,", "beam_altitude_angles is no list of angles"),
        ('"RNG15_RFL8_NIR8"', '"RNG15"', "profile 'RNG15' cannot be read"),
        ('"columns_per_frame": 512', '"columns_per_frame": 0', "columns_per_frame is 0; allowed: 1 to 8192"),
    ],
)
def test_damaged_metadata(tmp_path, old, new, message):
    pcap, metadata = files(LOW)
    shutil.copy(pcap, tmp_path / "a.pcap")
    text = metadata.read_text()
    assert old in text
    (tmp_path / "a.json").write_text(text.replace(old, new))
    with pytest.raises(PacketError, match=rf"a\.json: not the metadata of an Ouster: .*{message}"):
        list(decode_pcap(tmp_path / "a.pcap", no_warning))


def test_headers_that_say_more_encode_again():
    pcap, metadata = files(LOW)
    packets = judged(pcap, metadata).packets
    layout = read_metadata(metadata.name, metadata.read_bytes()).layout
    limiting = replace(packet_headers(layout, packets), shot_countdown=5, shot=1, thermal_countdown=7, thermal=2)
    again = packed(layout, limiting, packets, "crc")
    found = packet_headers(layout, again)
    assert (found.shot_countdown, found.shot, found.thermal_countdown, found.thermal) == (5, 1, 7, 2)
