"""Answers drivers as an Ouster does: its HTTP interface, with the metadata of a capture and a configuration.

Paths, parameters and values are those that ouster-sdk 1.0.1 asks for (`sensor_http_imp.cpp`, `client.cpp`,
`sensor_packet_source.cpp`), of firmware before 3.1 and since. A driver can set where datagrams go and whether the
sensor sends; a capture cannot follow other settings, which are answered with status 400.
"""

import ipaddress
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.geometry import Bytes
from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.emulator import Answer, Emulator, NetworkSite, RequestError, Service, Target
from lidarcfg.packets.ouster.layout import Layout, add_frames, column_values, crc64, packet_headers, values
from lidarcfg.packets.ouster.telemetry import FRAMED_IMU_PACKET, IMU_PACKET, SUFFIX, find_metadata

PORT = 80
API = "/api/v1/"
END = b"\r\n\r\n"  # of a request's head
REQUEST = re.compile(rb"([A-Z]{1,16}) (\S+) HTTP/1\.[01]\r\n")
LENGTH = re.compile(rb"(?im)^content-length:[ \t]*(\d{1,15})[ \t]*\r?$")
CHUNKED = re.compile(rb"(?im)^transfer-encoding:")
OF_THE_SDK = ("ouster-sdk", "user_data", "client_version")  # what ouster-sdk adds to the sensor's metadata
PARTS = ("sensor_info", "beam_intrinsics", "lidar_intrinsics", "lidar_data_format", "config_params")
SUPPORTED = (2, 4)  # firmware, by ouster-sdk 1
VERSION = re.compile(r"v(\d+)\.(\d+)")
PORT_KEYS = ("udp_port_lidar", "udp_port_imu", "udp_port_zm")
HOST_KEYS = ("udp_dest", "udp_dest_zm", "udp_ip")
MODES = ("NORMAL", "STANDBY")
IMU_SIZES = (IMU_PACKET.itemsize, FRAMED_IMU_PACKET.itemsize)
SHOWN_MAX = 80  # characters of a request, on the terminal
Config = Mapping[str, Any]


class RefusedError(Exception):
    """A setting that the sensor does not take."""


@dataclass(frozen=True)
class Request:
    """An HTTP request."""

    method: str
    path: str  # below the interface's
    query: Mapping[str, str]
    body: bytes
    client: str  # the address that sends it

    def flag(self, key: str, default: bool) -> bool:
        """A boolean of its query."""
        return self.query.get(key, str(default)).lower() == "true"

    def __str__(self) -> str:
        return f"{self.method} {API}{self.path}"[:SHOWN_MAX]


class OusterEmulator(Emulator):
    """An Ouster's HTTP interface."""

    def __init__(self, source: PacketSource, packets: Bytes, site: NetworkSite) -> None:
        found = find_metadata(source, packets)
        metadata = json.loads(source.sidecar_files(SUFFIX)[found.name])
        if missing := [part for part in PARTS if not isinstance(metadata.get(part), dict)]:
            what = f"to answer drivers, metadata in the form of firmware 2.4 is needed; there is no {missing[0]}"
            raise PacketError(f"{found.name}: {what}")
        self.name = found.line or "an Ouster"
        self._counter = _Counter(found.layout, packets)
        self.services: Sequence[Service] = (Service("HTTP", "tcp", PORT, self._answer, request_size),)
        self._metadata = {key: value for key, value in metadata.items() if key not in OF_THE_SDK}
        image = str(metadata["sensor_info"].get("image_rev"))
        version = VERSION.search(image)
        if version is None or (int(version[1]), int(version[2])) < SUPPORTED:
            what = 'ouster-sdk 1 needs 2.4, which an export with `ouster: {firmware: "3.2"}` has'
            source.on_warning(f"{found.name}: firmware {version[0] if version else image}: {what}")
        self._ports = {source.port: "udp_port_lidar", metadata["config_params"].get("udp_port_imu"): "udp_port_imu"}
        ports = {key: site.target(port)[1] for port, key in self._ports.items() if port}
        self._active: Config = metadata["config_params"] | ports | {"udp_dest": site.host, "operating_mode": "NORMAL"}
        self._staged = self._active

    def destination(self, port: int) -> Target | None:
        """Where datagrams captured for a port go now; None: the sensor is in standby, or the stream is turned off."""
        config = self._active
        target = config.get(self._ports.get(port, ""), port)
        return (config["udp_dest"], target) if target and config["operating_mode"] == "NORMAL" else None

    def payload(self, captured: bytes, later_ns: int) -> bytes:
        """With stamps and frame numbers that go on: ouster-sdk drops what is older than the last frame."""
        return self._counter.counted(captured, later_ns)

    def _answer(self, request: bytes, client: str) -> Answer:
        head, _, body = request.partition(END)
        line = REQUEST.match(head + b"\r\n")
        assert line
        path, _, parameters = line[2].decode("latin-1").partition("?")
        query = {key: values[-1] for key, values in parse_qs(parameters).items()}
        asked = Request(line[1].decode(), path.removeprefix(API).strip("/"), query, body, client)
        before = self._active
        try:
            value = self._value(asked)
        except RefusedError as error:
            return _response(HTTPStatus.BAD_REQUEST, {"message": str(error)}, f"{error}: refused")
        if value is None:
            unused = asked.path.startswith("zone_monitor")  # which a sensor without zones has not either
            message = "" if unused else f"asks for {asked}, which is not emulated"
            return _response(HTTPStatus.NOT_FOUND, {"message": f"{asked} was not found"}, message)
        changed = {key: new for key, new in self._active.items() if new != before.get(key)}
        message = ", ".join(f"{key} {new}" for key, new in changed.items())
        return _response(HTTPStatus.OK, value, f"sets {message}" if message else "")

    def _value(self, asked: Request) -> object | None:
        """The value whose JSON is the answer's body; None: there is nothing. Raises RefusedError."""
        if asked.path == "sensor/config" and asked.method == "POST":
            return self._configure(_object(asked.body), asked)
        if asked.method != "GET":
            return None
        if asked.path.startswith("sensor/cmd/"):
            return self._command(asked)
        if asked.path == "sensor/metadata" or asked.path.startswith("sensor/metadata/"):
            part = asked.path.removeprefix("sensor/metadata").strip("/")
            metadata = self._metadata | {"config_params": self._active}
            return metadata.get(part) if part else metadata
        if asked.path == "user/data":
            policy = {"policy": "clear_on_config_delete", "value": ""}
            return policy if asked.flag("include_metadata", False) else ""
        others = {
            "sensor/config": self._staged if asked.flag("staging", False) else self._active,
            "system/firmware": {"fw": self._metadata["sensor_info"].get("image_rev")},
        }
        return others.get(asked.path)

    def _command(self, asked: Request) -> object | None:
        """Commands of firmware before 3.1."""
        command = asked.path.removeprefix("sensor/cmd/")
        words = asked.query.get("args", "").split(" ", 1)
        if command == "get_config_param" and words[0] in ("active", "staged"):
            return self._active if words[0] == "active" else self._staged
        if command == "set_config_param" and len(words) == 2:
            settings = words[1] if words[0] == "." else json.dumps({words[0]: _value_of(words[1])})
            self._stage(_object(settings.encode()), asked.client)
            return command
        if command == "set_udp_dest_auto":
            self._stage({"udp_dest": "@auto"}, asked.client)
            return {}
        if command == "reinitialize":
            self._active = self._staged
            return {}
        return {} if command == "save_config_params" else None

    def _configure(self, settings: Config, asked: Request) -> object:
        self._stage(settings, asked.client)
        if asked.flag("reinit", True):
            self._active = self._staged
        return {}

    def _stage(self, settings: Config, client: str) -> None:
        """Stage settings, which `reinit` makes active. Raises RefusedError."""
        taken = {key: client if value == "@auto" and key in HOST_KEYS else value for key, value in settings.items()}
        for key, value in taken.items():
            if not (key in self._staged and value == self._staged[key]) and not _allowed(key, value):
                raise RefusedError(f"sets {key} to {json.dumps(value)[:SHOWN_MAX]}, which the capture does not have")
        self._staged = {**self._staged, **taken}


