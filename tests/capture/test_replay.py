"""A capture received on loopback: every byte in its order, none before its time by the kernel's own clock."""

import contextlib
import socket
import struct
import threading
import time

import pytest

from lidarcfg.capture.pcap import Datagram
from lidarcfg.capture.replay import replay
from lidarcfg.errors import PacketError

AT_NS = 1_767_225_600 * 10**9
SO_TIMESTAMPNS = 35  # Linux


class Receiver:
    """UDP ports on loopback, and when the kernel got what came to them."""

    def __init__(self, count):
        self.sockets = []
        for _ in range(count):
            receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            receiver.bind(("127.0.0.1", 0))
            receiver.settimeout(5)
            self.sockets.append(receiver)
        self.ports = [receiver.getsockname()[1] for receiver in self.sockets]

    def take(self, index, count):
        """(payload, seconds since 1970) of so many."""
        got = []
        for _ in range(count):
            payload, extra, _, _ = self.sockets[index].recvmsg(2048, 256)
            seconds, nanoseconds = struct.unpack("qq", extra[0][2])
            got.append((payload, seconds + nanoseconds / 1e9))
        return got


@contextlib.contextmanager
def receiving(count):
    receiver = Receiver(count)
    try:
        yield receiver
    finally:
        for one in receiver.sockets:
            one.close()


def datagram(offset_ns, port, payload):
    return Datagram(AT_NS + offset_ns, "192.168.1.201", 2368, port, payload)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_content_and_time(speed):
    """The rhythm of a VLP-16, with pauses; position packets go to a port of their own."""
    with receiving(2) as receiver:
        offsets = [n * 1_327_104 + (50_000_000 if n >= 60 else 0) for n in range(120)]
        sent = [datagram(ns, receiver.ports[n % 10 == 9], bytes([n]) * 1206) for n, ns in enumerate(offsets)]
        began = time.time()
        done = replay(iter(sent), "127.0.0.1", None, speed)
        took = time.time() - began
        got = [receiver.take(0, 108), receiver.take(1, 12)]
    for index, port in enumerate(receiver.ports):
        mine = [(d.payload, ns / 1e9 / speed) for d, ns in zip(sent, offsets, strict=True) if d.port == port]
        assert [payload for payload, _ in got[index]] == [payload for payload, _ in mine]
        for (_, arrived), (_, due) in zip(got[index], mine, strict=True):
            assert arrived - began >= due - 1e-3  # the two clocks may drift that much, by far
            assert arrived - began <= due + took + 1e-3
    assert done.packets == 120
    assert offsets[-1] / 1e9 / speed <= done.seconds <= took + 1e-3
    assert 0 <= done.latest_s <= done.seconds


def test_all_to_one_port():
    with receiving(1) as receiver:
        sent = [datagram(0, 2368, b"data"), datagram(1000, 8308, b"position")]
        thread = threading.Thread(target=replay, args=(sent, "localhost", receiver.ports[0]))
        thread.start()
        assert [payload for payload, _ in receiver.take(0, 2)] == [b"data", b"position"]
        thread.join()


def test_what_cannot_be_sent():
    with pytest.raises(PacketError, match=r"'no such host\.invalid' is not a host that is known here"):
        replay([], "no such host.invalid", None)
    with pytest.raises(PacketError, match="no UDP datagrams to send"):
        replay([], "127.0.0.1", None)
