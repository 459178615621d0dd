"""What leaves a sensor, byte by byte: packets of every layout, headers, position packets by the state of the pulse."""

import math
import socket
import struct
from datetime import UTC, datetime

import dpkt
import numpy as np
import pytest
import velodyne_decoder as vd
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.capture.ethernet import EthernetFrames, ethernet_frames
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.packets.velodyne.model import unit
from lidarcfg.packets.velodyne.telemetry import calibration
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.sensors.sensor import catalogue, load_sensor
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.units import SECOND_NS, START_NS
from tests.capture_fixtures import datagrams_of, hdl_64e, mount, recording, scene
from tests.naive import capture as naive
from tests.packets.velodyne.shaped import encode, facts, firings, packet_period_ns, sent_returns, with_facts
from tests.refusals import refused

VLP16 = load_sensor("vlp-16")
MODELS = ["vlp-16", "puck-lite", "puck-hi-res", "vlp-32c", "hdl-32e", "vls-128", "hdl-64e-s2", "hdl-64e-s3"]
CODES = {"strongest": 0x37, "last": 0x38, "dual": 0x39}


def made_up(beams, sequences, flags, order, by):
    """A sensor of another layout."""
    packet = {"block_flags": flags, "sequences_per_block": sequences}
    packet["dual"] = {"source": "", "order": order, "by": by}
    elevation = tuple(np.linspace(-25, 15, beams).tolist())
    offset = tuple(500 * (i // 2) for i in range(beams))
    none = {"elevation_deg": elevation, "azimuth_offset_deg": (), "vertical_offset_mm": ()}
    sensor = VLP16.model_copy(update={"beams": VLP16.beams.model_copy(update=none)})
    return with_facts(sensor, firing={"offset_ns": offset, "sequence_ns": 50_000}, packet=packet)


LAYOUTS = [
    *[(load_sensor(name), mode) for name in MODELS for mode in CODES],
    *[(hdl_64e(name), mode) for name in ("hdl-64e-s2", "hdl-64e-s3") for mode in CODES],
    (made_up(8, 4, (0xEEFF,), ("strongest", "last"), "sequence"), "dual"),
    (made_up(64, 1, (1, 2), ("last", "strongest"), "sequence"), "dual"),
    (made_up(64, 1, (1, 2), ("strongest", "last"), "block"), "dual"),
    (made_up(96, 1, (1, 2, 3), ("last", "strongest"), "block"), "dual"),
    (made_up(96, 1, (1, 2, 3), ("last", "strongest"), "sequence"), "dual"),
    (made_up(128, 1, (1, 2, 3, 4), ("last", "strongest"), "sequence"), "dual"),
    (made_up(192, 1, (1, 2, 3, 4, 5, 6), ("last", "strongest"), "block"), "dual"),
    (made_up(192, 1, (1, 2, 3, 4, 5, 6), ("last", "strongest"), "block"), "last"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "mode"), LAYOUTS)
def test_every_layout_is_the_twins(sensor, mode):
    """Blocks in groups, pairs by block and by sequence, blocks that are left empty, status bytes; over the hour.

    A unit's own distances and intensities are those that are found by trying them all.
    """
    dual = mode == "dual"
    rng = np.random.default_rng(3)
    layout = facts(sensor).packet
    of = unit(sensor)
    period_ns = packet_period_ns(sensor, dual)
    start_ns = START_NS - 3 * period_ns + 777
    fired = firings(sensor, 600, start_ns, range(8 if of.focal is not None else 30), dual)
    range_m = rng.uniform(0, 1.2 * sensor.range.max_m, (*fired.time_ns.shape, 2) if dual else fired.time_ns.shape)
    range_m[5] = rng.uniform(23, 28, range_m[5].shape)  # where an HDL-64E's corrections end
    range_m[rng.random(range_m.shape) < 0.1] = np.inf
    reflectivity = rng.integers(0, 256, range_m.shape, np.uint8)
    packets = encode(sensor, mode, fired, range_m, reflectivity)
    head_ns = min(of.firing.offset_ns)

    beams = []
    if of.focal is not None:
        tables = sensor.beams.model_dump(exclude={"source", "forward_offset_mm"}) | of.facts.calibration.model_dump()
        beams = [dict(zip(tables, values, strict=True)) for values in zip(*tables.values(), strict=True)]

    def on_the_wire(laser, azimuth, metres, byte):
        if not sensor.range.reported.min_m <= metres <= sensor.range.reported.max_m:
            return 0, 0
        units = round((metres - of.distance_offset_m[laser]) / sensor.range.resolution_m)
        if beams:
            units = naive.unit_distance(beams[laser], metres, sensor.range.resolution_m, azimuth)
        if not 0 < units <= 65535:
            return 0, 0
        return units, naive.unit_intensity(beams[laser], units, byte) if beams else byte

    for p, packet in enumerate(packets):
        stamp_ns = start_ns + p * period_ns
        returns = []
        for row in zip(*(values[p].tolist() for values in (fired.azimuth_rad, range_m, reflectivity)), strict=True):
            cells = []
            for laser, (azimuth, metres, octets) in enumerate(zip(*row, strict=True)):
                if dual:
                    cells.append([on_the_wire(laser, azimuth, *one) for one in zip(metres, octets, strict=True)])
                else:
                    cells.append(on_the_wire(laser, azimuth, metres, octets))
            returns.append(cells)
        said = np.stack(sent_returns(sensor, mode, packets[p : p + 1]), axis=-1)
        assert said.tolist() == np.array(returns).reshape(-1, 1 + dual, 2).tolist()
        azimuths = []
        for sequence in range(0, len(returns), layout.sequences_per_block):
            since_ns = p * period_ns + sequence * of.firing.sequence_ns + head_ns
            azimuths.append(round(naive.head_deg(since_ns, 600) * 100) % 36000)
        if layout.status:
            carried = calibration(of, layout.status, mode)
            when = datetime.fromtimestamp(stamp_ns // SECOND_NS, UTC)
            letters = layout.status.letters, layout.status.warnings, ord("A")
            tail = naive.status(stamp_ns // period_ns, when, *letters, carried)
        else:
            tail = bytes([CODES[mode], layout.product_id])
        stamp_us = (stamp_ns + 500) // 1000 % 3_600_000_000
        pairs = (layout.dual.order, layout.dual.by) if dual else (None, None)
        expected = naive.encode_any(layout.block_flags, layout.sequences_per_block, *pairs, stamp_us, azimuths, returns, tail)  # fmt: skip
        assert packet.tobytes() == expected


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(
    st.sampled_from(MODELS),
    st.booleans(),
    st.ip_addresses(v=4),
    st.integers(1, 65535),
    st.integers(0, 70_000),
    st.integers(0, 2**32 * 10**6 - 1),
    st.binary(min_size=1, max_size=40),
)
def test_frames_are_the_twins(name, position, host, port, number, time_us, payload):
    """Lengths, checksums and ids, whatever is sent; an odd byte at the end is summed too."""
    headers = facts(load_sensor(name)).headers
    header = headers.position if position and headers.position else headers.data
    octets = np.frombuffer(payload, np.uint8)[None]
    sent = ethernet_frames(str(host), Payloads(np.array([time_us * 1000]), octets, port, headers, header, number))
    macs = bytes.fromhex("ffffffffffff607688") + host.packed[1:]
    expected = naive.frame(
        macs,
        header.ttl,
        0x4000 if header.dont_fragment else 0,
        number % 65536 if header.numbered else 0,
        host.packed + b"\xff\xff\xff\xff",
        (header.source_port or port, port),
        header.checksum,
        payload,
    )
    record = struct.pack("<IIII", *divmod(time_us, 10**6), len(expected), len(expected))
    assert sent.records == [record + expected]


@pytest.mark.parametrize("name", ["mrpt_vlp16_gps", "veloview_hdl32e_monterey", "jerry_vlp16"])
@pytest.mark.parametrize(("kind", "size"), [("data", 1206), ("position", 512)])
def test_headers_are_those_of_recordings(name, kind, size):
    """All 42 bytes of each frame, given its own address, number and second half of the MAC address.

    The recording of 2014 firmware has another header before its position packets: that of its data packets.
    """
    sensor = load_sensor("hdl-32e" if "hdl32e" in name else "vlp-16")
    with open(recording(f"{name}.pcap"), "rb") as file:
        real = [frame for _, frame in dpkt.pcap.Reader(file) if len(frame) == 42 + size]
    assert len(real) > 10
    header = getattr(facts(sensor).headers, kind)
    same = 0
    for frame in real:
        host = socket.inet_ntoa(frame[26:30])
        port = int.from_bytes(frame[36:38])
        payload = np.frombuffer(frame[42:], np.uint8)[None]
        number = int.from_bytes(frame[18:20])
        sent = Payloads(np.array([0]), payload, port, facts(sensor).headers, header, number)
        ours = ethernet_frames(host, sent).records[0][16:]
        unit = slice(9, 12)  # of the MAC address; ours is made of the IP address
        same += ours[: unit.start] + frame[unit] + ours[unit.stop :] == frame
    assert same == (0 if (name, kind) == ("jerry_vlp16", "position") else len(real))


def test_headers_of_other_models():
    """As the facts have it: an HDL-64E sends from port 443, with TTL 128 and without "do not fragment"."""
    headers = facts(load_sensor("hdl-64e-s3")).headers
    payloads = Payloads(np.array([0]), np.zeros((1, 1206), np.uint8), 2368, headers, headers.data)
    record = ethernet_frames("10.0.0.9", payloads)
    packet = dpkt.ethernet.Ethernet(record.records[0][16:]).data
    assert (packet.ttl, packet.df, packet.data.sport, packet.data.dport, packet.data.sum) == (128, 0, 443, 2368, 0)
    assert dpkt.in_cksum(record.records[0][30:50]) == 0


def test_models_without_headers(tmp_path):
    """They cannot be exported; and a position packet needs a header too."""
    text = catalogue()["vlp-16"].read_text()
    (tmp_path / "a.yaml").write_text(text[: text.index("\n  headers:")])
    rig = "name: r\nsensors: [{name: s, model: a.yaml, position_m: [0, 0, 2]}]"
    (tmp_path / "rig.yaml").write_text(rig)
    with pytest.raises(ConfigError, match=r"s: sensor 'vlp-16' cannot be exported: its file has no velodyne\.headers"):
        simulated_packets(
            load_rig(tmp_path / "rig.yaml"), scene(tmp_path, "ground: {reflectivity: 9}"), np.eye(4), SECOND_NS
        )
    lines = text.splitlines(keepends=True)
    (tmp_path / "a.yaml").write_text("".join(line for line in lines if "position: {ttl" not in line))
    with pytest.raises(
        ConfigError, match=r"a\.yaml:\d+:3: velodyne\.headers\.position: missing, as there is a position"
    ):
        codec(load_rig(tmp_path / "rig.yaml").mounts[0].sensor)
    (tmp_path / "a.yaml").write_text(text.replace("destination_ip: 255.255.255.255", "destination_ip: 255.255.255.256"))
    with pytest.raises(ConfigError, match=r"headers\.destination_ip: '255\.255\.255\.256' is not an IPv4 address"):
        codec(load_rig(tmp_path / "rig.yaml").mounts[0].sensor)


PPS = vd.TelemetryPacket.PpsStatus


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "pps", "status", "sentence"),
    [
        ("vlp-16", "locked", PPS.LOCKED, "$GPRMC,000000.00,A,"),
        ("vlp-16", "synchronising", PPS.SYNCHRONIZING, "$GPRMC,000000.00,V,,,,,,,010126,,,N*"),
        ("vlp-16", "error", PPS.ERROR, "$GPRMC,000000.00,V,,,,,,,010126,,,N*"),
        ("vlp-16", "absent", PPS.ABSENT, ""),
        ("hdl-32e", "locked", PPS.LOCKED, "$GPRMC,000000.00,A,"),
        ("hdl-32e", "absent", PPS.ABSENT, "$GPRMC,000000.00,V,,,,,,,010100,,,N*"),
    ],
)
def test_states_of_the_pulse(tmp_path, model, pps, status, sentence):
    """As the rig says, read by another parser: without a lock no fix, without a receiver no sentence or 2000-01-01."""
    rig = f"name: r\nsensors: [{{name: s, model: {model}, position_m: [0, 0, 2], velodyne: {{pps: {pps}}}}}]"
    (tmp_path / "rig.yaml").write_text(rig)
    stage = scene(tmp_path, "ground: {reflectivity: 9}")
    write_pcap(
        tmp_path / "a.pcap", simulated_packets(load_rig(tmp_path / "rig.yaml"), stage, np.eye(4), 3 * SECOND_NS // 2)[0]
    )
    sent = [d.payload for d in datagrams_of(tmp_path / "a.pcap") if d.port == 8308]
    assert len(sent) == math.ceil(1.5 * facts(load_sensor(model)).position_packet.rate_hz)
    read = [vd.TelemetryPacket(payload) for payload in sent]
    assert {packet.pps_status for packet in read} == {status}
    assert read[0].nmea_sentence.startswith(sentence)
    assert bool(read[0].nmea_sentence.strip("\0\r\n")) == bool(sentence)
    if sentence:
        assert read[-1].nmea_sentence.startswith(sentence.replace("000000", "000001"))


@pytest.mark.parametrize("name", ["hdl-64e-s2", "hdl-64e-s3"])
@pytest.mark.parametrize(
    ("pps", "value"), [("locked", b"A"), ("synchronising", b"V"), ("error", b"V"), ("absent", b"\0")]
)
def test_states_of_the_pulse_in_status_bytes(tmp_path, name, pps, value):
    """What sends no position packets says it beside the letter G."""
    (tmp_path / "rig.yaml").write_text(
        f"name: r\nsensors: [{{name: s, model: {name}, position_m: [0, 0, 2], velodyne: {{pps: {pps}}}}}]"
    )
    stage = scene(tmp_path, "ground: {reflectivity: 9}")
    write_pcap(
        tmp_path / "a.pcap", simulated_packets(load_rig(tmp_path / "rig.yaml"), stage, np.eye(4), SECOND_NS // 50)[0]
    )
    sent = [d.payload for d in datagrams_of(tmp_path / "a.pcap")]
    assert {payload[1205:] for payload in sent if payload[1204:1205] == b"G"} == {value}
    assert {len(payload) for payload in sent} == {1206}


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("pps: lost", "pps: 'lost' is not allowed; allowed: 'absent', 'synchronising', 'locked' or 'error'"),
        ("fix_rate_hz: 3", "fix_rate_hz: 3 is not allowed; allowed: 1, 2, 4, 5, 10 or 20"),
        ("fix_rate_hz: '1'", "fix_rate_hz: '1' is not allowed; allowed: 1, 2, 4, 5, 10 or 20"),
        ("fix_rate_hz: true", "fix_rate_hz: true is not a whole number"),
    ],
)
def test_what_a_receiver_cannot_be(tmp_path, said, message):
    """One line that begins with the place in the file."""
    text = f"name: r\nsensors: [{{name: s, model: vlp-16, position_m: [0, 0, 2], velodyne: {{{said}}}}}]"
    (tmp_path / "rig.yaml").write_text(text)
    stage = scene(tmp_path, "ground: {reflectivity: 9}")
    with refused(message, rf"^{tmp_path}/rig\.yaml:2:\d+: sensors\[0\]\.velodyne\.", ConfigError):
        simulated_packets(load_rig(tmp_path / "rig.yaml"), stage, np.eye(4), SECOND_NS)


@given(
    st.lists(st.lists(st.integers(0, 9), max_size=12).map(sorted), min_size=1, max_size=4),
    st.integers(1, 5),
)
def test_the_order_of_time(streams, size):
    """Merged batches are what sorting all would give; of the same time, the first stream's come first."""

    def batches(number, times):
        for i in range(0, len(times), size):
            part = times[i : i + size]
            yield EthernetFrames(np.array(part), [b"%d %d %d" % (t, number, i + k) for k, t in enumerate(part)])

    merged = list(in_time_order([batches(number, times) for number, times in enumerate(streams)]))
    expected = sorted((t, number, k) for number, times in enumerate(streams) for k, t in enumerate(times))
    got = [tuple(map(int, record.split())) for frames in merged for record in frames.records]
    assert got == expected
    assert [t for frames in merged for t in frames.time_ns.tolist()] == [t for t, *_ in expected]


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_do_not_matter(tmp_path, threads):
    """Four sensors of three models, moving or not: the same bytes as by as many threads as there are cores."""
    lines = [
        f"- {{name: s{i}, model: {model}, position_m: [{i}, 0, 2], return_mode: {mode}, azimuth_fov_deg: [{sector}]}}"
        for i, (model, mode, sector) in enumerate(
            [("vlp-16", "strongest", "0, 360"), ("vls-128", "dual", "300, 40"), ("hdl-64e-s2", "last", "0, 360")]
        )
    ]
    (tmp_path / "rig.yaml").write_text("name: r\nsensors:\n" + "\n".join(lines))
    rig = load_rig(tmp_path / "rig.yaml")
    rig = Rig("r", (*rig.mounts, mount(9)))
    box = (
        "boxes: [{name: b, center_m: [9, 0, 1], size_m: [2, 9, 2], reflectivity: 9, motion: {velocity_m_s: [1, 0, 0]}}]"
    )
    stage = scene(tmp_path, f"ground: {{reflectivity: 9}}\n{box}")
    for name, options in (("a", SimulationOptions()), ("b", SimulationOptions(threads=threads, chunk_ns=9_000_000))):
        write_pcap(
            tmp_path / name, in_time_order(simulated_packets(rig, stage, np.eye(4), SECOND_NS // 8, options=options))
        )
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
