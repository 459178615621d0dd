"""Answers drivers as a Seyond does: commands over HTTP on TCP port 8010.

Commands and the form of answers: Seyond-Inc/inno-lidar-sdk 3.103.4, src/sdk_client/lidar_client_communication.cpp and
src/utils/net_manager.cpp, which asks where datagrams go, has them sent to itself, and fetches a Robin W's angles. A
driver can set where datagrams go; a capture cannot follow other settings, which are answered with status 400.
"""

import re
from collections.abc import Sequence
from http import HTTPStatus

import numpy as np

from lidarcfg.geometry import Bytes
from lidarcfg.packets.emulator import Answer, Emulator, NetworkSite, RequestError, Service, Target
from lidarcfg.packets.seyond.decode import PacketForm, matches
from lidarcfg.packets.seyond.layout import NORMAL, WORKING, Packets, crcs, headers_of
from lidarcfg.packets.seyond.model import SeyondUnit
from lidarcfg.packets.seyond.telemetry import table_packet
from lidarcfg.units import SECOND_NS

PORT = 8010
END = b"\r\n\r\n"  # of a request
REQUEST = re.compile(rb"GET (\S{1,1024}) HTTP/1\.[01]\r\n")
REQUEST_MAX = 4096  # bytes
COMMAND = re.compile(r"/command/\?(get|set)_(\w{1,64})(?:=(.{0,256}))?")
REFLECTANCE = 2  # the mode in which points have reflectances
NUMBERS = 2**16  # of packets


class SeyondEmulator(Emulator):
    """A Seyond's HTTP interface."""

    def __init__(self, unit: SeyondUnit, form: PacketForm, port: int, table: Packets | None, site: NetworkSite) -> None:
        self.name = unit.name
        self.services: Sequence[Service] = (Service("HTTP", "tcp", PORT, self._answer, request_size),)
        self._table = b"" if table is None else table_packet(unit, table).tobytes()
        self._port = port
        self._site = site
        self._target: Target | None = None  # of all datagrams, once a driver has said it
        self._counter = _PassCounter()
        self._values = {
            "mode_status": f"{WORKING},{WORKING},{NORMAL},0",
            "mode": str(WORKING),
            "return_mode": str(form.mode),
            "reflectance_mode": str(REFLECTANCE),
            "roi": "0.0,0.0",
            "frame_rate": f"{SECOND_NS / unit.sensor.pattern.frame_ns:g}",
            "status_interval_ms": "50",  # inno_lidar_packet.h
            "lidar_id": "0",
            "debug": "0",
            "model": unit.name,
            **dict.fromkeys(("sn", "sw_version", "fw_version", "fw_state", "command_line"), ""),
        }

    def destination(self, port: int) -> Target:
        """Where datagrams captured for a port go now."""
        return self._target or self._site.target(port)

    def payload(self, captured: bytes, later_ns: int) -> bytes:
        """With stamps and numbers that go on: the SDK drops frames that it has had."""
        return self._counter.counted(captured, later_ns)

    def _answer(self, request: bytes, client: str) -> Answer:
        line = REQUEST.match(request)
        assert line
        path = line[1].decode("latin-1")
        asked = COMMAND.fullmatch(path)
        if asked is None:
            return _response(HTTPStatus.NOT_FOUND, b"", f"asks for {path[:80]}, which is not emulated")
        action, name, value = asked.groups()
        return self._set(name, value or "", client) if action == "set" else self._get(name)

    def _get(self, name: str) -> Answer:
        if name == "anglehv_table" and self._table:
            return _response(HTTPStatus.OK, self._table)
        if name == "udp_ports_ip":
            host, port = self.destination(self._port)
            return _response(HTTPStatus.OK, f"{port},{port},{port},{host}".encode())
        if name in self._values:
            return _response(HTTPStatus.OK, self._values[name].encode())
        return _response(HTTPStatus.NOT_FOUND, b"", f"asks for {name}, which is not emulated")

    def _set(self, name: str, value: str, client: str) -> Answer:
        if name == "udp_ports_ip":
            port, _, _ = value.partition(",")
            if not port.isdecimal() or not 1 <= int(port) <= 65535:
                return _response(HTTPStatus.BAD_REQUEST, b"", f"sets ports {value}: refused; allowed: 1 to 65535")
            self._target = client, int(port)
            return _response(HTTPStatus.OK, b"", f"wants all datagrams sent to {client}:{int(port)}")
        if self._values.get(name) == value:
            return _response(HTTPStatus.OK, b"")
        what = f"sets {name} to {value[:80]}, which the capture does not have: refused"
        return _response(HTTPStatus.BAD_REQUEST, b"", what)


class _PassCounter:
    """Lets stamps, frames and numbers go on in the later passes of a capture."""

    def __init__(self) -> None:
        self._later_ns = 0  # of the pass that is sent
        self._frames = 0  # in the passes before it
        self._packets = 0
        self._seen: list[tuple[int, int]] = []  # frame and number of its first packet and of its last, as captured

    def counted(self, captured: bytes, later_ns: int) -> bytes:
        """A datagram's payload, so much later."""
        if not matches(len(captured), captured):
            return captured
        packet: Bytes = np.frombuffer(captured, np.uint8).reshape(1, -1).copy()
        header = headers_of(packet)
        if later_ns != self._later_ns and self._seen:
            (frame, number), (last_frame, last_number) = self._seen[0], self._seen[-1]
            self._frames += last_frame - frame + 1
            self._packets += last_number - number + 1
            self._later_ns = later_ns
            self._seen = []
        self._seen = [*self._seen[:1], (int(header["frame"][0]), int(header["sequence"][0]))]
        if not later_ns:
            return captured
        frame, number = self._seen[-1]
        header["frame"] = (frame + self._frames) % 2**64
        header["sequence"] = (number + self._packets) % NUMBERS
        header["start_us"] += later_ns / 1000
        header["crc"] = crcs(packet)
        return packet.tobytes()


def request_size(begun: bytes) -> int | None:
    """The bytes of the HTTP request that begins so; None: its head is not complete. Raises RequestError."""
    line, newline, _ = begun.partition(b"\n")
    if not (REQUEST.fullmatch(line + newline) if newline else re.match(rb"G(E(T( .*)?)?)?$", line)):
        raise RequestError(f"no HTTP request: {line[:20]!r}")
    head, end, _ = begun.partition(END)
    if len(head) > REQUEST_MAX:
        raise RequestError(f"a request of more than {REQUEST_MAX} bytes")
    return len(head) + len(END) if end else None


def _response(status: HTTPStatus, body: bytes, message: str = "") -> Answer:
    head = f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return Answer(head.encode() + body, message, close=True)
