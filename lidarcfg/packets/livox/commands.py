"""The commands by which a driver finds and configures a Livox, and its answers: bytes.

Layout: Livox-SDK2 (08f523c), sdk_core/comm/sdk_protocol.cpp and define.h, sdk_core/command_handler/build_request.cpp,
include/livox_lidar_def.h. Return codes: Livox's wiki, Mid-360 protocol. All is little endian.
"""

import binascii
import struct
import zlib
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

START = 0xAA
VERSION = 0
HEAD = struct.Struct("<BBHIHBB6sH")  # start, version, length, number, command, type, sender, reserved, CRC-16
CHECKED = 18  # bytes that the CRC-16 covers
HEADER = HEAD.size + 4  # with the CRC-32 of the data behind it
REQUEST = 0  # types
ACKNOWLEDGEMENT = 1
HOST = 0  # senders
SENSOR = 1
FOUND = struct.Struct("<BB16s4sH")  # return code, type of device, serial number, address, command port
SERIAL_MAX = 16


class Command(IntEnum):
    """What is asked for."""

    FIND = 0x0000
    SET = 0x0100
    GET = 0x0101
    PUSH = 0x0102  # the sensor's own, once a second
    REBOOT = 0x0200
    RESET = 0x0201


class Key(IntEnum):
    """Some of a sensor's parameters; those from 0x8000 on are read only."""

    DATA_TYPE = 0x0000
    PATTERN = 0x0001
    PAIRS = 0x0002
    POINTS_OFF = 0x0003
    LIDAR_IP = 0x0004
    STATE_HOST = 0x0005
    POINT_HOST = 0x0006
    IMU_HOST = 0x0007
    LOG_HOST = 0x0009
    ATTITUDE = 0x0012
    BLIND_SPOT = 0x0013
    FOV_0 = 0x0015
    FOV_1 = 0x0016
    FOV_ON = 0x0017
    DETECTION = 0x0018
    IO_LINES = 0x0019
    WORK_MODE = 0x001A
    GLASS_HEAT = 0x001B
    IMU_ON = 0x001C
    SAFETY = 0x001D
    FORCED_HEAT = 0x001E
    SERIAL = 0x8000
    PRODUCT = 0x8001
    FIRMWARE = 0x8002
    LOADER = 0x8003
    HARDWARE = 0x8004
    MAC = 0x8005
    STATE = 0x8006
    TEMPERATURE = 0x8007
    POWER_UPS = 0x8008
    TIME = 0x8009
    LAST_SYNC = 0x800A
    TIME_OFFSET = 0x800B
    SYNC = 0x800C
    STATUS = 0x800D
    DIAGNOSIS = 0x800E
    FLASH = 0x800F
    FIRMWARE_TYPE = 0x8010
    FAULTS = 0x8011
    HEATING = 0x8012


READ_ONLY = 0x8000  # the first key of those


class Code(IntEnum):
    """How a command went."""

    DONE = 0x00
    FAILED = 0x01
    NOT_NOW = 0x02  # the state does not allow it
    OUT_OF_RANGE = 0x03
    UNKNOWN_KEY = 0x20
    READ_ONLY = 0x22
    WRONG_LENGTH = 0x23
    WRONG_LIST = 0x24  # the number of keys is not that of the list


class WorkMode(IntEnum):
    """What the sensor does."""

    SAMPLING = 1
    IDLE = 2
    READY = 9


class CommandFrame(NamedTuple):
    """A command, or an answer."""

    number: int
    command: int
    kind: int  # REQUEST or ACKNOWLEDGEMENT
    sender: int
    data: bytes


def pack(frame: CommandFrame) -> bytes:
    """The bytes of a command or an answer."""
    length = HEADER + len(frame.data)
    head = HEAD.pack(START, VERSION, length, frame.number, frame.command, frame.kind, frame.sender, bytes(6), 0)
    head = head[:CHECKED]
    check = binascii.crc_hqx(head, 0xFFFF)
    return head + struct.pack("<HI", check, zlib.crc32(frame.data)) + frame.data


def unpack(payload: bytes) -> CommandFrame:
    """The command in a datagram. Raises ValueError, which says what is wrong."""
    if len(payload) < HEADER or payload[0] != START:
        raise ValueError("no command, which begins with 0xAA and has 24 bytes at least")
    _, version, length, number, command, kind, sender, _, check = HEAD.unpack_from(payload)
    if version != VERSION:
        raise ValueError(f"a command of version {version}; allowed: {VERSION}")
    if length != len(payload):
        raise ValueError(f"a command that says {length} bytes and has {len(payload)}")
    data = payload[HEADER:]
    if check != binascii.crc_hqx(payload[:CHECKED], 0xFFFF) or struct.unpack_from("<I", payload, HEAD.size)[0] != (
        zlib.crc32(data)
    ):
        raise ValueError("a command whose CRC is wrong")
    return CommandFrame(number, command, kind, sender, data)


def keys_of(data: bytes) -> list[int]:
    """The keys that a GET asks for. Raises ValueError."""
    if len(data) < 4:
        raise ValueError("no list of keys")
    (count,) = struct.unpack_from("<H", data)
    if len(data) != 4 + 2 * count:
        raise ValueError(f"{count} keys in {len(data)} bytes")
    return list(struct.unpack_from(f"<{count}H", data, 4))


def values_of(data: bytes) -> list[tuple[int, bytes]]:
    """The keys and values in a SET or a PUSH. Raises ValueError."""
    if len(data) < 4:
        raise ValueError("no list of keys and values")
    (count,) = struct.unpack_from("<H", data)
    found: list[tuple[int, bytes]] = []
    at = 4
    for _ in range(count):
        if len(data) < at + 4:
            raise ValueError(f"{count} keys, and values of {len(found)}")
        key, length = struct.unpack_from("<HH", data, at)
        if len(data) < at + 4 + length:
            raise ValueError(f"a value of {length} bytes beyond the data's end")
        found.append((key, data[at + 4 : at + 4 + length]))
        at += 4 + length
    return found


def listed(values: Sequence[tuple[int, bytes]]) -> bytes:
    """Keys and values, one behind the other."""
    return b"".join(struct.pack("<HH", key, len(value)) + value for key, value in values)


def set_data(values: Mapping[int, bytes]) -> bytes:
    """The data of a SET or a PUSH."""
    return struct.pack("<HH", len(values), 0) + listed(list(values.items()))


def set_answer(code: Code, key: int = 0) -> bytes:
    """The data of the answer to a SET: the key is that which is wrong."""
    return struct.pack("<BH", code, key)


def get_answer(code: Code, values: Sequence[tuple[int, bytes]]) -> bytes:
    """The data of the answer to a GET."""
    return struct.pack("<BH", code, len(values)) + listed(values)


def host_value(address: bytes, host_port: int, sensor_port: int) -> bytes:
    """The value of a key that says where datagrams go: to an address (4 bytes) and port, from a port of the sensor."""
    return address + struct.pack("<HH", host_port, sensor_port)
