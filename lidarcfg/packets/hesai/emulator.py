"""Answers drivers as a Hesai does: PTC on TCP port 9347.

Frames and commands: HesaiLidar_SDK_2.0 2.0.11 (`PtcClient`, `PtcParser`), big endian. Inventories, configuration,
status, PTP and error codes: Nebula (`hesai_cmd_response.hpp`, `hesai_hw_interface.cpp`). A driver can set where
datagrams go, whether the sensor sends, and PTP. What it sets as the capture has it anyway is confirmed; other settings
are answered with an error, as are unknown commands. Temperatures and other states that nothing says are 0.
"""

import socket
import struct
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.emulator import Answer, Emulator, NetworkSite, RequestError, Service, Target
from lidarcfg.packets.hesai.layout import (
    DUAL,
    FIRST,
    FIRST_AND_LAST,
    FIRST_AND_STRONGEST,
    HIGH_RESOLUTION,
    LAST,
    STRONGEST,
    Packets,
)
from lidarcfg.packets.hesai.model import HesaiUnit
from lidarcfg.packets.hesai.telemetry import (
    SUFFIX,
    correction_lines,
    find_corrections,
    find_firing_times,
    firing_times_lines,
)

PORT = 9347
START = b"\x47\x74"  # of a frame of PTC 1.0
HEADER = struct.Struct(">2sBBI")  # start, command, return code, bytes of the payload
GET_CORRECTIONS = 0x05
GET_PTP_DIAGNOSTICS = 0x06
GET_INVENTORY = 0x07
GET_CONFIG = 0x08
GET_STATUS = 0x09
SET_SPEED = 0x17
SET_SYNC_ANGLE = 0x18
SET_STANDBY = 0x1C
SET_RETURN_MODE = 0x1E
SET_CLOCK = 0x1F
SET_DESTINATION = 0x20
SET_RANGE = 0x22
GET_RANGE = 0x23
SET_PTP = 0x24
GET_PTP = 0x26
GET_RESOLUTION = 0x28
SET_RESOLUTION = 0x29
SET_PTP_LOCK = 0x39
GET_PTP_LOCK = 0x3A
GET_FIRING_TIMES = 0xA9
SETTINGS = {  # that a capture cannot follow
    SET_SPEED: "the motor's speed",
    SET_SYNC_ANGLE: "a sync angle",
    SET_RETURN_MODE: "a return mode",
    SET_CLOCK: "a clock",
    0x21: "an address",
    SET_RANGE: "a range",
    SET_RESOLUTION: "a resolution",
}
RETURN_MODES = {LAST: 0, STRONGEST: 1, DUAL: 2, FIRST: 3, FIRST_AND_LAST: 4, FIRST_AND_STRONGEST: 5}  # Nebula
CONFIG = struct.Struct(">4s4s4s4sHHHBHHHBBBBBBBH9x")
MASK = b"\xff\xff\xff\0"
GPS_PORT = 10110
ALL_AROUND = 3600  # tenths of a degree
CLOCK_PTP = 1
STATUS = struct.Struct(">IH")  # seconds since the start, rpm; then temperatures
STATES = struct.Struct(">BBiiB5x")  # GPS: PPS and GPRMC; starts, minutes in operation, PTP
LOCKED = 2
PTP_STATUS = struct.Struct(">qii")  # offset from the master in ns, state, ms since
PORT_DATA = struct.Struct(">8sHBbqbBbBbB")
TIME_STATUS = struct.Struct(">qqiiH12xi8s")
GRANDMASTER = struct.Struct(">ihbb")
SLAVE = 9  # linuxptp's port state
PTP_VERSION = 2
AUTOMOTIVE = b"\1\3\0\1\1"  # on; profile, domain, L2, switch: an OT128's
IEEE_1588 = b"\1\0\0\0\1\1\0"  # on; profile, domain, UDP/IP, three intervals
PTP_LOCK_US = b"\1"
OK = 0
INVALID_PARAMETER = 1
UNSUPPORTED = 5


class InventoryEntry(NamedTuple):
    """What an inventory says about a model."""

    number: int
    before: int  # bytes of angle offsets before it
    after: int  # bytes after the number of lines: a part number, or reserved


