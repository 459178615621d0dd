"""Capture files: dpkt's own reader, real headers byte for byte, and files that are not whole."""

import os
import re
import struct
from contextlib import suppress

import dpkt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.capture import pcap
from lidarcfg.capture.pcap import Datagram, each_datagram, read_batches, read_datagrams
from lidarcfg.errors import PacketError
from tests.capture_fixtures import no_warning, recording
from tests.capture_fixtures import write_datagrams as write_pcap
from tests.naive import capture as naive_capture
from tests.refusals import refused

AT_NS = 1_700_000_000_999_999_000


def data(time_ns: int = AT_NS, fill: int = 7) -> Datagram:
    return Datagram(time_ns, "192.168.1.201", 2368, 2368, bytes([fill]) * 1206)


def position(time_ns: int = AT_NS) -> Datagram:
    return Datagram(time_ns, "192.168.1.201", 8308, 8308, bytes(512))


def frames(path):
    with open(path, "rb") as file:
        return [frame for _, frame in dpkt.pcap.Reader(file)]


def content(datagram):
    return datagram.time_ns, datagram.host, datagram.source_port, datagram.port, datagram.payload


def test_file_header(tmp_path):
    assert write_pcap(tmp_path / "a.pcap", [data()]) == 1
    raw = (tmp_path / "a.pcap").read_bytes()
    assert struct.unpack("=IHHiIII", raw[:24]) == (0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    assert struct.unpack("=IIII", raw[24:40]) == (1_700_000_000, 999_999, 1248, 1248)
    assert len(raw) == 24 + 16 + 1248


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 * 10**6 - 1))
def test_times_are_exact(tmp_path_factory, microseconds):
    path = tmp_path_factory.getbasetemp() / "times.pcap"
    write_pcap(path, [data(microseconds * 1000)])
    assert struct.unpack("=II", path.read_bytes()[24:32]) == divmod(microseconds, 10**6)
    assert next(read_datagrams(path, no_warning)).time_ns == microseconds * 1000


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from("<>"),
    st.lists(st.tuples(st.sampled_from([0, 1, 30, 42, 1248, pcap.RECORD_MAX + 1]), st.integers(1, 150)), max_size=6),
    st.integers(0, 2000),
)
def test_records_by_a_plain_loop(order, rows, cut):
    raw = b"".join(
        struct.pack(order + "IIII", 1, 2, n, n) + bytes(min(n, 2000)) for n, count in rows for _ in range(count)
    )
    raw = raw[: max(len(raw) - cut, 0)]
    record = pcap.RECORD if order == "<" else pcap.RECORD.newbyteorder()
    starts, end, size = pcap._records(np.frombuffer(raw, np.uint8), record)
    assert (starts.tolist(), end, size) == naive_capture.records(raw, order, pcap.RECORD_MAX)


@pytest.mark.parametrize("sent", [data(), position()])
def test_checksums(tmp_path, sent):
    write_pcap(tmp_path / "a.pcap", [sent])
    frame = frames(tmp_path / "a.pcap")[0]
    assert dpkt.in_cksum(frame[14:34]) == 0
    pseudo = frame[26:34] + struct.pack(">HH", 17, len(frame) - 34)
    udp_sum = struct.unpack(">H", frame[40:42])[0]
    assert (udp_sum != 0 and dpkt.in_cksum(pseudo + frame[34:]) == 0) if len(sent.payload) == 512 else udp_sum == 0
    assert frame[:14] == b"\xff" * 6 + bytes.fromhex("607688a801c90800")


@pytest.mark.parametrize(("sent", "size"), [(data(), 1248), (position(), 554)])
def test_headers_are_the_real_ones(tmp_path, sent, size):
    """Byte for byte, but for MAC, IP id, IP checksum, address and UDP checksum."""
    real = next(frame for frame in frames(recording("mrpt_vlp16_gps.pcap")) if len(frame) == size)
    write_pcap(tmp_path / "a.pcap", [sent])
    ours = frames(tmp_path / "a.pcap")[0]
    free = {*range(9, 12), 18, 19, 24, 25, *range(26, 30)} | ({40, 41} if len(sent.payload) == 512 else set())
    assert [i for i in range(42) if ours[i] != real[i] and i not in free] == []
    assert len(ours) == len(real)


