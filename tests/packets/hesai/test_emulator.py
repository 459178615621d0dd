"""Answers to PTC commands, read as Nebula's structs lie (hesai_cmd_response.hpp): packed, big endian."""

import socket

import numpy as np
import pytest

from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.emulator import NetworkSite
from lidarcfg.packets.families import codec
from tests.capture_fixtures import recording
from tests.packets.hesai.recorded import mount
from tests.packets.hesai.test_protocol_1_4 import mount as of_1_4
from tests.packets.hesai.test_protocol_1_4 import sensed

OURS = "127.168.1.201"
OTHERS = "-192.168.1.202-2368-firetimes.csv"


def asked(of, files=None):
    """What a sensor of a mount answers: code and payload to a command and its payload."""
    *_, payloads = sensed(of, 4)
    given = files or {}
    source = PacketSource(
        where="here",
        host=of.host,
        port=of.data_port,
        sidecar_files=lambda suffix: {name: content for name, content in given.items() if name.endswith(suffix)},
        payloads=lambda port, size: iter(()),
        on_warning=lambda warning: None,
    )
    made = codec(of.sensor).emulator(source, payloads.data, NetworkSite(OURS, "127.0.0.1", None))
    (service,) = made.services

    def ask(command, payload=b""):
        answer = service.answer(
            b"\x47\x74" + bytes([command, 0]) + len(payload).to_bytes(4) + payload, "127.0.0.1"
        ).data
        assert (answer[:3], len(answer)) == (b"\x47\x74" + bytes([command]), 8 + int.from_bytes(answer[4:8]))
        return answer[3], answer[8:]

    return ask


@pytest.mark.parametrize(
    ("of", "mode", "high"),
    [
        (mount("pandar-xt32", "first"), 3, 0),
        (mount("qt128", "first-last"), 4, 0),
        (of_1_4("ot128", "dual", "high", rpm=1200.0), 2, 1),
        (of_1_4("jt128", "last"), 0, 0),
    ],
    ids=lambda one: getattr(one, "name", one),
)
def test_configuration_and_status(of, mode, high):
    ask = asked(of)
    code, config = ask(0x08)
    assert (code, len(config)) == (0, 47)
    addresses = [socket.inet_ntoa(config[at : at + 4]) for at in (0, 4, 8, 12)]
    assert addresses == [OURS, "255.255.255.0", "127.168.1.1", "127.0.0.1"]
    lidar_port, gps_port, rpm = (int.from_bytes(config[at : at + 2]) for at in (16, 18, 20))
    assert (lidar_port, gps_port, rpm) == (2368, 10110, of.rpm)
    assert int.from_bytes(config[23:25]) == int.from_bytes(config[25:27]) == 0  # sync and start angle
    assert int.from_bytes(config[27:29]) == 3600  # tenths of a degree, as in set_lidar_range
    clock, sequence, _, return_mode, standby = config[29:34]
    assert (clock, sequence, return_mode, standby) == (1, 1, mode, 0)
    code, status = ask(0x09)
    temperatures = 9 if of.name == "qt128" else 8
    assert (code, len(status)) == (0, 4 + 2 + 4 * temperatures + 1 + 1 + 4 + 4 + 1 + 5)
    assert int.from_bytes(status[4:6]) == of.rpm
    assert status[6 + 4 * temperatures + 10] == 2  # "locked"
    for query, size in ((1, 16), (2, 26), (3, 50), (4, 8)):
        code, found = ask(0x06, bytes([query]))
        assert (code, len(found)) == (0, size)
    assert ask(0x06, b"\2")[1][3:5] == b"\xff\xfe"  # of a clock identity that is made of a MAC address
    assert ask(0x06, b"\5") == ask(0x06) == (1, b"")
    assert ask(0x28) == (0, bytes([high]))
    assert ask(0x23) == (0, b"\0\0\0\x0e\x10")


def test_what_nebula_sets_as_it_starts():
    """`check_and_set_config`: what is so anyway is confirmed, PTP can be set, and the rest is refused."""
    ask = asked(mount("pandar-xt32", "dual"))
    for command, payload in ((0x1E, b"\2"), (0x17, b"\2\x58"), (0x18, b"\1\0\0"), (0x1F, b"\1")):
        assert ask(command, payload) == (0, b"")
        assert ask(command, payload[:-1] + b"\7") == (1, b"")
    assert ask(0x26) == (0, b"\1\0\0\0\1\1\0")  # status, profile 1588v2, domain, network, three intervals
    assert ask(0x24, b"\0\3\0\1\1\0") == (0, b"")
    assert ask(0x26)[1][2] == 3
    assert ask(0x39, b"\x64") == (0, b"")
    assert ask(0x3A) == (0, b"\x64")
    assert ask(0x22, b"\0\0\0\x0e\x10") == (0, b"")
    assert ask(0x22, b"\0\0\0\1\0") == (1, b"")
    assert ask(0x0C) == (5, b"")
    assert asked(of_1_4("ot128"))(0x26) == (0, b"\1\3\0\1\1")  # automotive, domain, L2, TSN


def test_the_inventories():
    """The model's number stands after the angle offset: 3 is the Pandar128's. Of the JT128's nothing is known."""
    for of, at, number, size in (
        (mount("qt128"), 108, 32, 144),
        (of_1_4("ot128"), 106, 42, 162),
        (of_1_4("pandar128"), 106, 3, 120),
    ):
        code, inventory = asked(of)(0x07)
        assert (code, len(inventory), inventory[at], inventory[at + 2]) == (0, size, number, 128)
    assert asked(of_1_4("jt128"))(0x07) == (5, b"")


def test_firing_times_are_the_sensors_own():
    """Never another's beside the capture; a QT128's in the form of Hesai's file, whose parser wants EEFF first."""
    mine = b"Channel,fire time(us)\n1,6\n"
    other = {f"/a/drive{OTHERS}": b"another's"}
    for of in (mount("pandar-xt32"), mount("qt128"), of_1_4("ot128"), of_1_4("jt128"), of_1_4("pandar128")):
        code, times = asked(of, other)(0xA9)
        assert (code, b"another's" in times) == (0, False)
        assert len(times.splitlines()) > 32
        assert asked(of, other | {"/a/drive-firetimes.csv": mine})(0xA9) == (0, mine)
        own = {f"/a/drive-{of.host}-{of.data_port}-firetimes.csv": mine}
        assert asked(of, other | own)(0xA9) == (0, mine)


def test_a_qt128s_firing_times_are_those_of_hesais_file():
    _, times = asked(mount("qt128"))(0xA9)
    theirs = recording("hesai/correction/QT128C2X_Firetime_Correction_File.csv").read_text().splitlines()
    ours = times.decode().splitlines()
    assert ours[:3] == [line.strip() for line in theirs[:3]]
    rows, known = (
        np.array([line.strip().split(",")[:4] for line in lines[3:99]], np.float64) for lines in (ours, theirs)
    )
    for loop in (0, 2):
        found, wanted = (dict(table[:, loop : loop + 2].tolist()) for table in (rows, known))
        assert found == pytest.approx(wanted, abs=1e-9)
        assert len(found) == 96
        assert (np.diff(rows[:, loop + 1]) >= 0).all()
