"""What packets say of the sensor's clock, at the bytes where the makers have it."""

import functools
import operator

import dpkt
import numpy as np
import pytest
from ouster.sdk import core

from lidarcfg.capture.export import check_exportable, in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.rig import load_rig, rig_to_dict
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET

CLOCKS = "ptp", "gps", "free"


def rig_of(model, clock):
    keys = {"clock": clock} if clock else {}
    return load_rig({"name": "r", "sensors": [{"name": "a", "model": model, "position_m": [0, 0, 2], **keys}]})


def sent(folder, model, clock):
    """The payloads of a few milliseconds, by port."""
    rig = rig_of(model, clock)
    path = folder / "a.pcap"
    write_pcap(path, in_time_order(simulated_packets(rig, load_scene(STREET), np.eye(4), 5_000_000)))
    save_sidecar_files(path, rig.mounts)
    found = {}
    with path.open("rb") as file:
        for _, frame in dpkt.pcap.Reader(file):
            udp = dpkt.ethernet.Ethernet(frame).data.data
            if isinstance(udp, dpkt.udp.UDP):
                found.setdefault(udp.dport, []).append(bytes(udp.data))
    return found


def check_sentence(text):
    """A fix, with the checksum of NMEA 0183: all between $ and * by exclusive or."""
    body, _, checksum = text.removeprefix(b"$").partition(b"*")
    assert body.split(b",")[0] == b"GPRMC"
    assert body.split(b",")[2] == b"A"
    assert functools.reduce(operator.xor, body) == int(checksum[:2], 16)


@pytest.mark.parametrize(("clock", "pps"), [(None, 2), ("gps", 2), ("free", 0)])
def test_velodyne(clock, pps, tmp_path):
    """VLP-16 User Manual, table 9-7: 0xCA holds the pulse's state, 0xCE the sentence."""
    position = sent(tmp_path, "vlp-16", clock)[8308][0]
    assert position[0xCA] == pps
    if clock != "free":
        check_sentence(position[0xCE:].split(b"\0")[0])


@pytest.mark.parametrize(("clock", "mode", "state"), [(None, 2, 2), ("ptp", 2, 2), ("gps", 0, 1), ("free", 2, 0)])
def test_helios(clock, mode, state, tmp_path):
    """Nebula's helios.hpp: 0 is GPS, 2 P2P; 0 not synchronised, 1 by GPS, 2 by PTP. The sentence has 86 bytes."""
    difop = sent(tmp_path, "helios-16p", clock)[7788][0]
    assert (difop[301], difop[302]) == (mode, state)
    sentence = difop[382 : 382 + 86].rstrip(b"\0")
    if clock == "gps":
        check_sentence(sentence)
    else:
        assert sentence == b""


@pytest.mark.parametrize(("clock", "kind"), [(None, 1), ("ptp", 1), ("gps", 2), ("free", 0)])
def test_livox(clock, kind, tmp_path):
    """livox_lidar_def.h: time_type is byte 11 of points and of inertial measurements."""
    by_port = sent(tmp_path, "mid-360", clock)
    assert len(by_port) == 2
    assert {payload[11] for payloads in by_port.values() for payload in payloads} == {kind}


@pytest.mark.parametrize(
    ("clock", "mode"),
    [
        (None, "TIME_FROM_PTP_1588"),
        ("ptp", "TIME_FROM_PTP_1588"),
        ("gps", "TIME_FROM_SYNC_PULSE_IN"),
        ("free", "TIME_FROM_INTERNAL_OSC"),
    ],
)
def test_ouster(clock, mode, tmp_path):
    """As ouster-sdk reads the metadata."""
    sent(tmp_path, "os0-32", clock)
    (metadata,) = tmp_path.glob("*.json")
    config = core.SensorInfo(metadata.read_text()).config
    assert config.timestamp_mode == getattr(core.TimestampMode, mode)


def test_clocks_of_which_packets_say_nothing():
    for model, clock in (("vlp-16", "ptp"), ("airy", "gps"), ("pandar-xt32", "gps"), ("ot128", "free")):
        (mount,) = rig_of(model, clock).mounts
        with pytest.raises(ConfigError, match=rf"clock: '{clock}' is not allowed; packets of a {model} say "):
            check_exportable(mount, 10**9)
    with pytest.raises(ConfigError, match=r"clock: .*'ptp', 'gps' or 'free'"):
        rig_of("vlp-16", "ntp")
    rig = rig_of("os0-32", "gps")
    assert load_rig(rig_to_dict(rig)).mounts == rig.mounts