def test_ids_count_up_for_each_sensor(tmp_path):
    other = Datagram(AT_NS, "192.168.1.202", 8308, 8308, bytes(512))
    write_pcap(tmp_path / "a.pcap", [position(), other, data(), position(), other])
    ids = [struct.unpack(">H", frame[18:20])[0] for frame in frames(tmp_path / "a.pcap")]
    assert ids == [0, 0, 0, 1, 1]


def test_round_trip(tmp_path):
    sent = [data(AT_NS + i * 1_327_000, i) for i in range(5)] + [position(AT_NS + 10**9)]
    write_pcap(tmp_path / "a.pcap", sent)
    got = list(read_datagrams(tmp_path / "a.pcap", no_warning))
    assert [content(d) for d in got] == [content(d) for d in sent]


@pytest.mark.parametrize("magic", [0xA1B2C3D4, 0xA1B23C4D])
@pytest.mark.parametrize("order", "<>")
def test_every_pcap(tmp_path, magic, order):
    write_pcap(tmp_path / "a.pcap", [data()])
    frame = frames(tmp_path / "a.pcap")[0]
    fraction = 999_999_000 if magic == 0xA1B23C4D else 999_999
    raw = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    raw += struct.pack(order + "IIII", 1_700_000_000, fraction, len(frame), len(frame)) + frame
    (tmp_path / "b.pcap").write_bytes(raw)
    assert [content(d) for d in read_datagrams(tmp_path / "b.pcap", no_warning)] == [content(data())]


def test_pcapng_and_vlan(tmp_path):
    write_pcap(tmp_path / "a.pcap", [data()])
    frame = frames(tmp_path / "a.pcap")[0]
    with open(tmp_path / "b.pcapng", "wb") as file:
        writer = dpkt.pcapng.Writer(file)
        writer.writepkt(frame[:12] + bytes.fromhex("81000005") + frame[12:], AT_NS / 1e9)
    got = list(read_datagrams(tmp_path / "b.pcapng", no_warning))
    assert [content(d) for d in got] == [content(data())]


def test_other_traffic_is_passed_over(tmp_path):
    write_pcap(tmp_path / "a.pcap", [data()])
    frame = bytearray(frames(tmp_path / "a.pcap")[0])
    tcp = bytearray(frame)
    fragment = bytearray(frame)
    arp = bytearray(frame)
    tcp[23] = 6
    fragment[20] = 0x20
    arp[12:14] = b"\x08\x06"
    with open(tmp_path / "b.pcap", "wb") as file:
        writer = dpkt.pcap.Writer(file)
        for other in (tcp, fragment, arp, frame[:20], b"", frame):
            writer.writepkt(bytes(other), 5)
    warnings: list[str] = []
    assert len(list(read_datagrams(tmp_path / "b.pcap", warnings.append))) == 1
    assert warnings == [f"{tmp_path}/b.pcap: 1 datagrams skipped: fragments of theirs are missing or damaged"]


@pytest.mark.parametrize("cut", [1, 15, 16, 17, 1000, 1263])
def test_cut_in_mid_record(tmp_path, cut):
    path = tmp_path / "a.pcap"
    write_pcap(path, [data(fill=i) for i in range(3)])
    path.write_bytes(path.read_bytes()[: 24 + 2 * 1264 + cut])
    warnings: list[str] = []
    assert [d.payload[0] for d in read_datagrams(path, warnings.append)] == [0, 1]
    assert warnings == [f"{path}: cut off or damaged after 2 records; the whole records were read"]


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "the file is empty"),
        (b"hi", "not a capture; allowed: pcap and pcapng"),
        (b"some text that is longer than a header\n" * 9, "not a capture; allowed: pcap and pcapng"),
        (struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 9, 195), "link type 195 is not known"),
        (
            struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 9, 1) + struct.pack("<IIII", 1, 1, 2**31, 2**31),
            "a record of 2147483648 bytes; allowed: at most 262144",
        ),
    ],
)
def test_not_a_capture(tmp_path, raw, message):
    (tmp_path / "a.pcap").write_bytes(raw)
    with refused(message, r"a\.pcap: ", PacketError):
        list(read_datagrams(tmp_path / "a.pcap", no_warning))


