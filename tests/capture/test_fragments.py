"""Datagrams above the MTU: written as dpkt reads them, put together whatever comes in whatever order."""

import random

import dpkt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.fragments import PENDING_MAX, TIMEOUT_NS, Fragment, Reassembly
from lidarcfg.capture.pcap import EthernetFrames, read_datagrams, write_pcap
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.headers import Header, Network
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import (
    STREET,
    datagrams_of,
    decoded,
    decoded_with_stats,
    no_warning,
    recording,
    write_datagrams,
)
from tests.naive.fragments import reassembled

AT_NS = 1_700_000_000 * 10**9
NETWORK = Network(source="", mac_prefix="02:00:00", destination_mac="ff:ff:ff:ff:ff:ff", destination_ip="10.0.0.255")
HEADER = Header(ttl=64, dont_fragment=True, numbered=False, checksum=True)


def sent(size, count=3, host="10.0.0.7"):
    """Payloads of random octets, and their frames."""
    data = np.random.default_rng(size).integers(0, 256, (count, size)).astype(np.uint8)
    times_ns = AT_NS + np.arange(count) * 1_000_000
    return data, ethernet_frames(host, Payloads(times_ns, data, 7502, NETWORK, HEADER, 65534))


def written(path, records):
    write_pcap(path, [EthernetFrames(np.zeros(len(records), np.int64), records)])
    return path


