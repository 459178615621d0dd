"""Packets of two makers in one capture: on one address and port, or beside the sensor that is given; and older ones."""

import re
import struct
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture import reader
from lidarcfg.capture.decode import decode, decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import Datagram, write_pcap
from lidarcfg.capture.selection import Selection
from lidarcfg.errors import PacketError
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import AT_NS, STREET, datagrams_of, no_warning, write_datagrams
from tests.command_line import lidarcfg

RIG = """
name: two
sensors:
  - {name: left, model: vlp-16, position_m: [0, 1, 2], host: 192.168.1.201, data_port: 2368}
  - {name: right, model: pandar-xt32, position_m: [0, -1, 2], host: 192.168.1.202, data_port: 2368}
"""
ADDRESS = "192.168.1.201:2368"


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """A VLP-16 and a PandarXT-32 that claim one address and port; and the VLP-16's packets alone."""
    folder = tmp_path_factory.mktemp("mixed")
    (folder / "rig.yaml").write_text(RIG)
    rig = load_rig(folder / "rig.yaml")
    write_pcap(folder / "b.pcap", in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 20_000_000)))
    found = datagrams_of(folder / "b.pcap")
    write_datagrams(folder / "a.pcap", [replace(one, host="192.168.1.201") for one in found])
    write_datagrams(folder / "alone.pcap", [one for one in found if one.host == "192.168.1.201"])
    save_sidecar_files(folder / "a.pcap", rig.mounts)
    return folder


def test_two_makers_on_one_address_and_port_are_refused(mixed):
    what = rf"a\.pcap: {ADDRESS} sends packets of two makers: hesai \(1080 bytes\) and velodyne \(1206 bytes\)$"
    with pytest.raises(PacketError, match=what):
        decode(mixed / "a.pcap", on_warning=no_warning)


@pytest.mark.parametrize("given", ["rig", "model"])
def test_packets_that_are_not_the_given_sensors_are_told(given, mixed):
    """The given sensor's points are those of a capture without the others."""
    text = RIG[: RIG.index("  - {name: right")]
    (mixed / "left.yaml").write_text(text)
    options = {"rig": load_rig(mixed / "left.yaml")} if given == "rig" else {"model": "vlp-16"}
    said = []
    clouds = list(decode_pcap(mixed / "a.pcap", said.append, **options))
    assert sum(len(one.payload) == 1080 for one in datagrams_of(mixed / "a.pcap")) == 50
    (line,) = said
    assert re.search(rf"a\.pcap: {ADDRESS}: 50 packets of hesai \(1080 bytes\) are skipped: .* not vlp-16's$", line)
    alone = list(decode_pcap(mixed / "alone.pcap", no_warning, **options))
    np.testing.assert_array_equal(*(np.concatenate([one.xyz for one in some]) for some in (clouds, alone)))


def pandar40p(size: int) -> bytes:
    """Ten blocks of flag, azimuth and forty returns (Hesai's SDK 2.0, udp_protocol_p40.h)."""
    blocks = b"".join(struct.pack("<2sH", b"\xff\xee", 20 * block) + b"\x10\x01\x05" * 40 for block in range(10))
    return blocks.ljust(size, b"\0")


def pandar64(size: int) -> bytes:
    """A header of lasers and blocks, and six blocks of azimuth and 64 returns (udp_protocol_p64.h)."""
    blocks = b"".join(struct.pack("<H", 20 * block) + b"\x10\x01\x05" * 64 for block in range(6))
    return (b"\xee\xff\x40\x06\x37\x04\0\0" + blocks).ljust(size, b"\0")


@pytest.mark.parametrize(
    ("name", "make", "size"),
    [
        (make.__name__, make, size)
        for make, sizes in ((pandar40p, (1262, 1266)), (pandar64, (1194, 1198)))
        for size in sizes
    ],
)
def test_older_packets_of_hesai_are_refused_by_name(name, make, size, tmp_path):
    packets = [Datagram(AT_NS + 10**6 * i, "192.168.1.201", 10000, 2368, make(size)) for i in range(20)]
    write_datagrams(tmp_path / "a.pcap", packets)
    with pytest.raises(PacketError, match=rf"(?i){ADDRESS} sends Hesai's {name} packets of {size} bytes; read are "):
        decode(tmp_path / "a.pcap", on_warning=no_warning)


def test_more_sensors_than_can_be_decoded_together(mixed, tmp_path, monkeypatch):
    """The limit is said; what --sensor names is read all the same."""
    monkeypatch.setattr(reader, "SENSORS_MAX", 20)
    packets = [one for one in datagrams_of(mixed / "alone.pcap") if one.port == 2368]
    sent = [replace(one, host=f"10.0.0.{i}") for i, one in enumerate(packets[:15] * 2)]
    write_datagrams(tmp_path / "a.pcap", sent[:20])
    assert len(decode(tmp_path / "a.pcap", on_warning=no_warning).sensor_names) == 20
    write_datagrams(tmp_path / "b.pcap", sent)
    with pytest.raises(PacketError, match="packets of more than 20 addresses and ports; allowed: 20, or"):
        decode(tmp_path / "b.pcap", on_warning=no_warning)
    some = list(decode_pcap(tmp_path / "b.pcap", no_warning, selection=Selection(sensors=("10.0.0.29:2368",))))
    assert some[0].sensor_names == ("10.0.0.29:2368",)


def test_the_figures_of_one_packet_and_of_a_head_that_stands(mixed, tmp_path):
    """A speed that packets do not say is not a number of revolutions."""
    packets = [one for one in datagrams_of(mixed / "alone.pcap") if one.port == 2368]
    stands = [replace(one, payload=standing(one.payload)) for one in packets]
    for some in (packets[:1], stands):
        write_datagrams(tmp_path / "a.pcap", some)
        said = lidarcfg("decode", tmp_path / "a.pcap", "--stats", "-o", tmp_path / "a.npz").stdout
        assert f"strongest, speed not known, {len(some)} packets, 0 lost" in said


def standing(payload: bytes) -> bytes:
    """A VLP-16's packet with all azimuths 0."""
    found = bytearray(payload)
    for block in range(12):
        found[100 * block + 2 : 100 * block + 4] = b"\0\0"
    return bytes(found)