@settings(max_examples=200, deadline=None)
@given(
    st.binary(max_size=300),
    st.sampled_from([b"", b"\xd4\xc3\xb2\xa1", b"\x0a\x0d\x0d\x0a", b"\xa1\xb2\x3c\x4d"]),
)
def test_any_bytes_end_well(tmp_path_factory, raw, magic):
    path = tmp_path_factory.getbasetemp() / "fuzz.pcap"
    path.write_bytes(magic + raw)
    with suppress(PacketError):
        assert all(len(datagram.payload) <= len(raw) for datagram in read_datagrams(path, lambda warning: None))


def test_zeros_that_a_crash_has_left_behind_end_the_file(tmp_path):
    path = tmp_path / "a.pcap"
    write_pcap(path, [data(fill=i) for i in range(3)])
    os.truncate(path, 1 << 33)
    for from_ns in (None, AT_NS):
        warnings: list[str] = []
        found = [
            one.payload[0] for batch in read_batches(path, warnings.append, from_ns) for one in each_datagram(batch)
        ]
        assert found == [0, 1, 2]
        assert len(warnings) == 1
        assert re.search("cut off or damaged after [0-9]+ records; the whole records were read$", warnings[0])


def test_no_such_file(tmp_path):
    with pytest.raises(PacketError, match="no such file"):
        list(read_datagrams(tmp_path / "none.pcap", no_warning))


def test_a_failed_write_leaves_the_old_file(tmp_path):
    (tmp_path / "a.pcap").write_bytes(b"old")

    def breaks():
        yield data()
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_pcap(tmp_path / "a.pcap", breaks())
    assert [path.name for path in tmp_path.iterdir()] == ["a.pcap"]
    assert (tmp_path / "a.pcap").read_bytes() == b"old"


FRAME = bytes.fromhex("ffffffffffff60768800000008004500001d0000400040110000c0a80101c0a80102094009400009") + b"\0\0x"


def block(order, kind, layout, *values, octets=b""):
    """Of a pcapng."""
    body = struct.pack(order + layout, *values) + octets
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + size + body + size


def section(order="<"):
    return block(order, 0x0A0D0D0A, "IHHq", 0x1A2B3C4D, 1, 0, -1)


def interface(order, link, resolution=None, offset_s=None):
    options = b"" if resolution is None else struct.pack(order + "HHB3x", 9, 1, resolution)
    options += b"" if offset_s is None else struct.pack(order + "HHq", 14, 8, offset_s)
    return block(order, 1, "HHI", link, 0, 0, octets=options + bytes(4) if options else b"")


def packet(order, which, ticks, frame):
    values = which, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame)
    return block(order, 6, "IIIII", *values, octets=frame)


def pcapng(path, ticks, resolution):
    """A file of one datagram."""
    path.write_bytes(section() + interface("<", 1, resolution) + packet("<", 0, ticks, FRAME))


