"""What a Livox says of its condition: whether its clock is synchronised, and codes in the state that it pushes.

Codes: Livox's wiki, HMS codes of the Mid-360. Of the supply's voltage it says nothing. Temperatures are taken to be in
hundredths of a degree.
"""

import struct
from collections.abc import Iterator

import numpy as np

from lidarcfg.geometry import Bytes
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.condition import Condition
from lidarcfg.packets.inertial import samples
from lidarcfg.packets.livox import commands
from lidarcfg.packets.livox.commands import Command, CommandFrame, Key, WorkMode
from lidarcfg.packets.livox.emulator import STATE_PORTS
from lidarcfg.packets.livox.layout import TIME_TYPES, headers_of
from lidarcfg.packets.livox.model import LivoxUnit
from lidarcfg.sensors.rig import Clock
from lidarcfg.units import SECOND_NS

UNSYNCHRONISED = 0  # a time type
WARNING = 2  # a level
HOT = 0x0103 << 16 | WARNING
DIRTY = 0x0104 << 16 | WARNING
CODES = 8  # in a state
HUNDREDTHS = 100


def report(data: Bytes, condition: Condition) -> Bytes:
    """Packets (P, size), of points or inertial, with what the sensor says."""
    packets = data.copy()
    headers_of(packets)["time_type"][~condition.synchronised] = UNSYNCHRONISED
    return packets


def states(unit: LivoxUnit, clock: Clock, start_ns: int, due_ns: range) -> Iterator[Payloads]:
    """The states that the sensor pushes once a second; nothing is wrong in them."""
    headers = unit.facts.headers
    port_from, port_to = STATE_PORTS.get(unit.facts.device.type, STATE_PORTS[9])
    for number, _, sent_ns in samples(start_ns, due_ns, SECOND_NS):
        data = np.frombuffer(_state(b"\0" * 4, TIME_TYPES[clock], []) * len(number), np.uint8).reshape(len(number), -1)
        header = headers.imu.model_copy(update={"source_port": port_from})
        yield Payloads(sent_ns, data, port_to, headers, header, int(number[0]))


def report_states(data: Bytes, clock: Clock, condition: Condition) -> Bytes:
    """States (P, size) with what is wrong."""
    rows = []
    columns = condition.temperature_c, condition.hot, condition.dirty, condition.synchronised
    for temperature_c, hot, dirty, synchronised in zip(*(column.tolist() for column in columns), strict=True):
        temperature = struct.pack("<i", round(temperature_c * HUNDREDTHS) if hot else 0)
        codes = [code for code, there in ((HOT, hot), (DIRTY, dirty)) if there]
        rows.append(_state(temperature, TIME_TYPES[clock] if synchronised else UNSYNCHRONISED, codes))
    return np.frombuffer(b"".join(rows), np.uint8).reshape(data.shape)


def _state(temperature: bytes, sync: int, codes: list[int]) -> bytes:
    values: dict[int, bytes] = {
        Key.STATE: bytes([WorkMode.SAMPLING]),
        Key.TEMPERATURE: temperature,
        Key.SYNC: bytes([sync]),
        Key.FAULTS: struct.pack(f"<{CODES}I", *codes, *[0] * (CODES - len(codes))),
    }
    frame = CommandFrame(0, Command.PUSH, commands.REQUEST, commands.SENSOR, commands.set_data(values))
    return commands.pack(frame)
