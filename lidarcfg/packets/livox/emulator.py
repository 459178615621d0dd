"""Answers drivers as a Livox does: it is found by broadcast, says what it is, and is told where to send.

What a capture has cannot be changed: another kind of points, another pattern or a narrower field of view is refused.
"""

import socket
import struct
from collections.abc import Sequence

import numpy as np

from lidarcfg.packets.emulator import Answer, Emulator, NetworkSite, RequestError, Service, Target
from lidarcfg.packets.livox import commands
from lidarcfg.packets.livox.commands import Code, Command, CommandFrame, Key, WorkMode
from lidarcfg.packets.livox.layout import HEADER, DataType, crcs, headers_of
from lidarcfg.packets.livox.model import LivoxUnit

FIND_PORT = 56000
PORT_NAMES = {FIND_PORT: "Livox's discovery", 56100: "Livox's commands"}
COMMAND_PORTS = {9: 56100, 10: 56000}  # by type of device: Livox-SDK2 (08f523c), sdk_core/comm/define.h
STATE_PORTS = {9: (56200, 56201), 10: (56000, 56000)}  # the sensor's, the host's
APPLICATION = b"\x01"  # the type of firmware that is not the loader
FIXED = {
    Key.DATA_TYPE: "kind of points",
    Key.PATTERN: "scan pattern",
    Key.PAIRS: "number of returns",
    Key.FOV_ON: "field of view",
}
HOSTS = {Key.STATE_HOST: "its state", Key.POINT_HOST: "points", Key.IMU_HOST: "inertial measurements"}