class _Counter:
    """Lets stamps and frame numbers go on in the later passes of a capture."""

    def __init__(self, layout: Layout, packets: Bytes) -> None:
        self._layout = layout
        self._checksums = bool((values(packets, "<u8", layout.size - 8) == crc64(packets)).all()) and not layout.legacy
        self._later_ns = 0  # of the pass that is sent
        self._before = 0  # frames in the passes before it
        self._frames: list[int] = []  # the first and the last of the pass, as captured

    def counted(self, captured: bytes, later_ns: int) -> bytes:
        """A datagram's payload, so much later."""
        layout = self._layout
        lidar = len(captured) == layout.size
        if later_ns != self._later_ns:
            self._before += (self._frames[-1] - self._frames[0]) % layout.frames + 1 if self._frames else 0
            self._later_ns = later_ns
            self._frames = []
        if not (lidar or (len(captured) in IMU_SIZES and later_ns)):
            return captured
        packet = np.frombuffer(captured, np.uint8).reshape(1, -1).copy()
        if lidar:
            self._frames = [*self._frames[:1], int(packet_headers(layout, packet).frame[0])]
        if not later_ns:
            return captured
        if lidar:
            column_values(layout, packet, "<u8", 0)[:] += np.uint64(later_ns)
        elif len(captured) == IMU_PACKET.itemsize:
            packet.view(IMU_PACKET)["time_ns"] += np.uint64(later_ns)
            return packet.tobytes()
        else:
            packet.view(FRAMED_IMU_PACKET)["measured"]["time_ns"] += np.uint64(later_ns)
        add_frames(layout, packet, self._before)
        if self._checksums:
            values(packet, "<u8", packet.shape[1] - 8)[:] = crc64(packet)
        return packet.tobytes()


def _allowed(key: str, value: object) -> bool:
    """Whether a capture can follow a setting."""
    if key in HOST_KEYS:
        try:
            ipaddress.IPv4Address(value if isinstance(value, str) else "")
        except ValueError:
            return False
        return True
    if key in PORT_KEYS:
        return type(value) is int and 0 <= value <= 65535
    return (key == "operating_mode" and value in MODES) or (key == "auto_start_flag" and value in (0, 1))


def _object(body: bytes) -> Config:
    """The object in JSON. Raises RefusedError."""
    try:
        found = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise RefusedError("sends settings that are no JSON object")
    return found


def _value_of(text: str) -> object:
    """A value in JSON, or a plain word."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def request_size(begun: bytes) -> int | None:
    """The bytes of the HTTP request that begins so; None: its head is not complete. Raises RequestError."""
    line, newline, _ = begun.partition(b"\n")
    if not (REQUEST.fullmatch(line + newline) if newline else re.match(rb"[A-Z]{1,16}( |$)", line)):
        raise RequestError(f"no HTTP request: {line[:20]!r}")
    head, end, _ = begun.partition(END)
    if not end:
        return None
    if CHUNKED.search(head):
        raise RequestError("a request in chunks")
    length = LENGTH.search(head)
    return len(head) + len(END) + (int(length[1]) if length else 0)


def _response(status: HTTPStatus, value: object, message: str) -> Answer:
    body = json.dumps(value).encode()
    head = f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: application/json\r\n"
    length = f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return Answer((head + length).encode() + body, message, close=True)
