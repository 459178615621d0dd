"""A driver finds a Livox, asks and tells it, as Livox-SDK2 does: bytes by hand, and over the loopback network."""

import socket
import struct
import sys
import threading
import zlib

import numpy as np
import pytest

from lidarcfg.capture.emulation import find_emulated
from lidarcfg.capture.emulation_server import EmulationServer
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.replay import read_selected, replay
from lidarcfg.capture.selection import ALL
from lidarcfg.packets.emulator import NetworkSite, RequestError
from lidarcfg.packets.families import codec
from lidarcfg.packets.livox.emulator import LivoxEmulator
from lidarcfg.packets.livox.layout import DataType
from lidarcfg.sensors.rig import Rig
from tests.capture_fixtures import no_warning, scene
from tests.naive import livox as naive
from tests.packets.livox.fixtures import encoded, mount

SENSOR = "127.168.1.121"


def crc16(data: bytes) -> int:
    """CRC-16/CCITT, from all ones, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ (0x1021 if value & 0x8000 else 0)) & 0xFFFF
    return value


def command(number: int, which: int, data: bytes = b"", kind: int = 0, sender: int = 0) -> bytes:
    """sdk_protocol.cpp: Pack."""
    head = struct.pack("<BBHIHBB6x", 0xAA, 0, 24 + len(data), number, which, kind, sender)
    return head + struct.pack("<HI", crc16(head), zlib.crc32(data)) + data


def answered(payload: bytes, number: int, which: int) -> bytes:
    """The data of an answer; asserts that it is one to this command."""
    assert payload[:24] == command(number, which, payload[24:], 1, 1)[:24]
    return payload[24:]


def value(key: int, content: bytes) -> bytes:
    return struct.pack("<HH", key, len(content)) + content


def host(port: int) -> bytes:
    return socket.inet_aton("127.0.0.1") + struct.pack("<HH", port, 0)


def emulator() -> LivoxEmulator:
    of = mount()
    return LivoxEmulator(codec(of.sensor).unit, DataType.CARTESIAN_MM, 1, 56301, NetworkSite(SENSOR, "127.0.0.1", None))


def test_crc():
    assert crc16(b"123456789") == 0x29B1


def test_it_answers_and_obeys():
    one = emulator()
    assert [(s.port, s.broadcast, bool(s.push)) for s in one.services] == [
        (56000, True, False),
        (56100, False, False),
        (56200, False, True),
    ]
    found = answered(one.answer(command(1, 0), "127.0.0.1").data, 1, 0)
    assert struct.unpack("<BB16s4sH", found) == (0, 9, b"LIDARCFG000121\0\0", socket.inet_aton(SENSOR), 56100)
    asked = struct.pack("<HHHH", 2, 0, 0x8010, 0x8006)
    data = answered(one.answer(command(2, 0x101, asked), "127.0.0.1").data, 2, 0x101)
    assert data == struct.pack("<BH", 0, 2) + value(0x8010, b"\1") + value(0x8006, b"\1")
    assert one.destination(56301) == ("127.0.0.1", 56301)

    def set_to(*values: bytes) -> bytes:
        return answered(
            one.answer(command(3, 0x100, struct.pack("<HH", len(values), 0) + b"".join(values)), "a").data, 3, 0x100
        )

    done = struct.pack("<BH", 0, 0)
    assert set_to(value(6, host(5000)), value(7, host(5001))) == done
    assert (one.destination(56301), one.destination(56401)) == (("127.0.0.1", 5000), ("127.0.0.1", 5001))
    assert set_to(value(0x1C, b"\0")) == done
    assert (one.destination(56301), one.destination(56401)) == (("127.0.0.1", 5000), None)
    assert set_to(value(0x1A, b"\2")) == done
    assert one.destination(56301) is None
    assert set_to(value(0x1A, b"\1"), value(0, b"\2")) == struct.pack("<BH", 2, 0)  # other points: nothing is done
    assert one.destination(56301) is None
    assert set_to(value(0x8000, bytes(16))) == struct.pack("<BH", 0x22, 0x8000)
    assert set_to(value(0x1A, b"\7")) == struct.pack("<BH", 3, 0x1A)
    assert set_to(value(6, b"\0")) == struct.pack("<BH", 0x23, 6)
    assert "reboot" in one.answer(command(4, 0x200, b"\0\0"), "a").message
    assert one.answer(command(4, 0, kind=1), "a").data == b""  # another sensor's answer


def test_nothing_else_is_answered():
    one = emulator()
    right = command(1, 0x101, struct.pack("<HHH", 1, 0, 0x8010))
    for at in range(len(right)):
        wrong = bytearray(right)
        wrong[at] ^= 0x41
        with pytest.raises(RequestError):
            one.answer(bytes(wrong), "a")
    for data in (b"", b"\1", struct.pack("<HH", 60000, 0), struct.pack("<HHHH", 1, 0, 6, 60000)):
        for which in (0x100, 0x101):
            assert one.answer(command(9, which, data), "a").data[24] == 0x24 or data == b""
    rng = np.random.default_rng(1)
    for _ in range(2000):
        data = rng.integers(0, 256, rng.integers(0, 40), np.uint8).tobytes()
        one.answer(command(5, int(rng.choice([0, 0x100, 0x101, 0x200, 0x500])), data), "a")


def test_a_repeated_capture_goes_on():
    one = emulator()
    payload = encoded(mount(), 1)[3].data[0].tobytes()
    later = one.payload(payload, 10**9)
    assert naive.header(later)["stamp_ns"] == naive.header(payload)["stamp_ns"] + 10**9
    assert (later[:28], later[36:]) == (payload[:28], payload[36:])


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8")
def test_over_the_network(tmp_path):
    path = tmp_path / "a.pcap"
    there = scene(tmp_path, "ground: {reflectivity: 12}")
    write_pcap(path, in_time_order(simulated_packets(Rig("r", (mount(),)), there, np.eye(4), 60_000_000)))
    (sensor,) = find_emulated(path, "127.0.0.1", None, ALL, no_warning)
    messages = []
    with (
        EmulationServer([(sensor.site.address, one) for one in sensor.emulator.services], messages.append),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as driver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as points,
    ):
        for one in (driver, points):
            one.bind(("127.0.0.1", 0))
            one.settimeout(10)
        driver.sendto(command(1, 0), (SENSOR, 56000))
        payload, sender = driver.recvfrom(2000)
        assert sender == (SENSOR, 56000)
        assert answered(payload, 1, 0)[:2] == b"\0\x09"
        hosts = value(5, host(driver.getsockname()[1])) + value(6, host(points.getsockname()[1]))
        driver.sendto(command(2, 0x100, struct.pack("<HH", 2, 0) + hosts), (SENSOR, 56100))
        payload, sender = driver.recvfrom(2000)
        assert answered(payload, 2, 0x100) == bytes(3)
        emulators = {sensor.host: sensor.emulator}
        thread = threading.Thread(
            target=lambda: replay(read_selected(path, no_warning, ALL), "127.0.0.1", None, 1, emulators)
        )
        thread.start()
        for number in range(5):
            payload, sender = points.recvfrom(2000)
            assert sender == (SENSOR, 56300)  # from no other port does the SDK take points
            assert naive.header(payload)["count"] == number
        pushed, sender = driver.recvfrom(2000)
        assert sender == (SENSOR, 56200)
        assert pushed[:24] == command(0, 0x102, pushed[24:], 0, 1)[:24]
        thread.join()
    assert any("wants points sent to 127.0.0.1" in one for one in messages)