def test_interfaces_and_sections_of_a_pcapng(tmp_path):
    """Each interface has its own kind of link and clock, each section its own interfaces and order of bytes."""
    cooked = bytes(14) + FRAME[12:]
    second = 1_700_000_000
    raw = section() + interface("<", 1) + interface("<", 113, 9) + interface("<", 195) + interface("<", 101, 138, 40)
    raw += packet("<", 0, second * 10**6 + 7, FRAME) + packet("<", 1, second * 10**9 + 8001, cooked)
    raw += packet("<", 2, 5, b"of a link that is not known") + packet("<", 3, (second - 40) * 1024 + 512, FRAME[14:])
    raw += section(">") + interface(">", 1, 9) + packet(">", 0, second * 10**9 + 10**9 - 1, FRAME)
    (tmp_path / "a.pcapng").write_bytes(raw)
    found = list(read_datagrams(tmp_path / "a.pcapng", no_warning))
    assert [one.time_ns - second * 10**9 for one in found] == [7000, 8001, 500_000_000, 999_999_999]
    assert {content(one)[1:] for one in found} == {("192.168.1.1", 2368, 2368, b"x")}


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (section() + block("<", 3, "I", len(FRAME), octets=FRAME), "has simple packet blocks, which have no times"),
        (section() + interface("<", 195) + packet("<", 0, 5, FRAME), "link type 195 is not known"),
        (section() + struct.pack("<III", 6, 1 << 25, 0), "a block of 33554432 bytes; allowed: at most 16777216"),
    ],
)
def test_what_a_pcapng_must_not_hold(tmp_path, raw, message):
    (tmp_path / "a.pcapng").write_bytes(raw)
    with refused(message, r"a\.pcapng: ", PacketError):
        list(read_datagrams(tmp_path / "a.pcapng", no_warning))


@pytest.mark.parametrize(
    "damaged",
    [
        packet("<", 1, 5, FRAME),  # of an interface that is not there
        packet("<", 0, 5, FRAME)[:-1] + b"\1",  # another length at its end
        packet("<", 0, 5, FRAME)[:-9],
        block("<", 6, "IIIII", 0, 0, 5, 99, 99, octets=FRAME),  # a frame that is longer than its block
        block("<", 1, "HHI", 1, 0, 0, octets=struct.pack("<HHq", 9, 8, 6)),  # a unit of eight bytes
        bytes(100),
        interface("<", 1) * 65536,
    ],
)
def test_a_damaged_block_ends_a_pcapng(tmp_path, damaged):
    raw = section() + interface("<", 1) + packet("<", 0, 5, FRAME)
    (tmp_path / "a.pcapng").write_bytes(raw + damaged + packet("<", 0, 6, FRAME))
    warnings: list[str] = []
    assert len(list(read_datagrams(tmp_path / "a.pcapng", warnings.append))) == 1
    assert warnings == [f"{tmp_path}/a.pcapng: cut off or damaged after 1 records; the whole records were read"]


def test_frames_of_which_the_beginning_was_kept_are_counted(tmp_path):
    """As by `tcpdump -s 600`: no shorter packets, and no silence."""
    write_pcap(tmp_path / "a.pcap", [data(), position(), data()])
    whole = frames(tmp_path / "a.pcap")
    with open(tmp_path / "b.pcap", "wb") as file:
        writer = dpkt.pcap.Writer(file)
        for frame in (*whole, whole[0]):
            writer.writepkt(frame if frame is whole[2] else frame[:600], 5)
    warnings: list[str] = []
    assert [len(one.payload) for one in read_datagrams(tmp_path / "b.pcap", warnings.append)] == [512, 1206]
    assert warnings == [f"{tmp_path}/b.pcap: 2 datagrams skipped: the capture has only their beginnings"]


@pytest.mark.parametrize(
    ("resolution", "unit"), [(None, 10**6), (0, 1), (3, 10**3), (6, 10**6), (9, 10**9), (128, 1), (138, 2**10)]
)
def test_the_units_of_a_pcapng(tmp_path, resolution, unit):
    """Times in tenths to some power of a second, or, from 128 on, in halves: as the draft of the format has if_tsresol."""
    ticks = 1_700_000_000 * unit + unit // 4
    pcapng(tmp_path / "a.pcapng", ticks, resolution)
    (datagram,) = read_datagrams(tmp_path / "a.pcapng", no_warning)
    assert datagram.payload == b"x"
    assert datagram.time_ns == 1_700_000_000 * 10**9 + unit // 4 * 10**9 // unit


@pytest.mark.parametrize("resolution", [0, 6, 9])
def test_a_time_that_no_number_holds(tmp_path, resolution):
    """The greatest count of a damaged pcapng: read as the latest time, not an error."""
    pcapng(tmp_path / "a.pcapng", 2**64 - 1, resolution)
    (datagram,) = read_datagrams(tmp_path / "a.pcapng", no_warning)
    assert datagram.time_ns == 4_600_000_000 * 10**9