class LivoxEmulator(Emulator):
    """One Livox, whose packets in the capture hold this kind of points, say this of their time and go to this port."""

    own_ports = True

    def __init__(self, unit: LivoxUnit, kind: DataType, time_type: int, port: int, site: NetworkSite) -> None:
        device = unit.facts.device
        headers = unit.facts.headers
        self.name = unit.name
        self._type = device.type
        self._site = site
        self._point_port = port
        address = socket.inet_aton(site.address)
        self._address = address
        self._serial = f"LIDARCFG{address[3]:06d}".encode()
        host = socket.inet_aton(site.host)
        state_from, state_to = STATE_PORTS.get(device.type, STATE_PORTS[9])
        imu = unit.sensor.ports.telemetry if unit.sensor.ports else port + 100
        points_to = site.target(port)[1]
        imu_to = site.target(imu)[1]
        mac = bytes.fromhex(headers.mac_prefix.replace(":", "")) + address[1:]
        self._values: dict[int, bytes] = {
            Key.DATA_TYPE: bytes([kind]),
            Key.PATTERN: b"\0",
            Key.PAIRS: b"\0",
            Key.POINTS_OFF: b"\0",
            Key.LIDAR_IP: address + bytes([255, 255, 255, 0]) + address[:3] + b"\x01",
            Key.STATE_HOST: commands.host_value(host, state_to, state_from),
            Key.POINT_HOST: commands.host_value(host, points_to, headers.data.source_port or port),
            Key.IMU_HOST: commands.host_value(host, imu_to, headers.imu.source_port or imu),
            Key.LOG_HOST: bytes(8),
            Key.ATTITUDE: bytes(24),
            Key.BLIND_SPOT: bytes(4),
            Key.FOV_0: bytes(20),
            Key.FOV_1: bytes(20),
            Key.FOV_ON: b"\0",
            Key.DETECTION: b"\0",
            Key.IO_LINES: bytes(4),
            Key.WORK_MODE: bytes([WorkMode.SAMPLING]),
            Key.GLASS_HEAT: b"\0",
            Key.IMU_ON: b"\x01",
            Key.SAFETY: b"\0",
            Key.FORCED_HEAT: b"\0",
            Key.SERIAL: self._serial.ljust(commands.SERIAL_MAX, b"\0"),
            Key.PRODUCT: f"{unit.name} of a capture".encode().ljust(64, b"\0"),
            Key.FIRMWARE: bytes(device.firmware),
            Key.LOADER: bytes(4),
            Key.HARDWARE: bytes(4),
            Key.MAC: mac,
            Key.STATE: bytes([WorkMode.SAMPLING]),
            Key.TEMPERATURE: bytes(4),
            Key.POWER_UPS: bytes(4),
            Key.TIME: bytes(8),
            Key.LAST_SYNC: bytes(8),
            Key.TIME_OFFSET: bytes(8),
            Key.SYNC: bytes([time_type]),
            Key.STATUS: bytes(8),
            Key.DIAGNOSIS: bytes(2),
            Key.FLASH: b"\0",
            Key.FIRMWARE_TYPE: APPLICATION,
            Key.FAULTS: bytes(32),
            Key.HEATING: b"\0",
        }
        command_port = COMMAND_PORTS.get(device.type, COMMAND_PORTS[9])
        self._command_port = command_port
        ports = dict.fromkeys((FIND_PORT, command_port, state_from))
        self.services: Sequence[Service] = [
            Service(
                name=PORT_NAMES.get(port, "Livox's state"),
                transport="udp",
                port=port,
                answer=self.answer,
                broadcast=port == FIND_PORT,
                push=self.pushed if port == state_from else None,
            )
            for port in ports
        ]

    def destination(self, port: int) -> Target | None:
        """Where a driver wants points, and other datagrams, which are inertial measurements; in a mode that sends."""
        values = self._values
        if values[Key.WORK_MODE] != bytes([WorkMode.SAMPLING]):
            return None
        points = port == self._point_port
        if (values[Key.POINTS_OFF] != b"\0") if points else (values[Key.IMU_ON] == b"\0"):
            return None
        return _target(values[Key.POINT_HOST if points else Key.IMU_HOST])

    def payload(self, captured: bytes, later_ns: int) -> bytes:
        """The datagram, stamped later."""
        if not later_ns or len(captured) < HEADER.itemsize:
            return captured
        data = np.frombuffer(captured, np.uint8)[None].copy()
        header = headers_of(data)
        header["time_ns"] += np.uint64(later_ns)
        if header["crc"][0]:
            header["crc"] = crcs(data)
        return data.tobytes()

    def answer(self, request: bytes, client: str) -> Answer:
        """The answer to a command. Raises RequestError for what is none."""
        try:
            frame = commands.unpack(request)
        except ValueError as error:
            raise RequestError(str(error)) from None
        if frame.kind != commands.REQUEST or frame.sender != commands.HOST:
            return Answer(b"")  # another sensor's
        data, message = self._handled(frame)
        answer = CommandFrame(frame.number, frame.command, commands.ACKNOWLEDGEMENT, commands.SENSOR, data)
        return Answer(commands.pack(answer), message)

    def pushed(self) -> tuple[bytes, Target]:
        """The state that the sensor reports once a second, and where it goes."""
        data = commands.set_data(self._values)
        frame = CommandFrame(0, Command.PUSH, commands.REQUEST, commands.SENSOR, data)
        return commands.pack(frame), _target(self._values[Key.STATE_HOST])

    def _handled(self, frame: CommandFrame) -> tuple[bytes, str]:
        """The data of the answer, and a line for the terminal."""
        if frame.command == Command.FIND:
            found = commands.FOUND.pack(Code.DONE, self._type, self._serial, self._address, self._command_port)
            return found, "finds it"
        if frame.command == Command.GET:
            return self._get(frame.data)
        if frame.command == Command.SET:
            return self._set(frame.data)
        what = f"0x{frame.command:04X}"
        if frame.command in (Command.REBOOT, Command.RESET):
            what = f"{Command(frame.command).name.lower()}"
        return bytes([Code.FAILED]), f"sends the command {what}, which a capture cannot do"

    def _get(self, data: bytes) -> tuple[bytes, str]:
        try:
            keys = commands.keys_of(data)
        except ValueError as error:
            return commands.get_answer(Code.WRONG_LIST, []), f"asks for {error}"
        values = self._values
        unknown = [key for key in keys if key not in values]
        message = f"asks for {', '.join(f'0x{key:04X}' for key in unknown)}, which are not known" if unknown else ""
        return commands.get_answer(Code.DONE, [(key, values[key]) for key in keys if key in values]), message

    def _set(self, data: bytes) -> tuple[bytes, str]:
        """Set all parameters, or none."""
        try:
            asked = commands.values_of(data)
        except ValueError as error:
            return commands.set_answer(Code.WRONG_LIST), f"sets {error}"
        values = dict(self._values)
        said = []
        for key, value in asked:
            code, what = self._checked(key, value)
            if code != Code.DONE:
                return commands.set_answer(code, key), what
            if values.get(key) != value and what:
                said.append(what)
            values[key] = value
            if key == Key.WORK_MODE:
                values[Key.STATE] = value
        self._values = values
        return commands.set_answer(Code.DONE), "; ".join(said)

    def _checked(self, key: int, value: bytes) -> tuple[Code, str]:
        """Whether a parameter may get a value, and a line for the terminal."""
        name = f"0x{key:04X}"
        if key >= commands.READ_ONLY:
            return Code.READ_ONLY, f"sets {name}, which can only be read"
        if key in self._values and len(value) != len(self._values[key]):
            what = f"sets {name} to {len(value)} bytes; allowed: {len(self._values[key])}"
            return Code.WRONG_LENGTH, what
        if key in FIXED and value != self._values[key]:
            return Code.NOT_NOW, f"asks for another {FIXED[Key(key)]}: {value.hex()}; the capture has one only"
        if key == Key.LIDAR_IP and value != self._values[key]:
            return Code.NOT_NOW, f"wants the address {socket.inet_ntoa(value[:4])}, which is not changed"
        if key == Key.WORK_MODE and value[0] not in set(WorkMode):
            return Code.OUT_OF_RANGE, f"asks for the work mode {value[0]}; allowed: 1, 2, 9"
        if key == Key.WORK_MODE:
            return Code.DONE, f"asks for the work mode {WorkMode(value[0]).name.lower()}"
        if key in HOSTS:
            address, port = _target(value)
            return Code.DONE, f"wants {HOSTS[Key(key)]} sent to {address}:{port}"
        return Code.DONE, f"sets {name} to {value.hex()}, which changes nothing here" if key not in self._values else ""


def _target(value: bytes) -> Target:
    """The host in the value of a key."""
    return socket.inet_ntoa(value[:4]), int(struct.unpack_from("<H", value, 4)[0])
