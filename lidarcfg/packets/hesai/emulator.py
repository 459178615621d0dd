"""Answers drivers as a Hesai does: PTC on TCP port 9347, with angle corrections, firing times and the inventory.

Frames and commands: HesaiLidar_SDK_2.0 2.0.11 (`PtcClient`, `PtcParser`), big endian. Inventories and error codes:
Nebula (`hesai_cmd_response.hpp`, `hesai_hw_interface.hpp`). A driver can set where datagrams go and whether the sensor
sends; a capture cannot follow other settings, which are answered with an error, as are unknown commands.
"""

import socket
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.emulator import Answer, Emulator, NetworkSite, RequestError, Service, Target
from lidarcfg.packets.hesai.model import HesaiUnit
from lidarcfg.packets.hesai.telemetry import FIRING_TIMES, SUFFIX, correction_lines, find_corrections
from lidarcfg.packets.sensor_unit import SensorUnit

PORT = 9347
START = b"\x47\x74"  # of a frame of PTC 1.0
HEADER = struct.Struct(">2sBBI")  # start, command, return code, bytes of the payload
GET_CORRECTIONS = 0x05
GET_INVENTORY = 0x07
SET_STANDBY = 0x1C
SET_DESTINATION = 0x20
GET_FIRING_TIMES = 0xA9
SETTINGS = {0x17: "the motor's speed", 0x18: "a sync angle", 0x1E: "a return mode", 0x21: "an address", 0x22: "a range"}
OK = 0
INVALID_PARAMETER = 1
UNSUPPORTED = 5


class InventoryEntry(NamedTuple):
    """What an inventory says about a model."""

    number: int
    before: int  # bytes of an AT128's FPGA and of angle offsets before it
    after: int  # bytes after the number of lines: a part number, or reserved


PRODUCTS = {
    "pandar-xt32": InventoryEntry(25, 2, 11),
    "pandar-xt16": InventoryEntry(26, 2, 11),
    "xt32m2x": InventoryEntry(38, 2, 11),
    "qt128": InventoryEntry(32, 4, 33),
    "ot128": InventoryEntry(42, 2, 53),
    "at128e2x": InventoryEntry(48, 66, 11),
    "at128e3x": InventoryEntry(48, 66, 11),
}
INVENTORY = struct.Struct(">18s16s6s16s16s16s16s")  # serial number, date, MAC, versions of software, hardware, firmware


class HesaiEmulator(Emulator):
    """A Hesai's PTC."""

    def __init__(
        self, unit: SensorUnit[Any], source: PacketSource, site: NetworkSite, angles: bytes, firing_times: bytes
    ) -> None:
        self.name = unit.name
        self.services: Sequence[Service] = (Service("PTC", "tcp", PORT, self._answer, request_size),)
        self._unit = unit
        self._site = site
        self._port = source.port
        self._corrections = angles
        self._firing_times = firing_times
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
        }
        if command in readers:
            found = readers[command]()
            return _frame(command, OK, found) if found else _unknown(command, f", which a {self.name} does not have")
        if command == SET_DESTINATION and len(payload) == 8:
            self._target = socket.inet_ntoa(payload[:4]), int.from_bytes(payload[4:6])
            return _frame(command, OK, b"", "sets the destination {}:{}".format(*self._target))
        if command == SET_STANDBY and payload in (b"\0", b"\1"):
            self._standby = payload == b"\1"
            return _frame(command, OK, b"", "sets standby" if self._standby else "ends standby")
        if command in (SET_DESTINATION, SET_STANDBY) or command in SETTINGS:
            what = SETTINGS.get(command, f"what is none by command 0x{command:02X}")
            return _frame(command, INVALID_PARAMETER, b"", f"sets {what}, which the capture does not have: refused")
        return _unknown(command)

    def _inventory(self) -> bytes:
        """The inventory; empty for models whose inventory no source documents."""
        product = PRODUCTS.get(self.name)
        if product is None:
            return b""
        mac = bytes.fromhex(self._unit.facts.headers.mac_prefix.replace(":", "")) + socket.inet_aton(self._site.address)
        base = INVENTORY.pack(b"", b"", mac[:3] + mac[4:], b"", b"", b"", b"")
        model = bytes([product.number, 0, self._unit.count])
        return base + bytes(product.before) + model + bytes(product.after)


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


def corrections(unit: HesaiUnit, source: PacketSource) -> bytes:
    """The angle correction file beside the capture, or one of the model's angles. Raises PacketError."""
    beams = find_corrections(source, unit.count)
    if beams is None:
        what = f"no *{SUFFIX} beside it; drivers get the nominal angles of {unit.name}"
        source.on_warning(f"{source.where}: {what}")
        return "\n".join([*correction_lines(unit), ""]).encode()
    return source.sidecar_files(SUFFIX)[beams.source]


def firing_times(unit: HesaiUnit, source: PacketSource) -> bytes:
    """The firing time file beside the capture, or one of the model's times, in the form of Hesai's; empty: none."""
    files = source.sidecar_files(FIRING_TIMES)
    own = [content for name, content in files.items() if name.endswith(f"-{source.host}-{source.port}{FIRING_TIMES}")]
    if own or len(files) == 1:
        return own[0] if own else next(iter(files.values()))
    firing = unit.facts.firing
    if len(firing.loops) > 1 or unit.facts.packet.protocol != "6.1":
        return b""
    times_us = ((firing.stamp_ns + (offset or 0)) / 1000 for offset in firing.loops[0])
    rows = (f"{channel},{time:g}" for channel, time in enumerate(times_us, 1))
    return "\n".join(["Channel,fire time(us)", *rows, ""]).encode()
