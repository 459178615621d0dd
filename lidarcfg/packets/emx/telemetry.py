"""DIFOP packets, in which a sensor says once a second how it is and which elevations its pixels have."""

from collections.abc import Iterator

import numpy as np

from lidarcfg.geometry import Bytes, Times
from lidarcfg.packets.codec import PacketSource, Payloads
from lidarcfg.packets.emx.layout import (
    ANGLES,
    ANGLES_ID,
    MODES,
    NORMAL_MODE,
    ROWS,
    STATE,
    STATE_ID,
    SURFACES,
    VCSELS,
    Packets,
    bytes_of,
    write_time,
)
from lidarcfg.packets.emx.model import EmxUnit
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS

PIECES = 16  # of a capture, in one of which the angles should be: 4 MB each, 5 s in all
PITCH_MAX = 18000  # 90 degrees


def difop_payloads(unit: EmxUnit, mount: Mount, start_ns: int, due_ns: range) -> Iterator[Payloads]:
    """The DIFOP packets of a sensor, the first before anything else and one of each kind a second from then on."""
    headers = unit.facts.headers
    first, end = (-(-at_ns // SECOND_NS) for at_ns in (due_ns.start, due_ns.stop))
    times_ns = start_ns + np.arange(first, end) * SECOND_NS
    sent_ns = times_ns // 1000 * 1000
    for kind in (state_packets(unit, mount, times_ns), angles_packets(unit, times_ns)):
        yield Payloads(sent_ns, bytes_of(kind), mount.telemetry_port, headers, headers.difop, first)


def state_packets(unit: EmxUnit, mount: Mount, times_ns: Times) -> Packets:
    """The packets (n,) of these times (n,) that say how the sensor is."""
    packets: Packets = np.zeros(len(times_ns), STATE)
    headers = unit.facts.headers
    facts = unit.facts.difop
    host = [int(part) for part in mount.host.split(".")]
    receiver = [int(part) for part in (mount.destination or headers.destination_ip).split(".")]
    packets["id"] = STATE_ID
    packets["software"] = list(bytes.fromhex(facts.software))
    packets["hardware"] = list(bytes.fromhex(facts.hardware))
    packets["serial"] = f"LIDARCFG{host[3]:06d}".encode()
    packets["work_mode"] = NORMAL_MODE
    packets["frame_rate"] = SECOND_NS // unit.sensor.pattern.frame_ns
    packets["return_mode"] = MODES[mount.return_mode]
    packets["clock"] = unit.facts.packet.clock
    packets["clock_state"] = 1  # synchronised
    write_time(packets, times_ns)
    packets["host"] = host
    packets["netmask"] = 255, 255, 255, 0
    packets["mac"] = [*bytes.fromhex(headers.mac_prefix.replace(":", "")), *host[1:]]
    packets["msop_to"] = receiver
    packets["msop_ports"] = mount.data_port
    packets["difop_to"] = receiver
    packets["difop_ports"] = mount.telemetry_port
    packets["length"] = STATE.itemsize
    return packets


def angles_packets(unit: EmxUnit, times_ns: Times) -> Packets:
    """The packets (n,) of these times (n,) that say the elevations."""
    packets: Packets = np.zeros(len(times_ns), ANGLES)
    packets["id"] = ANGLES_ID
    packets["surfaces"] = SURFACES
    packets["pixels"] = ROWS // VCSELS
    packets["vcsels"] = VCSELS
    packets["pitch"] = unit.pitch
    packets["length"] = ANGLES.itemsize
    return packets


class PitchSearch:
    """The elevations that a host's DIFOP packets say: these have no port, so a host has one sensor."""

    def __init__(self) -> None:
        self.found: set[bytes] = set()

    def add(self, packets: Bytes) -> None:
        rows = np.ascontiguousarray(packets[(packets[:, :4] == list(ANGLES_ID)).all(axis=1)])
        pitch = rows.view(ANGLES)[:, 0]["pitch"]
        good = (abs(pitch.astype(np.int64)) <= PITCH_MAX).all(axis=1) & pitch.any(axis=1)
        self.found.update(row.tobytes() for row in pitch[good])


def find_pitch(source: PacketSource) -> Times | None:
    """(192,) the elevations in a source's DIFOP packets near the capture's start; None without one, or of several."""
    for found, _ in zip(source.search(PitchSearch, ANGLES.itemsize), range(PIECES), strict=False):
        if found.found:
            break
    if len(found.found) != 1:
        return None
    return np.frombuffer(next(iter(found.found)), ">i2").astype(np.int64)
