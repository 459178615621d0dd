"""Recordings as firings and back: whole files byte for byte, what firings say by hand, changed returns, bad files."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, simulated_frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import LidarcfgError
from lidarcfg.io.firings import save_capture, save_firings
from lidarcfg.packets.robosense.layout import HELIOS
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.simulate.tasks import START_NS
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, datagrams_of, no_warning, recording, write_datagrams
from tests.command_line import lidarcfg
from tests.refusals import refused

# Of each recording: which bytes of its packets firings do not say, and from where the sensor's family has them.
VELODYNE = {
    "mrpt_vlp16_gps": set(),
    "jerry_vlp16": {1205},  # the product id of old firmware
    "nebula_vlp16": set(),
    "veloview_hdl32e_monterey": set(),
    "nebula_vlp32": set(),
    "nebula_vls128": set(),
}
HESAI = {  # the state of the sensor
    "hesai/nebula_xt32": {*range(1052, 1062), 1063},
    "hesai/nebula_xt16": {*range(540, 550), 551},
    "hesai/nebula_qt128": {1045, *range(1057, 1064), *range(1067, 1070), *range(1091, 1095)},
}


OUSTER = {  # whether pixels have bits that are in no field of the profile
    "OS-0-32-U1_v2.2.0_1024x10": False,
    "OS-1-128_767798045_1024x10_20230712_120049": False,
    "OS-2-128-U1_v2.3.0_1024x10": True,
    "OS-2-32-U0_v2.0.0_1024x10": True,
    "crc_test": False,
}


def converted(*words):
    """`lidarcfg convert` in this process, without a word."""
    assert not cli.main(["convert", *map(str, words), "--quiet"], prog_name="lidarcfg", standalone_mode=False)


def there_and_back(capture, tmp_path):
    """The columns of a capture, and the capture that they become again."""
    converted(capture, "-o", tmp_path / "a.npz")
    converted(tmp_path / "a.npz", "-o", tmp_path / "back.pcap")
    with np.load(tmp_path / "a.npz") as arrays:
        return dict(arrays), tmp_path / "back.pcap"


def rest_of(columns, source, size):
    """Where in packets of this size the bytes are that firings do not say."""
    return set((columns[f"{source}/rest_at"] % size).tolist())


@pytest.mark.parametrize("name", [*VELODYNE, *HESAI])
def test_recordings_come_back_whole(name, tmp_path):
    """Byte for byte: headers, position packets, order; what is kept beside firings is listed."""
    path = recording(f"{name}.pcap")
    columns, back = there_and_back(path, tmp_path)
    assert back.read_bytes() == path.read_bytes()
    size = max(len(one.payload) for one in datagrams_of(path))
    assert rest_of(columns, 0, size) <= (VELODYNE | HESAI)[name]
    assert np.isfinite(columns["0/range_m"]).sum() > 15_000


def test_a_helios_comes_back_whole(tmp_path):
    """Beside firings are counters and states of the header, and intensities where there is no distance."""
    path = recording("robosense/nebula_helios16p.pcap")
    columns, back = there_and_back(path, tmp_path)
    assert back.read_bytes() == path.read_bytes()
    head = {8, 9, 10, 11, 16, 18, 19, 30, 31, 32, 38, 39}
    intensities = {42 + 100 * block + 4 + 3 * channel + 2 for block in range(12) for channel in range(32)}
    assert rest_of(columns, 0, 1248) <= head | intensities
    payloads = [one.payload for one in datagrams_of(path) if one.port == 6699]
    for at in columns["0/rest_at"].tolist():
        if at % 1248 in intensities:
            packet = payloads[at // 1248]
            assert packet[at % 1248 - 2 : at % 1248] == b"\0\0"


@pytest.mark.parametrize("name", OUSTER)
def test_ousters_come_back_whole(name, tmp_path):
    """CRCs, states, all fields; ranges are those of the points that decoding makes."""
    path = recording(f"ouster/{name}.pcap")
    columns, back = there_and_back(path, tmp_path)
    assert back.read_bytes() == path.read_bytes()
    assert bool(len(columns["0/rest"])) == OUSTER[name]
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    valid = np.repeat(columns["0/more/valid"].ravel(), len(columns["0/laser"]) // columns["0/more/valid"].size)
    returned = np.isfinite(columns["0/range_m"]) & valid[:, None]
    assert returned.sum() == len(cloud.xyz)
    assert sorted(columns["0/reflectivity"][returned]) == sorted(cloud.intensity)
    columns["0/more/said"] = np.array(str(columns["0/more/said"]).replace("columns_per_packet", "columns"))
    np.savez(tmp_path / "b.npz", **columns)
    with pytest.raises(LidarcfgError, match="0/more/said: missing, or of another type"):
        save_capture(tmp_path / "b.pcap", tmp_path / "b.npz")
    columns["0/more/said"] = np.array(str(columns["0/more/said"]).replace('"columns"', '"columns_per_pocket"'))
    np.savez(tmp_path / "b.npz", **columns)
    with pytest.raises(LidarcfgError, match="the description of an Ouster's packets is invalid"):
        save_capture(tmp_path / "b.pcap", tmp_path / "b.npz")


def frames_in(path):
    """The frames of a classic pcap, by dpkt."""
    import dpkt

    with path.open("rb") as file:
        return [bytes(frame) for _, frame in dpkt.pcap.Reader(file)]


def test_fragments_come_back_whole(tmp_path):
    """Two Ousters whose packets came in IP fragments; what is changed goes into the same fragments."""
    path = recording("ouster/same_ports_legacy.pcap")
    columns, back = there_and_back(path, tmp_path)
    assert back.read_bytes() == path.read_bytes()
    assert len(columns["0/rest"]) == len(columns["1/rest"]) == 0
    cloud = concatenate(list(decode_pcap(path, no_warning)))
    returned = [np.isfinite(columns[f"{i}/range_m"]) for i in range(2)]
    assert sum(one.sum() for one in returned) == len(cloud.xyz) > 500
    bright = np.concatenate([columns[f"{i}/reflectivity"][one] for i, one in enumerate(returned)])
    assert sorted(bright) == sorted(cloud.intensity)
    changed = columns["1/range_m"][returned[1]] + 1
    columns["1/range_m"] += 1
    np.savez(tmp_path / "b.npz", **columns)
    for file in path.parent.glob("same_ports_legacy*.json"):
        (tmp_path / file.name.replace("same_ports_legacy", "b")).write_bytes(file.read_bytes())
    converted(tmp_path / "b.npz", "-o", tmp_path / "b.pcap")
    columns, _ = there_and_back(tmp_path / "b.pcap", tmp_path)
    assert np.allclose(columns["1/range_m"][returned[1]], changed, rtol=0, atol=1e-9)
    before = frames_in(path)
    after = frames_in(tmp_path / "b.pcap")
    assert [frame[:34] for frame in before] == [frame[:34] for frame in after]  # sizes, ids, offsets: IP headers
    assert sum(a != b for a, b in zip(before, after, strict=True)) >= 9


def test_fragments_in_disorder_come_back_whole(tmp_path):
    """Out of order, repeated, missing, and with the same id again: what makes no datagram stays as it is."""
    path = recording("ouster/same_ports_legacy.pcap")
    data = path.read_bytes()
    records = []
    at = 24
    while at < len(data):
        size = 16 + int.from_bytes(data[at + 8 : at + 12], "little")
        records.append(data[at : at + size])
        at += size
    for file in path.parent.glob("same_ports_legacy*.json"):
        (tmp_path / file.name.replace("same_ports_legacy", "a")).write_bytes(file.read_bytes())
    parts = [i for i, one in enumerate(records) if int.from_bytes(one[36:38]) & 0x3FFF]
    rng = np.random.default_rng(3)
    packets = []
    for _ in range(2):
        order = list(rng.permutation(parts))
        repeated = [*order, order[int(rng.integers(len(order)))]]
        for mixed in (order, repeated, order[1:], [*parts[:3], *parts]):
            (tmp_path / "a.pcap").write_bytes(data[:24] + b"".join(records[i] for i in mixed))
            columns, back = there_and_back(tmp_path / "a.pcap", tmp_path)
            assert back.read_bytes() == (tmp_path / "a.pcap").read_bytes()
            packets.append(sum(one["packets"] for one in json.loads(str(columns["sources"]))["sources"]))
    assert set(packets) == {1, 2}


def blocks_of(path, order):
    """A pcapng of the frames of a classic pcap: nanoseconds, options, comments and names of hosts; two blocks of them old."""

    def block(kind, body):
        body += bytes(-len(body) % 4)
        size = struct.pack(order + "I", len(body) + 12)
        return struct.pack(order + "I", kind) + size + body + size

    def option(code, value):
        return struct.pack(order + "HH", code, len(value)) + value + bytes(-len(value) % 4)

    end = bytes(4)
    yield block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1) + option(4, b"a drive") + end)
    yield block(1, struct.pack(order + "HHI", 1, 0, 0) + option(9, b"\x09") + end)
    yield block(4, struct.pack(order + "HH", 1, 9) + b"\xc0\xa8\x01\xc9lidar\0" + bytes(2) + end)
    for n, frame in enumerate(frames_in(path)):
        ticks = 1_700_000_000 * 10**9 + n * 1_327_104
        words = ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame)
        frame += bytes(-len(frame) % 4)
        if n in (3, 7):
            yield block(2, struct.pack(order + "HHIIII", 0, 0, *words) + frame)
        else:
            yield block(6, struct.pack(order + "IIIII", 0, *words) + frame + option(1, b"n" * (n % 5)) * (n % 3) + end)
        if n % 50 == 0:
            yield block(0x0BAD, b"of a program that nobody knows")


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("name", ["mrpt_vlp16_gps", "ouster/same_ports_legacy"])
def test_pcapngs_come_back_whole(tmp_path, order, name):
    """Byte for byte, and the firings are those of the same frames in a pcap."""
    path = recording(f"{name}.pcap")
    for file in path.parent.glob("same_ports_legacy*.json"):
        (tmp_path / file.name.replace("same_ports_legacy", "a")).write_bytes(file.read_bytes())
    data = b"".join(blocks_of(path, order)) + b"\x06\0\0\0"
    (tmp_path / "a.pcapng").write_bytes(data)
    converted(tmp_path / "a.pcapng", "-o", tmp_path / "a.npz")
    converted(tmp_path / "a.npz", "-o", tmp_path / "back.pcapng")
    assert (tmp_path / "back.pcapng").read_bytes() == data
    with pytest.raises(LidarcfgError, match=r"a.npz: holds a pcapng; the output's suffix must be .pcapng"):
        save_capture(tmp_path / "back.pcap", tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        found = dict(arrays)
    converted(path, "-o", tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as arrays:
        for key in ("0/range_m", "0/reflectivity", "0/laser"):
            assert np.array_equal(found[key], arrays[key])
    assert found["0/host_ns"][0] >= 1_700_000_000 * 10**9
    assert (np.diff(found["0/host_ns"]) % 1_327_104 == 0).all()


LINKS = {  # kinds of link, and what stands before an IP header: RFC 894 with a tag of IEEE 802.1Q, tcpdump.org's lists
    "tagged": (1, bytes(12) + b"\x81\x00\x00\x05\x08\x00"),
    "cooked": (113, bytes(14) + b"\x08\x00"),
    "cooked2": (276, b"\x08\x00" + bytes(18)),
    "raw": (101, b""),
    "ipv4": (228, b""),
    "loopback": (0, b"\x02\0\0\0"),
}


@pytest.mark.parametrize("name", LINKS)
def test_other_links_come_back_whole(tmp_path, name):
    """VLAN tags, Linux cooked of both versions, raw IP, a loopback: the firings are those of Ethernet frames."""
    path = recording("jerry_vlp16.pcap")
    link, before = LINKS[name]
    frames = [before + frame[14:] for frame in frames_in(path)[:40]]
    records = (struct.pack("<IIII", n, 0, len(frame), len(frame)) + frame for n, frame in enumerate(frames))
    data = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link) + b"".join(records)
    (tmp_path / "a.pcap").write_bytes(data)
    columns, back = there_and_back(tmp_path / "a.pcap", tmp_path)
    assert back.read_bytes() == data
    write_datagrams(tmp_path / "c.pcap", datagrams_of(path)[:40])
    known, _ = there_and_back(tmp_path / "c.pcap", tmp_path)
    for key in ("0/range_m", "0/reflectivity", "0/encoder_rad"):
        assert np.array_equal(columns[key], known[key])


def test_damaged_captures_come_back_whole_or_are_refused(tmp_path):
    """Bytes changed, cut out, repeated; the end missing: of a pcap, a pcapng, and one of IP fragments."""
    rng = np.random.default_rng(5)
    found = 0
    said = []
    for file in recording("ouster/same_ports_legacy.pcap").parent.glob("same_ports_legacy*.json"):
        (tmp_path / file.name.replace("same_ports_legacy", "a")).write_bytes(file.read_bytes())
    write_datagrams(tmp_path / "s.pcap", datagrams_of(recording("nebula_vlp16.pcap"))[:20])
    seeds = [(tmp_path / "s.pcap").read_bytes(), b"".join(blocks_of(tmp_path / "s.pcap", ">"))]
    seeds.append(recording("ouster/same_ports_legacy.pcap").read_bytes())
    for n in range(24):
        data = bytearray(seeds[n % 3])
        for i in rng.integers(40, len(data), 3).tolist():
            data[i] = rng.integers(256)
        if n % 4 == 1:
            i, j = sorted(rng.integers(40, len(data), 2).tolist())
            data = data[:i] + data[j:] if n % 8 == 1 else data[:j] + data[i:]
        if n % 4 == 2:
            del data[int(rng.integers(40, len(data))) :]
        capture = tmp_path / ("a.pcapng" if n % 3 == 1 else "a.pcap")
        capture.write_bytes(data)
        try:
            save_firings(tmp_path / "a.npz", capture, None, lambda warning: None)
        except LidarcfgError as error:
            said.append(str(error))
            continue
        save_capture(capture.with_stem("b"), tmp_path / "a.npz")
        assert capture.with_stem("b").read_bytes() == data
        found += 1
    assert found > 5
    assert not any("\n" in one for one in said)


def test_several_modes_in_one_stream(tmp_path):
    """Dual, then strongest, then last returns of two makers: sources of their own, with the firings of each alone."""
    modes = {"dual": 0, "strongest": 30_000_000, "last": 60_000_000}
    street = load_scene(STREET)
    streams = []
    for mode, begin_ns in modes.items():
        sensors = "".join(
            f"  - {{name: {one}, model: {one}, position_m: [0, {i}, 2], return_mode: {mode}}}\n"
            for i, one in enumerate(("vlp-16", "pandar-xt16"))
        )
        (tmp_path / "rig.yaml").write_text(f"name: r\nsensors:\n{sensors}")
        rig = load_rig(tmp_path / "rig.yaml")
        frames = list(in_time_order(simulated_frames(rig, street, np.eye(4), 20_000_000, START_NS + begin_ns)))
        write_pcap(tmp_path / f"{mode}.pcap", frames)
        streams += frames
    write_pcap(tmp_path / "a.pcap", streams)
    together, back = there_and_back(tmp_path / "a.pcap", tmp_path)
    assert back.read_bytes() == (tmp_path / "a.pcap").read_bytes()
    sources = json.loads(str(together["sources"]))["sources"]
    assert sorted((one["sensor"]["name"], one["return_mode"]) for one in sources) == sorted(
        (model, mode) for model in ("vlp-16", "pandar-xt16") for mode in modes
    )
    for mode in modes:
        alone, _ = there_and_back(tmp_path / f"{mode}.pcap", tmp_path)
        for i, one in enumerate(json.loads(str(alone["sources"]))["sources"]):
            (same,) = [
                k for k, two in enumerate(sources) if (two["sensor"], two["return_mode"]) == (one["sensor"], mode)
            ]
            for key in ("range_m", "reflectivity", "laser", "host_ns"):
                assert np.array_equal(alone[f"{i}/{key}"], together[f"{same}/{key}"])


@pytest.mark.parametrize("model", ["helios-32", "helios-16p"])
@pytest.mark.parametrize("late", [False, True])
def test_a_helios_that_changes_its_mode(tmp_path, model, late):
    """DIFOP packets say when; where they come late, dual returns are still told from single ones by their layout."""
    modes = {"dual": 0, "strongest": 30_000_000, "last": 60_000_000}
    street = load_scene(STREET)
    streams = []
    counts = {}
    for mode, begin_ns in modes.items():
        sensor = f"{{name: s, model: {model}, position_m: [0, 0, 2], return_mode: {mode}}}"
        (tmp_path / "rig.yaml").write_text(f"name: r\nsensors: [{sensor}]\n")
        frames = simulated_frames(load_rig(tmp_path / "rig.yaml"), street, np.eye(4), 20_000_000, START_NS + begin_ns)
        write_pcap(path := tmp_path / f"{mode}.pcap", in_time_order(frames))
        datagrams = datagrams_of(path)
        difop = next(one for one in datagrams if one.payload.startswith(bytes.fromhex("a5ff005a")))
        datagrams.remove(difop)
        counts[mode] = len(datagrams)
        if late and mode == "strongest":
            payload = np.frombuffer(difop.payload, HELIOS.difop).copy()
            payload["microseconds"] += 15_000
            difop = replace(difop, payload=payload.tobytes())
        streams += [difop, *datagrams]
    write_datagrams(tmp_path / "a.pcap", streams)
    together, back = there_and_back(tmp_path / "a.pcap", tmp_path)
    assert back.read_bytes() == (tmp_path / "a.pcap").read_bytes()
    sources = json.loads(str(together["sources"]))["sources"]
    assert {one["return_mode"]: one["packets"] for one in sources} == counts
    for i, one in enumerate(sources):
        alone, _ = there_and_back(tmp_path / f"{one['return_mode']}.pcap", tmp_path)
        for key in ("range_m", "reflectivity", "laser", "encoder_rad", "rest"):
            assert np.array_equal(alone[f"0/{key}"], together[f"{i}/{key}"])


def test_packets_of_a_mode_that_is_not_known_are_kept(tmp_path):
    datagrams = datagrams_of(recording("hesai/nebula_xt16.pcap"))[:200]
    for n in (20, 21, 150):
        payload = bytearray(datagrams[n].payload)
        payload[550] = 0x7F
        datagrams[n] = replace(datagrams[n], payload=bytes(payload))
    write_datagrams(tmp_path / "a.pcap", datagrams)
    done = lidarcfg("convert", "a.pcap", "-o", "a.npz", cwd=tmp_path)
    assert (
        "packets that are not converted are kept as they are; 192.168.1.201:2368: 3 packets: pandar-xt16: return mode 0x7F"
        in done.stderr
    )
    assert "of 197 packets" in done.stdout
    converted(tmp_path / "a.npz", "-o", tmp_path / "b.pcap")
    assert (tmp_path / "b.pcap").read_bytes() == (tmp_path / "a.pcap").read_bytes()


def test_firings_by_hand(tmp_path):
    """A VLP-16's packet with dual returns, by the manual: even blocks the last return, odd ones the strongest."""
    path = recording("nebula_vlp16.pcap")
    columns, _ = there_and_back(path, tmp_path)
    payload = datagrams_of(path)[0].payload
    seen = 0
    for block in range(0, 12, 2):
        azimuth = struct.unpack_from("<H", payload, 100 * block + 2)[0] / 100
        for slot in range(32):
            firing = 16 * block + slot
            for column, of in ((1, block), (0, block + 1)):
                units, strength = struct.unpack_from("<HB", payload, 100 * of + 4 + 3 * slot)
                assert columns["0/range_m"][firing, column] == (units * 0.002 if units else np.inf)
                assert columns["0/reflectivity"][firing, column] == strength
                seen += units > 0
            assert columns["0/laser"][firing] == slot % 16
            head_deg = np.degrees(columns["0/encoder_rad"][firing])
            turned = (slot // 16 * 55.296 + slot % 16 * 2.304) * 1e-6 * 3600  # at 600 rpm
            assert head_deg == pytest.approx(azimuth + turned, abs=0.03)
    assert seen > 150


EXPORTS = {
    "hdl-64e-s3": "rpm: 600",
    "vls-128": "return_mode: dual, azimuth_fov_deg: [300, 40]",
    "vlp-32c": "return_mode: last, azimuth_fov_deg: [30, 90]",
    "hdl-32e": "rpm: 1200",
    "pandar-xt32": "return_mode: dual",
    "pandar-xt16": "return_mode: first-last",
    "xt32m2x": "return_mode: first-strongest",
    "qt128": "return_mode: last",
    "helios-16p": "return_mode: dual",
}


def test_exports_come_back_whole(tmp_path):
    """Several makers in one capture, other return modes, narrow fields of view; only an HDL-64E has status bytes besides."""
    sensors = [
        f"{{name: s{i}, model: {model}, position_m: [0, {i}, 2], {keys}}}"
        for i, (model, keys) in enumerate(EXPORTS.items())
    ]
    (tmp_path / "rig.yaml").write_text("name: r\nsensors:\n" + "".join(f"  - {one}\n" for one in sensors))
    rig = load_rig(tmp_path / "rig.yaml")
    write_pcap(tmp_path / "a.pcap", in_time_order(simulated_frames(rig, load_scene(STREET), np.eye(4), 30_000_000)))
    columns, back = there_and_back(tmp_path / "a.pcap", tmp_path)
    assert back.read_bytes() == (tmp_path / "a.pcap").read_bytes()
    assert sum(key.endswith("/range_m") for key in columns) == len(EXPORTS)
    rest = [rest_of(columns, i, one["size"]) for i, one in enumerate(json.loads(str(columns["sources"]))["sources"])]
    assert all(not one or one <= {1204, 1205} for one in rest)
    assert sum(map(bool, rest)) == 1


def test_returns_may_be_changed(tmp_path):
    """One firing is given another return, one none: decoding shows just that; and a checksum that was there is right."""
    path = recording("mrpt_vlp16_gps.pcap")
    columns, _ = there_and_back(path, tmp_path)
    hit = np.flatnonzero(np.isfinite(columns["0/range_m"][:, 0]))[[100, 5000]]
    columns["0/range_m"][hit, 0] = 42.5, np.inf
    columns["0/reflectivity"][hit[0], 0] = 99
    np.savez(tmp_path / "b.npz", **columns)
    converted(tmp_path / "b.npz", "-o", tmp_path / "b.pcap")
    before, after = (concatenate(list(decode_pcap(one, no_warning))) for one in (path, tmp_path / "b.pcap"))
    assert len(after.xyz) == len(before.xyz) - 1
    kept = np.delete(before.xyz, 5000, axis=0)
    moved = np.flatnonzero((after.xyz != kept).any(axis=1))
    assert len(moved) == 1
    assert after.intensity[moved[0]] == 99
    far = after.xyz[moved[0]] - [
        0,
        0,
        np.array(load_sensor("vlp-16").beams.vertical_offset_mm)[columns["0/laser"][hit[0]]] / 1000,
    ]
    assert np.linalg.norm(far) == pytest.approx(42.5, abs=0.001)


def test_checksums_are_made_right(tmp_path):
    """Of a sensor whose datagrams have them; dpkt counts."""
    import dpkt

    (tmp_path / "rig.yaml").write_text("name: r\nsensors: [{name: s, model: pandar-xt16, position_m: [0, 0, 2]}]")
    rig = load_rig(tmp_path / "rig.yaml")
    stage = load_scene(STREET)
    write_pcap(tmp_path / "a.pcap", in_time_order(simulated_frames(rig, stage, np.eye(4), 5_000_000)))
    data = (tmp_path / "a.pcap").read_bytes()
    with (tmp_path / "a.pcap").open("rb") as file:
        frames = [frame for _, frame in dpkt.pcap.Reader(file)]
    with (tmp_path / "summed.pcap").open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for n, frame in enumerate(frames):
            ip = dpkt.ethernet.Ethernet(bytes(frame)).data
            ip.data.sum = 0
            ip.sum = 0
            writer.writepkt(bytes(frame[:14]) + bytes(ip), 1_700_000_000 + n / 1000)
    columns, back = there_and_back(tmp_path / "summed.pcap", tmp_path)
    assert back.read_bytes() == (tmp_path / "summed.pcap").read_bytes() != data
    columns["0/range_m"][:] = 7.0
    np.savez(tmp_path / "b.npz", **columns)
    converted(tmp_path / "b.npz", "-o", tmp_path / "b.pcap")
    with (tmp_path / "b.pcap").open("rb") as file:
        frames = [frame for _, frame in dpkt.pcap.Reader(file)]
    for frame in frames:
        udp = dpkt.ethernet.Ethernet(frame).data.data
        recorded = udp.sum
        udp.sum = 0
        ip = dpkt.ethernet.Ethernet(frame).data
        ip.data.sum = 0
        ip.sum = 0
        again = dpkt.ip.IP(bytes(ip))
        assert again.data.sum == recorded != 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("0/laser"), "0/laser: missing"),
        (
            lambda c: c.update({"0/range_m": c["0/range_m"].astype("f4")}),
            "0/range_m: float32 of 2 dimensions; allowed: float64 of 2",
        ),
        (
            lambda c: c.update({"0/time_ns": c["0/time_ns"][:-1]}),
            "0/time_ns: has 9215 rows; allowed: 9216, as recorded",
        ),
        (lambda c: c["0/range_m"].__setitem__((3, 0), np.nan), "0/range_m[3]: nan is not allowed; allowed: 0 to inf"),
        (lambda c: c["0/laser"].__setitem__(7, 16), "0/laser[7]: 16 is not allowed; allowed: 0 to 15"),
        (
            lambda c: c["0/laser"].__setitem__(slice(2), [1, 0]),
            "0/laser: not the lasers as recorded; firings stay in the order",
        ),
        (lambda c: c["0/rest_at"].__setitem__(0, 10**9), "0/rest_at[0]: 1000000000 is not allowed"),
        (lambda c: c.update({"sources": np.array("{}")}), "sources: not what a recording as firings says"),
        (lambda c: c.update({"source": c["source"][:-1]}), "its records do not belong together"),
        (lambda c: c["at"].__setitem__(0, -5), "its records do not belong together"),
        (lambda c: c["packet"].__setitem__(0, 24), "its records do not belong together"),
        (lambda c: c["headers"].__setitem__(0, 10**6), "its records do not belong together"),
        (
            lambda c: c.update(
                {"sources": np.array(str(c["sources"]).replace('"product_id": 34', '"product_id": 340'))}
            ),
            "product_id",
        ),
        (
            lambda c: c.update({"sources": np.array(str(c["sources"]).replace('"strongest", "f', '"dual", "f'))}),
            "1 returns of each firing",
        ),
    ],
)
def test_files_that_are_wrong(tmp_path, change, message):
    """One line, and nothing is written."""
    datagrams = [one for one in datagrams_of(recording("jerry_vlp16.pcap")) if one.port == 2368][:24]
    write_datagrams(tmp_path / "a.pcap", datagrams)
    columns, _ = there_and_back(tmp_path / "a.pcap", tmp_path)
    change(columns)
    np.savez(tmp_path / "b.npz", **columns)
    with refused(message):
        save_capture(tmp_path / "b.pcap", tmp_path / "b.npz")
    assert not (tmp_path / "b.pcap").exists()


def test_captures_that_are_not_taken_apart(tmp_path):
    path = recording("mrpt_vlp16_gps.pcap")
    cut = path.read_bytes()[:-100]
    (tmp_path / "cut.pcap").write_bytes(cut)
    converted(tmp_path / "cut.pcap", "-o", tmp_path / "cut.npz")
    converted(tmp_path / "cut.npz", "-o", tmp_path / "again.pcap")
    assert (tmp_path / "again.pcap").read_bytes() == cut
    (tmp_path / "no.pcapng").write_bytes(b"\x0a\x0d\x0d\x0a" + bytes(40))
    done = lidarcfg("convert", "no.pcapng", "-o", "no.npz", cwd=tmp_path, code=2)
    assert "no.pcapng: not a capture; allowed: pcap and pcapng" in done.stderr
    assert not (tmp_path / "no.npz").exists()