PRODUCTS = {
    "pandar-xt32": InventoryEntry(25, 2, 11),
    "pandar-xt16": InventoryEntry(26, 2, 11),
    "xt32m2x": InventoryEntry(38, 2, 11),
    "qt128": InventoryEntry(32, 4, 33),
    "ot128": InventoryEntry(42, 2, 53),
    "pandar128": InventoryEntry(3, 2, 11),
}
INVENTORY = struct.Struct(">18s16s6s16s16s16s16s")  # serial number, date, MAC, versions of software, hardware, firmware


class HesaiEmulator(Emulator):
    """A Hesai's PTC."""

    def __init__(self, unit: HesaiUnit, source: PacketSource, packets: Packets, site: NetworkSite) -> None:
        self.name = unit.name
        self.services: Sequence[Service] = (Service("PTC", "tcp", PORT, self._answer, request_size),)
        self._unit = unit
        self._site = site
        self._port = source.port
        self._address = socket.inet_aton(site.address)
        self._corrections = _corrections(unit, source)
        self._firing_times = _firing_times(unit, source)
        self._rpm = round(float(np.median(packets["tail"]["rpm"])) * unit.facts.packet.speed_unit_rpm)
        self._return_mode = RETURN_MODES.get(int(np.median(packets["tail"]["return_mode"])), 0)
        self._high_resolution = _is_high(unit, packets)
        self._began_s = time.monotonic()
        self._ptp = AUTOMOTIVE if unit.facts.packet.protocol == "1.4" else IEEE_1588
        self._ptp_lock = PTP_LOCK_US
        self._target: Target | None = None  # of the lidar's datagrams, once a driver has said it
        self._standby = False

    def destination(self, port: int) -> Target | None:
        """Where datagrams captured for a port go now; None: the sensor is in standby."""
        if self._standby:
            return None
        return self._target if self._target and port == self._port else self._site.target(port)

    def _answer(self, request: bytes, client: str) -> Answer:
        command = request[2]
        payload = request[HEADER.size :]
        readers: dict[int, Callable[[], bytes]] = {
            GET_CORRECTIONS: lambda: self._corrections,
            GET_FIRING_TIMES: lambda: self._firing_times,
            GET_INVENTORY: self._inventory,
            GET_CONFIG: self._config,
            GET_STATUS: self._status,
            GET_RANGE: lambda: struct.pack(">BHH", 0, 0, ALL_AROUND),
            GET_PTP: lambda: self._ptp,
            GET_PTP_LOCK: lambda: self._ptp_lock,
            GET_RESOLUTION: lambda: bytes([self._high_resolution]),
        }
        if command in readers:
            found = readers[command]()
            return _frame(command, OK, found) if found else _unknown(command, f", which a {self.name} does not have")
        if command == GET_PTP_DIAGNOSTICS:
            found = self._diagnostics(payload)
            return _frame(command, OK if found else INVALID_PARAMETER, found)
        return self._set(command, payload)

    def _set(self, command: int, payload: bytes) -> Answer:
        """The answer to a command that sets something."""
        if command == SET_DESTINATION and len(payload) == 8:
            self._target = socket.inet_ntoa(payload[:4]), int.from_bytes(payload[4:6])
            return _frame(command, OK, b"", "sets the destination {}:{}".format(*self._target))
        if command == SET_STANDBY and payload in (b"\0", b"\1"):
            self._standby = payload == b"\1"
            return _frame(command, OK, b"", "sets standby" if self._standby else "ends standby")
        if command == SET_PTP and len(payload) in (len(AUTOMOTIVE) - 1, len(IEEE_1588) - 1):
            self._ptp = b"\1" + payload
            return _frame(command, OK, b"", "sets PTP")
        if command == SET_PTP_LOCK and len(payload) == 1:
            self._ptp_lock = payload
            return _frame(command, OK, b"", "sets PTP")
        if payload in self._as_captured(command):
            return _frame(command, OK, b"")
        if command in (SET_DESTINATION, SET_STANDBY, SET_PTP, SET_PTP_LOCK) or command in SETTINGS:
            what = SETTINGS.get(command, f"what is none by command 0x{command:02X}")
            return _frame(command, INVALID_PARAMETER, b"", f"sets {what}, which the capture does not have: refused")
        return _unknown(command)

    def _as_captured(self, command: int) -> Sequence[bytes]:
        """What a command may set because it is so anyway."""
        return {
            SET_SPEED: [struct.pack(">H", self._rpm)],
            SET_RETURN_MODE: [bytes([self._return_mode])],
            SET_SYNC_ANGLE: [struct.pack(">BH", on, 0) for on in (0, 1)],
            SET_CLOCK: [bytes([CLOCK_PTP])],
            SET_RANGE: [struct.pack(">BHH", 0, 0, ALL_AROUND)],
            SET_RESOLUTION: [bytes([self._high_resolution])],
        }.get(command, [])

    @property
    def _mac(self) -> bytes:
        return bytes.fromhex(self._unit.facts.headers.mac_prefix.replace(":", "")) + self._address[1:]

    def _inventory(self) -> bytes:
        """The inventory; empty for models whose inventory no source documents."""
        product = PRODUCTS.get(self.name)
        if product is None:
            return b""
        base = INVENTORY.pack(b"", b"", self._mac, b"", b"", b"", b"")
        model = bytes([product.number, 0, self._unit.count])
        return base + bytes(product.before) + model + bytes(product.after)

    def _config(self) -> bytes:
        host, port = self._target or self._site.target(self._port)
        addresses = self._address, MASK, self._address[:3] + b"\1", socket.inet_aton(host)
        speed_and_range = self._rpm, 0, 0, 0, ALL_AROUND
        modes = CLOCK_PTP, 1, 0, self._return_mode, self._standby, 0
        return CONFIG.pack(*addresses, port, GPS_PORT, *speed_and_range, *modes, 0, 0)

    def _status(self) -> bytes:
        temperatures = 9 if self._unit.facts.packet.protocol == "3.2" else 8
        since_s = int(time.monotonic() - self._began_s)
        return STATUS.pack(since_s, self._rpm) + bytes(4 * temperatures) + STATES.pack(0, 0, 1, 0, LOCKED)

    def _diagnostics(self, query: bytes) -> bytes:
        """What PTP says of itself: locked to a clock without offset; empty for a query that is none."""
        identity = self._mac[:3] + b"\xff\xfe" + self._mac[3:]
        found: dict[bytes, bytes] = {
            b"\1": PTP_STATUS.pack(0, LOCKED, 0),
            b"\2": PORT_DATA.pack(identity, 1, SLAVE, 0, 0, 1, 3, 0, 1, 0, PTP_VERSION),
            b"\3": TIME_STATUS.pack(0, 0, 0, 0, 0, 1, bytes(8)),
            b"\4": GRANDMASTER.pack(0, 0, 0, 0),
        }
        return found.get(query, b"")


