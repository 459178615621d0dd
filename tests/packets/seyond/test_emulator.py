"""A driver asks a Seyond over HTTP, as inno-lidar-sdk does: requests by hand, and what its passes of a capture say."""

import numpy as np
import pytest

from lidarcfg.packets.emulator import NetworkSite, RequestError
from lidarcfg.packets.families import codec
from lidarcfg.packets.seyond.decode import form_of
from lidarcfg.packets.seyond.emulator import SeyondEmulator, request_size
from tests.naive import seyond as naive
from tests.packets.seyond.fixtures import encoded, mount, table

SITE = NetworkSite("127.168.1.10", "127.0.0.1", None)


def emulator(model: str = "robin-w", return_mode: str = "strongest") -> SeyondEmulator:
    of = mount(model, return_mode)
    unit = codec(of.sensor).unit
    angles = unit.angle_table if model == "robin-w" else None
    return SeyondEmulator(unit, form_of("here", encoded(of, range(2))[3].data), 8010, angles, SITE)


def request(command: str) -> bytes:
    """net_manager.cpp: http_get."""
    head = f"GET /command/?{command} HTTP/1.1\r\nCache-Control: no-cache\r\nContest-length: 0\r\n"
    return (head + "X-INNO-CRC32: 12345678\r\nConnection: Closed\r\n\r\n").encode()


def asked(of: SeyondEmulator, command: str) -> tuple[int, bytes, str]:
    """The status, the content, and what the terminal says."""
    given = request(command)
    assert request_size(given) == len(given)
    (service,) = of.services
    assert (service.transport, service.port) == ("tcp", 8010)
    answer = service.answer(given, "127.0.0.9")
    assert answer.close
    head, _, content = answer.data.partition(b"\r\n\r\n")
    lines = head.decode().split("\r\n")
    assert f"Content-Length: {len(content)}" in lines
    return int(lines[0].split()[1]), content, answer.message


def test_what_the_sdk_asks_before_it_reads():
    """lidar_client.cpp: before_read_start; stage_client_read.cpp: UdpInput::read_data; get_anglehv_table."""
    of = emulator()
    for name in ("sw_version", "command_line", "fw_version", "lidar_id", "debug", "status_interval_ms", "sn"):
        assert asked(of, f"get_{name}")[::2] == (200, "")
    assert asked(of, "get_frame_rate")[1] == b"10"
    assert asked(of, "get_mode_status")[1] == b"3,3,2,0"
    assert asked(of, "get_udp_ports_ip")[1] == b"8010,8010,8010,127.0.0.1"
    assert of.destination(8010) == ("127.0.0.1", 8010)
    status, _, message = asked(of, "set_udp_ports_ip=9000,9000,9000")
    assert (status, message) == (200, "wants all datagrams sent to 127.0.0.9:9000")
    assert of.destination(8010) == ("127.0.0.9", 9000)
    assert asked(of, "get_udp_ports_ip")[1] == b"9000,9000,9000,127.0.0.9"
    assert asked(of, "get_anglehv_table")[1] == table("robin-w")


def test_what_the_capture_does_not_have_is_refused():
    of = emulator("falcon-k1", "dual")
    assert asked(of, "set_return_mode=3") == (200, b"", "")
    for command in ("set_return_mode=1", "set_roi=10.0,0.0", "set_reflectance_mode=1", "set_udp_ports_ip=0,0,0"):
        status, _, message = asked(of, command)
        assert status == 400
        assert "refused" in message
    for command in ("get_anglehv_table", "get_udp_raw_port", "reboot"):
        status, _, message = asked(of, command)
        assert status == 404
        assert "not emulated" in message


@pytest.mark.parametrize(
    "begun", [b"POST / HTTP/1.1\r\n", b"GETS", b"\0", b"GET /\r\n", b"GET / HTTP/1.1\r\n" + b"a" * 5000]
)
def test_what_is_no_request(begun):
    with pytest.raises(RequestError):
        request_size(begun)


def test_a_request_that_is_not_whole_yet():
    whole = request("get_sn")
    assert {request_size(whole[:size]) for size in range(1, len(whole))} == {None}


def test_frames_go_on_from_pass_to_pass():
    of = mount("falcon-k2")
    answers = emulator("falcon-k2")
    rows = [row.tobytes() for row in encoded(of, range(1250, 1254))[3].data]  # the last of frame 0, three of frame 1
    heads = []
    for turn in range(3):
        for row in rows:
            sent = answers.payload(row, turn * 500_000_000)
            assert naive.checks(sent)
            assert turn or sent == row
            heads.append(naive.header(sent))
    assert [one["frame"] for one in heads] == [0, 1, 1, 1, 2, 3, 3, 3, 4, 5, 5, 5]
    assert np.diff([one["sequence"] for one in heads]).tolist() == [1] * 11
    start_us = np.array([one["start_us"] for one in heads]).reshape(3, 4)
    assert (np.diff(start_us, axis=0) == 500_000).all()
    assert answers.payload(b"other", 7) == b"other"
