"""Where packets go: a destination, a multicast group, a VLAN. dpkt reads the frames, and decoding does not mind them."""

import socket

import dpkt
import numpy as np
import pytest

from lidarcfg.capture.decode import decode
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.rig import load_rig, rig_to_dict
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, no_warning

SENSORS = {
    "vlp-16": ({"destination": "239.129.2.3", "vlan_id": 42}, "01:00:5e:01:02:03"),  # RFC 1112: the low 23 bits
    "pandar-xt16": ({"destination": "192.168.1.255"}, "ff:ff:ff:ff:ff:ff"),
    "helios-16p": ({"destination": "192.168.1.77", "vlan_id": 4094}, "02:00:c0:a8:01:4d"),
    "os0-32": ({"vlan_id": 1}, None),  # its datagrams leave as fragments
}


def exported(path, with_keys):
    """A few packets of each sensor."""
    sensors = [
        {"name": model, "model": model, "position_m": [0, i, 2], **(keys if with_keys else {})}
        for i, (model, (keys, _)) in enumerate(SENSORS.items())
    ]
    rig = load_rig({"name": "r", "sensors": sensors})
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 5_000_000)))
    save_sidecar_files(path, rig.mounts)
    return rig


def test_frames_as_dpkt_reads_them(tmp_path):
    rig = exported(tmp_path / "a.pcap", True)
    by_host = {mount.host: mount for mount in rig.mounts}
    seen = set()
    with (tmp_path / "a.pcap").open("rb") as file:
        for _, frame in dpkt.pcap.Reader(file):
            ethernet = dpkt.ethernet.Ethernet(frame)
            ip = ethernet.data
            mount = by_host[socket.inet_ntoa(ip.src)]
            keys, mac = SENSORS[mount.name]
            network = mount.sensor.section.values["headers"]
            assert socket.inet_ntoa(ip.dst) == keys.get("destination", network["destination_ip"])
            assert ethernet.dst.hex(":") == (mac or network["destination_mac"])
            assert [tag.id for tag in getattr(ethernet, "vlan_tags", [])] == [keys[k] for k in keys if k == "vlan_id"]
            assert len(frame) == 14 + 4 * ("vlan_id" in keys) + ip.len
            given = ip.sum
            ip.sum = 0
            assert dpkt.ip.IP(bytes(ip)).sum == given
            if isinstance(ip.data, dpkt.udp.UDP) and not ip.mf and ip.data.sum:
                pseudo = ip.src + ip.dst + bytes([0, 17]) + ip.data.ulen.to_bytes(2)
                assert dpkt.in_cksum(pseudo + bytes(ip.data)) == 0
            seen.add(mount.name)
    assert seen == set(SENSORS)
    whole = decode(tmp_path / "a.pcap", rig, on_warning=no_warning)
    plain = decode(tmp_path / "b.pcap", exported(tmp_path / "b.pcap", False), on_warning=no_warning)
    np.testing.assert_array_equal(whole.xyz, plain.xyz)
    np.testing.assert_array_equal(whole.sensor, plain.sensor)


def test_telemetry_says_the_destination(tmp_path):
    """DIFOP packets in bytes 14 to 17, an Ouster's metadata as udp_dest."""
    sensors = [
        {"name": model, "model": model, "position_m": [0, 0, 2 + i], "destination": "10.1.2.3"}
        for i, model in enumerate(("helios-16p", "os0-32"))
    ]
    rig = load_rig({"name": "r", "sensors": sensors})
    path = tmp_path / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 5_000_000)))
    save_sidecar_files(path, rig.mounts)
    (metadata,) = tmp_path.glob("a-os0-32*.json")
    assert '"udp_dest": "10.1.2.3"' in metadata.read_text()
    with path.open("rb") as file:
        found = [dpkt.ethernet.Ethernet(frame).data.data for _, frame in dpkt.pcap.Reader(file)]
    (difop,) = {one.data[14:18] for one in found if isinstance(one, dpkt.udp.UDP) and one.dport == 7788}
    assert difop == bytes([10, 1, 2, 3])


def test_keys_that_are_wrong():
    one = {"name": "a", "model": "vlp-16", "position_m": [0, 0, 2]}
    for keys, what in (
        ({"destination": "here"}, r"destination: 'here' is not an IPv4 address such as"),
        ({"vlan_id": 0}, r"vlan_id: .*1"),
        ({"vlan_id": 4095}, r"vlan_id: .*4094"),
    ):
        with pytest.raises(ConfigError, match=what):
            load_rig({"name": "r", "sensors": [one | keys]})
    rig = load_rig({"name": "r", "sensors": [one | {"destination": "239.0.0.1", "vlan_id": 7}]})
    (said,) = rig_to_dict(rig)["sensors"]
    assert (said["destination"], said["vlan_id"]) == ("239.0.0.1", 7)
    assert load_rig(rig_to_dict(rig)).mounts == rig.mounts
