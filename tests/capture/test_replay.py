"""A capture received on loopback: every byte in its order, none before its time by the kernel's own clock."""

import contextlib
import itertools
import signal
import socket
import struct
import sys
import threading
import time

import dpkt
import pytest

from lidarcfg.capture.pcap import Datagram
from lidarcfg.capture.replay import read_selected, repeat, replay
from lidarcfg.capture.selection import Selection
from lidarcfg.errors import PacketError
from lidarcfg.packets.emulator import Emulator
from tests.capture_fixtures import write_datagrams
from tests.command_line import lidarcfg, started

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
    with pytest.raises(PacketError, match=r"'no such host\.invalid' is not a known host"):
        replay([], "no such host.invalid", None)
    with pytest.raises(PacketError, match="no UDP datagrams to send"):
        replay([], "127.0.0.1", None)


def test_a_loop_goes_on_at_the_mean_interval():
    """Three packets 10 and 20 ms apart: the next pass begins 15 ms after the last."""
    sent = [datagram(ns, 2368, bytes([n])) for n, ns in enumerate((0, 10_000_000, 30_000_000))]
    got = list(itertools.islice(repeat(lambda: iter(sent)), 8))
    assert [one.payload for one in got] == [bytes([n % 3]) for n in range(8)]
    assert [(one.time_ns - AT_NS) // 1_000_000 for one in got] == [0, 10, 30, 45, 55, 75, 90, 100]
    assert list(repeat(lambda: iter(()))) == []


def test_a_part_is_what_dpkt_finds_in_it(tmp_path):
    """From 0.02 s to before 0.05 s after the first datagram, whatever the sensor."""
    path = tmp_path / "rig.yaml"
    path.write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    lidarcfg("export", path, "--scene", "data/scenes/street.yaml", "--duration", 0.1, "-o", tmp_path / "a.pcap")
    with open(tmp_path / "a.pcap", "rb") as file:
        frames = [(time, bytes(dpkt.ethernet.Ethernet(frame).data.data.data)) for time, frame in dpkt.pcap.Reader(file)]
    first = frames[0][0]
    expected = [payload for time, payload in frames if 0.02 - 5e-7 <= float(time) - float(first) < 0.05 - 5e-7]
    found = list(read_selected(tmp_path / "a.pcap", pytest.fail, Selection(0.02, 0.05)))
    assert [one.payload for one in found] == expected
    assert 20 < len(expected) < 40


@pytest.mark.slow
def test_ctrl_c_ends_a_loop_and_says_what_was_sent(tmp_path):
    path = tmp_path / "a.pcap"
    packet = dpkt.udp.UDP(sport=2368, dport=9, data=b"x" * 100, ulen=108)
    ip = dpkt.ip.IP(src=b"\xc0\xa8\x01\xc9", dst=b"\x7f\x00\x00\x01", p=17, data=packet, len=128)
    frame = bytes(dpkt.ethernet.Ethernet(src=b"\2" * 6, dst=b"\xff" * 6, data=ip))
    with open(path, "wb") as file:
        writer = dpkt.pcap.Writer(file)
        for number in range(5):
            writer.writepkt(frame, ts=1e9 + number / 1000)
    words = [sys.executable, "-m", "lidarcfg", "replay", str(path), "127.0.0.1", "--loop"]
    with started(words) as running:
        time.sleep(2)
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=20)
    if "datagrams to" in out:
        assert int(out.split()[0].replace(",", "")) > 5
        assert running.returncode == 0
    else:  # it had not begun
        assert running.returncode == 130, err


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8")
def test_each_sensor_has_an_address_of_its_own(tmp_path):
    """As the receiving socket sees it: two sensors on one port can be told apart."""
    hosts = ["192.168.1.201", "192.168.1.202", "192.168.1.201", "10.168.1.201"]
    sent = [Datagram(i * 1000, host, 2368, 2368, bytes([i])) for i, host in enumerate(hosts)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        done = replay(sent, "127.0.0.1", receiver.getsockname()[1])
        got = {data[0]: address for data, (address, _) in (receiver.recvfrom(10) for _ in sent)}
    assert got == {0: "127.168.1.201", 1: "127.168.1.202", 2: "127.168.1.201", 3: "127.0.0.1"}
    assert done.sources == {"192.168.1.201": "127.168.1.201", "192.168.1.202": "127.168.1.202", "10.168.1.201": ""}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8")
def test_where_a_sensor_cannot_have_its_address_it_is_told(tmp_path):
    write_datagrams(tmp_path / "p.pcap", [Datagram(0, f"{i}.0.113.1", 2368, 2368, b"x") for i in (203, 10)])
    done = lidarcfg("replay", tmp_path / "p.pcap", "localhost:9")
    assert "203.0.113.1 sent from 127.0.113.1" in done.stdout
    assert "10.0.113.1: not addresses of this machine, so their datagrams came from its own" in done.stderr


class Still(Emulator):
    """A sensor that answers nobody."""

    name = "still"
    services = ()

    def __init__(self, target):
        self.target = target

    def destination(self, port):
        return self.target


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8")
def test_an_emulated_sensor_keeps_the_port_it_sends_from():
    """But for one that a driver opens: it would find that taken."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5)
        port = receiver.getsockname()[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.168.1.201", 0))
            own = free.getsockname()[1]
        sent = [Datagram(n, "192.168.1.201", source, port, bytes([n])) for n, source in enumerate((own, port))]
        replay(sent, "127.0.0.1", None, emulators={"192.168.1.201": Still(("127.0.0.1", port))})
        senders = [receiver.recvfrom(10)[1] for _ in sent]
    assert senders[0] == ("127.168.1.201", own)
    assert senders[1][0] == "127.168.1.201"
    assert senders[1][1] != port
