"""Packets that make no sense, among others that do: they cost themselves and a warning."""

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import Datagram, write_pcap
from lidarcfg.clouds.cloud import FIELDS, concatenate
from lidarcfg.errors import PacketError
from lidarcfg.sensors.rig import load_rig
from lidarcfg.units import START_NS
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, datagrams_of, write_datagrams

DAMAGES = {  # bytes of a packet and what stands there instead
    "vlp-16": [(2, b"\xff\xff"), (602, b"\xb4\x8c"), (1102, b"\x01\xc0")],  # azimuths beyond a revolution
    "pandar-xt32": [(0, b"\xab\xcd\x05"), (6, b"\x40"), (7, b"\x06"), (9, b"\0"), (1062, b"\x55")],
    "qt128": [(2, b"\x01"), (3, b"\x04"), (7, b"\x05"), (1073, b"\x00")],
    "helios-16p": [(0, b"\x55\xaa\x05\x5b"), (31, b"\x31"), (32, b"\x01"), (42, b"\xff\xdd"), (442, b"\0\0")],
}
RIG = "name: one\nsensors: [{{name: top, model: {}, position_m: [0, 0, 2], rpm: 600}}]\n"


@pytest.fixture(scope="module", params=DAMAGES)
def sent(request, tmp_path_factory):
    """A capture of one sensor in the street, its data port, and what may happen to a packet."""
    path = tmp_path_factory.mktemp(request.param) / "a.pcap"
    (path.parent / "rig.yaml").write_text(RIG.format(request.param))
    rig = load_rig(path.parent / "rig.yaml")
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 50_000_000, START_NS)))
    save_sidecar_files(path, rig.mounts)
    return path, rig.mounts[0].data_port, DAMAGES[request.param]


def rewritten(path, port, change):
    """The capture in the same place with its data packets changed by number; those that become None are left out."""
    new = []
    number = 0
    for one in datagrams_of(path):
        if one.port == port:
            payload = change(number, one.payload)
            number += 1
            one = payload and Datagram(one.time_ns, one.host, one.source_port, one.port, payload)
        new += [one] * bool(one)
    other = path.with_stem("a-1")
    write_datagrams(other, new)
    for beside in path.parent.glob("a-192*.csv"):
        beside.with_name(beside.name.replace("a-", "a-1-", 1)).write_bytes(beside.read_bytes())
    return other


def damaged(payload, at, new):
    return payload[:at] + new + payload[at + len(new) :]


@pytest.mark.parametrize("chunk", [7, 1024])
def test_damaged_packets_are_passed_over(sent, chunk):
    """The first, the last and any of each kind: what is left is the capture without them."""
    path, port, kinds = sent
    count = sum(one.port == port for one in datagrams_of(path))
    which = {0: 0, count - 1: 1} | {10 + 3 * i: i for i in range(len(kinds))}
    without = rewritten(path, port, lambda n, payload: None if n in which else payload)
    expected = concatenate(list(decode_pcap(without, lambda warning: None, chunk_packets=chunk)))
    warnings = []
    wrong = rewritten(path, port, lambda n, one: damaged(one, *kinds[which[n]]) if n in which else one)
    found = concatenate(list(decode_pcap(wrong, warnings.append, chunk_packets=chunk)))
    assert [one.split(": ", 2)[2] for one in warnings] == [f"{len(which)} damaged packets are skipped"]
    assert len(found.xyz) > 0.8 * len(kinds) * 1000
    for key in FIELDS:
        np.testing.assert_array_equal(getattr(found, key), getattr(expected, key))


def test_packets_of_which_most_make_no_sense_are_refused(sent):
    path, port, kinds = sent
    wrong = rewritten(path, port, lambda n, payload: damaged(payload, *kinds[2]) if n % 3 else payload)
    with pytest.raises(PacketError, match=r"a-1\.pcap: 192\.168\.1\.201:\d+:? .*(allowed|read are|its DIFOP)"):
        list(decode_pcap(wrong, lambda warning: None))