@pytest.mark.parametrize("size", [1, 1472, 1473, 1474, 1480, 2952, 2953, 8448, 24832, 65507])
def test_sizes_around_the_mtu(tmp_path, size):
    """Each frame within the MTU; dpkt finds headers and checksums right and the payload in the fragments."""
    data, made = sent(size)
    most = -(-(size + 8) // 1480)
    assert len(made.records) == len(made.time_ns) == 3 * most
    whole = {}
    for record in made.records:
        ip = dpkt.ethernet.Ethernet(record[16:]).data
        assert len(bytes(ip)) <= 1500
        assert dpkt.in_cksum(record[30:50]) == 0
        assert ip.df == (most == 1)
        whole.setdefault(ip.id if most > 1 else len(whole), []).append((_offset(record[16:]), bool(ip.mf), record[50:]))
    assert list(whole) == ([65534, 65535, 0] if most > 1 else [0, 1, 2])  # ids wrap
    for row, fragments in zip(data, whole.values(), strict=True):
        datagram = reassembled(fragments)
        udp = dpkt.udp.UDP(datagram)
        assert (udp.sport, udp.dport, udp.ulen, udp.data) == (7502, 7502, size + 8, row.tobytes())
        pseudo = bytes([10, 0, 0, 7, 10, 0, 0, 255, 0, 17]) + (size + 8).to_bytes(2)
        assert dpkt.in_cksum(pseudo + datagram) == 0
    found = list(read_datagrams(written(tmp_path / "a.pcap", made.records), no_warning))
    assert [(d.host, d.port, d.payload) for d in found] == [("10.0.0.7", 7502, row.tobytes()) for row in data]


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_any_order_and_repetition(tmp_path_factory, data):
    """Fragments of two senders mixed: each datagram comes once, when its last fragment does; the others are counted."""
    rows = {}
    records = []
    for host in ("10.0.0.7", "10.0.0.8"):
        octets, made = sent(data.draw(st.integers(1473, 7000)), 2, host)
        rows |= {(host, i): row.tobytes() for i, row in enumerate(octets)}
        parts = len(made.records) // 2
        records += [((host, i // parts), record) for i, record in enumerate(made.records)]
    records = data.draw(st.permutations(records))
    lost = data.draw(st.sets(st.sampled_from([record for _, record in records]), max_size=3))
    kept = [one for one in records if one[1] not in lost]
    kept += data.draw(st.lists(st.sampled_from(kept), max_size=0)) if kept else []
    damaged = {key for key, record in records if record in lost}
    warnings = []
    path = written(tmp_path_factory.getbasetemp() / "mixed.pcap", [record for _, record in kept])
    found = [(d.host, d.payload) for d in read_datagrams(path, warnings.append)]
    ends = {key: i for i, (key, _) in enumerate(kept)}
    expected = sorted((key for key in rows if key not in damaged), key=lambda key: ends[key])
    assert found == [(key[0], rows[key]) for key in expected]
    begun = {key for key, _ in kept} & damaged
    what = "datagrams skipped: fragments of theirs are missing or damaged"
    assert warnings == ([f"{path}: {len(begun)} {what}"] if begun else [])


def part(offset, data, last=False, key=b"a", time_ns=AT_NS):
    return Fragment(key, time_ns, offset, last, data)


def test_a_repeated_fragment_counts_once():
    reassembly = Reassembly()
    assert reassembly.add(part(0, b"x" * 8)) is None
    assert reassembly.add(part(0, b"x" * 8)) is None
    assert reassembly.add(part(8, b"yy", last=True)) == b"x" * 8 + b"yy"
    assert reassembly.incomplete == 0


@pytest.mark.parametrize(
    "second",
    [
        part(0, b"z" * 8),  # the same place, other octets
        part(8, b"z" * 16),  # over two
        part(0, b"x" * 16),
        part(24, b"zz", last=True),  # a second end
        part(32, b"z" * 8),  # beyond the end
        part(40, b"z" * 7),  # more follow, but it is no multiple of 8
        part(65_512, b"z" * 16),  # no IP packet is as long
    ],
)
def test_fragments_that_contradict_each_other(second):
    """The datagram is dropped, whatever comes of it after; one that is right goes through beside it."""
    reassembly = Reassembly()
    for one in (part(0, b"x" * 8), part(16, b"y" * 8), part(24, b"end", last=True)):
        assert reassembly.add(one) is None
    assert reassembly.add(second) is None
    assert reassembly.incomplete == 1
    assert reassembly.add(part(0, b"x" * 8, key=b"b")) is None
    assert reassembly.add(part(8, b"q", last=True, key=b"b")) == b"x" * 8 + b"q"
    assert reassembly.add(part(8, b"v" * 8)) is None


def test_waiting_has_an_end():
    """After 30 s the same id is another datagram's; and no more wait than there may."""
    reassembly = Reassembly()
    reassembly.add(part(0, b"x" * 8))
    later_ns = AT_NS + TIMEOUT_NS + 1
    assert reassembly.add(part(8, b"y", last=True, time_ns=later_ns)) is None
    assert reassembly.add(part(0, b"z" * 8, time_ns=later_ns)) == b"z" * 8 + b"y"
    assert reassembly.incomplete == 1
    for i in range(3 * PENDING_MAX):
        reassembly.add(part(0, b"x" * 8, key=i.to_bytes(4), time_ns=later_ns))
    assert len(reassembly._pending) <= PENDING_MAX
    assert reassembly.incomplete == 1 + 3 * PENDING_MAX


def _offset(frame):
    return (int.from_bytes(frame[20:22]) & 0x1FFF) * 8


def test_a_recording_in_fragments():
    """Ouster's: datagrams of the sizes that its sensors send, as dpkt and a plain loop put them together."""
    path = recording("ouster/same_ports_legacy.pcap")
    parts = {}
    with open(path, "rb") as file:
        for _, frame in dpkt.pcap.UniversalReader(file):
            ip = dpkt.ethernet.Ethernet(frame).data
            if isinstance(ip, dpkt.ip.IP) and ip.p == dpkt.ip.IP_PROTO_UDP:
                start = 14 + 4 * (frame[14] & 15)
                parts.setdefault((ip.src, ip.id), []).append((_offset(frame), bool(ip.mf), frame[start : 14 + ip.len]))
    expected = sorted(datagram[8:] for one in parts.values() if (datagram := reassembled(one)))
    assert len(expected) > 0
    assert sorted(d.payload for d in read_datagrams(path, lambda warning: None)) == expected


@pytest.mark.parametrize("model", ["os1-64", "vlp-16", "pandar-xt32", "helios-32"])
def test_frames_in_any_order_are_no_lost_packets(model, tmp_path):
    """Frames shuffled within a tenth of a second and more: all points, none lost. Packets that are left out are."""
    text = f"name: one\nsensors: [{{name: top, model: {model}, position_m: [0, 0, 2], rpm: 600}}]\n"
    (tmp_path / "rig.yaml").write_text(text)
    rig = load_rig(tmp_path / "rig.yaml")
    path = tmp_path / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 150_000_000)))
    save_sidecar_files(path, rig.mounts)
    points = decoded(path).xyz
    raw = path.read_bytes()
    records = []
    at = 24
    while at < len(raw):
        end = at + 16 + int.from_bytes(raw[at + 8 : at + 12], "little")
        records.append(raw[at:end])
        at = end
    rest = records[20:]
    random.Random(1).shuffle(rest)
    path.write_bytes(raw[:24] + b"".join(records[:20] + rest))
    cloud, stats = decoded_with_stats(path)
    assert stats.lost == 0
    assert len(cloud.xyz) == len(points)
    if model in ("os1-64", "pandar-xt32"):  # the others' heads turn towards the next packet
        np.testing.assert_array_equal(np.sort(cloud.xyz, axis=0), np.sort(points, axis=0))


@pytest.mark.parametrize("chunk", [7, 1024])
def test_a_lost_packet_among_late_ones(chunk, tmp_path):
    """Of the packets 0 to 59, 20 is lost, and 30 comes after 50: one is lost."""
    (tmp_path / "rig.yaml").write_text(
        "name: one\nsensors: [{name: top, model: pandar-xt32, position_m: [0, 0, 2], rpm: 600}]\n"
    )
    rig = load_rig(tmp_path / "rig.yaml")
    path = tmp_path / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 25_000_000)))
    save_sidecar_files(path, rig.mounts)
    packets = datagrams_of(path)[:60]
    order = [i for i in range(60) if i not in (20, 30)]
    order.insert(order.index(50) + 1, 30)
    write_datagrams(path, [packets[i] for i in order])
    _, stats = decoded_with_stats(path, chunk_packets=chunk)
    assert stats.lost == 1