def request_size(begun: bytes) -> int | None:
    """The bytes of the PTC frame that begins so; None: more is needed. Raises RequestError."""
    if not START.startswith(begun[:2]):
        raise RequestError(f"no frame of PTC 1.0: {begun[: HEADER.size].hex(' ')}")
    if len(begun) < HEADER.size:
        return None
    *_, length = HEADER.unpack_from(begun)
    return HEADER.size + int(length)


def _frame(command: int, code: int, payload: bytes, message: str = "") -> Answer:
    return Answer(HEADER.pack(START, command, code, len(payload)) + payload, message)


def _unknown(command: int, why: str = "") -> Answer:
    return _frame(command, UNSUPPORTED, b"", f"asks for PTC command 0x{command:02X}, which is not emulated{why}")


def _is_high(unit: HesaiUnit, packets: Packets) -> bool:
    """Whether the packets are of the high resolution, which those of protocol 1.4 say."""
    if unit.facts.high_resolution is None:
        return False
    return bool(np.median(packets["operational_state"]) == HIGH_RESOLUTION)


def _corrections(unit: HesaiUnit, source: PacketSource) -> bytes:
    """The angle correction file beside the capture, or one of the model's angles. Raises PacketError."""
    beams = find_corrections(source, unit.count)
    if beams is None:
        what = f"no *{SUFFIX} beside it; drivers get the nominal angles of {unit.name}"
        source.on_warning(f"{source.where}: {what}")
        return "\n".join([*correction_lines(unit), ""]).encode()
    return source.sidecar_files(SUFFIX)[beams.source]


def _firing_times(unit: HesaiUnit, source: PacketSource) -> bytes:
    """The source's firing time file beside the capture, or one of the model's times."""
    return find_firing_times(source) or "\n".join([*firing_times_lines(unit), ""]).encode()
