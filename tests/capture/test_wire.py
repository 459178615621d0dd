"""Packets lost, doubled, late and overtaken on the wire: counted by hand in the capture, read by dpkt."""

import dpkt
import numpy as np
import pytest
import yaml

import lidarcfg
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.writer import Writer
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.sensors.faults import load_faults
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.simulate.drive import Drive
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.units import START_NS
from tests.capture_fixtures import datagrams_of, no_warning, scene
from tests.command_line import lidarcfg as command

DURATION_NS = 60_000_000
RIG = {
    "name": "two",
    "sensors": [
        {"name": "a", "model": "pandar-xt32", "position_m": (0.0, 1.0, 2.0)},
        {"name": "b", "model": "os1-32", "position_m": (0.0, -1.0, 2.0)},
    ],
}
FAULTS = {
    "lost": {"fraction": 0.3},
    "doubled": {"fraction": 0.3},
    "late": {"fraction": 0.3, "delay_s": 0.0031},
    "overtaken": {"fraction": 0.3, "by": 3},
}
SPAN_S = 0.01, 0.03


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    text = "boxes: [{name: b, center_m: [0, 0, 3], size_m: [30, 20, 8], reflectivity: 9}]"
    return scene(tmp_path_factory.mktemp("world"), text)


def exported(world, path, *faults, sensor="a", **options):
    """The packets of a capture: host time in µs, source address, bytes behind IP; a fragmented one is several."""
    given = [{"sensor": sensor, "start_s": SPAN_S[0], "end_s": SPAN_S[1], **one} for one in faults]
    rig = load_rig(RIG | {"faults": tuple(given)})
    hits = {}
    save_sidecar_files(path, rig.mounts)
    said = SimulationOptions(on_fault=lambda i, count: hits.update({i: hits.get(i, 0) + count}), **options)
    write_pcap(path, in_time_order(simulated_packets(rig, world, np.eye(4), DURATION_NS, vehicle=None, options=said)))
    with open(path, "rb") as file:
        found = [
            (round(at * 10**6) - START_NS // 1000, frame[26:30], frame[18:20] + frame[34:])
            for at, frame in dpkt.pcap.Reader(file)
        ]
    return found, hits


def of(packets, last):
    """Those of the sensor whose address ends so."""
    return [(at, content) for at, host, content in packets if host[3] == last]


@pytest.fixture(scope="module")
def plain(world, tmp_path_factory):
    return exported(world, tmp_path_factory.mktemp("plain") / "plain.pcap")[0]


@pytest.mark.parametrize("kind", FAULTS)
def test_each_fault_in_the_bytes(world, plain, tmp_path, kind):
    """Which packets are hit is read from what comes; all others are as without the fault."""
    found, hits = exported(world, tmp_path / "faulty.pcap", {"fault": kind, **FAULTS[kind]})
    assert of(found, 202) == of(plain, 202)
    before, after = of(plain, 201), of(found, 201)
    names = {content: n for n, (_, content) in enumerate(before)}
    assert len(names) == len(before)
    order = [names[content] for _, content in after]
    inside = [n for n, (at, _) in enumerate(before) if SPAN_S[0] * 1e6 <= at < SPAN_S[1] * 1e6]
    assert len(inside) > 40
    times = {n: [at for (at, _), m in zip(after, order, strict=True) if m == n] for n in range(len(before))}
    hit = {n for n in times if times[n] != [before[n][0]]}
    assert hits == {0: len(hit)}
    assert hit <= set(inside)
    assert 0.1 < len(hit) / len(inside) < 0.5
    if kind == "lost":
        assert order == [n for n in range(len(before)) if n not in hit]
    elif kind == "doubled":
        assert order == [n for n in range(len(before)) for _ in range(2 if n in hit else 1)]
    elif kind == "late":
        moved = [(at + 3100 * (n in hit), n) for n, (at, _) in enumerate(before)]
        assert order == [n for _, n in sorted(moved)]
        assert all(times[n] == [before[n][0] + 3100] for n in hit)
    else:
        assert all(times[n] == [before[n + 3][0]] for n in hit)
        place = {n: k for k, n in enumerate(order)}
        for n in hit:
            assert all((place[m] < place[n]) == (m <= n + 3) for m in set(place) - hit)
    assert [at for at, *_ in found] == sorted(at for at, *_ in found)


def test_decoding_finds_them(world, tmp_path):
    """As many lost, doubled and overtaken as were hit; no point is new, and those of lost packets alone are missing."""
    stats = {}
    points = {}
    for kind in ("lost", "doubled", "overtaken"):
        _, hits = exported(world, tmp_path / f"{kind}.pcap", {"fault": kind, **FAULTS[kind]})
        found = []
        cloud = decode_pcap(tmp_path / f"{kind}.pcap", no_warning, load_rig(RIG), on_stats=found.append)
        points[kind] = {tuple(row) for one in cloud for row in np.column_stack([one.time_ns, one.ring]).tolist()}
        stats[kind] = hits[0], found[0]
        assert found[1].lost == found[1].duplicates == found[1].reordered == 0
    assert stats["lost"][0] == stats["lost"][1].lost
    assert stats["doubled"][0] == stats["doubled"][1].duplicates
    assert stats["overtaken"][0] == stats["overtaken"][1].reordered
    assert stats["doubled"][1].lost == stats["overtaken"][1].lost == 0
    assert points["doubled"] == points["overtaken"] > points["lost"]


def test_the_same_whatever_the_chunks_and_threads(world, tmp_path):
    """Four faults at once, of a sensor whose packets are fragments, traced at once and in pieces of 3 ms."""
    faults = [{"fault": kind, **values} for kind, values in FAULTS.items()]
    for name, options in {"whole": {}, "pieces": {"chunk_ns": 3_000_000, "threads": 3}}.items():
        exported(world, tmp_path / f"{name}.pcap", *faults, sensor="b", **options)
    assert (tmp_path / "whole.pcap").read_bytes() == (tmp_path / "pieces.pcap").read_bytes()


def test_a_fragmented_packet_is_hit_whole(world, plain, tmp_path):
    """By IP's ids: no datagram of the Ouster lacks some of its fragments."""
    found, hits = exported(world, tmp_path / "lost.pcap", {"fault": "lost", "fraction": 0.5}, sensor="b")
    before, after = ([content[:2] for _, content in of(some, 202)] for some in (plain, found))
    counts = {one: (before.count(one), after.count(one)) for one in set(before)}
    assert {pair[1] for pair in counts.values()} <= {0} | {pair[0] for pair in counts.values()}
    assert max(pair[0] for pair in counts.values()) > 1
    assert all(pair[1] in (0, pair[0]) for pair in counts.values())
    assert sum(pair[1] == 0 for pair in counts.values()) == hits[0] > 5


def test_another_seed_hits_others(world, tmp_path):
    lost = {"fault": "lost", "fraction": 0.5}
    seeds = [exported(world, tmp_path / f"{seed}.pcap", lost | {"seed": seed})[0] for seed in (0, 0, 1)]
    assert seeds[0] == seeds[1] != seeds[2]


def test_the_manifest_has_what_was_done(tmp_path):
    """From a file on the command line and from a dict in Python: the same bytes, and the same in the manifest."""
    (tmp_path / "rig.yaml").write_text("name: r\nsensors: [{name: a, model: vlp-16, position_m: [0, 0, 2]}]\n")
    fault = {"fault": "lost", "sensor": "a", "start_s": 0.01, "end_s": 0.02, "fraction": 1.0}
    (tmp_path / "faults.yaml").write_text(yaml.safe_dump({"faults": [fault]}))
    words = "--scene", "data/scenes/street.yaml", "--duration", 0.03, "--faults", "faults.yaml"
    said = command("export", "rig.yaml", *words, "-o", "a.pcap", cwd=tmp_path).stdout
    done = yaml.safe_load((tmp_path / "a.pcap.yaml").read_text())["faults"]
    assert done == [
        {
            "injected": fault | {"seed": 0},
            "from_ns": START_NS + 10_000_000,
            "to_ns": START_NS + 20_000_000,
            "packets": 9,  # eight of 1.327 ms, complete from 10.617 to 19.907 ms, and one of its position
        }
    ]
    assert "a: lost from 0.01 to 0.02 s, 9 packets" in said
    lidarcfg.export(tmp_path / "rig.yaml", "data/scenes/street.yaml", tmp_path / "b.pcap", 0.03, faults=[fault])
    assert (tmp_path / "a.pcap").read_bytes() == (tmp_path / "b.pcap").read_bytes()
    assert yaml.safe_load((tmp_path / "b.pcap.yaml").read_text())["faults"] == done
    assert "faults: 1 × lost; of a" in command("validate", "faults.yaml", cwd=tmp_path).stdout
    done = command("export", "rig.yaml", *words, "-o", "a.ply", code=2, cwd=tmp_path).stderr
    assert "faults are of packets, for a .pcap; --faults none leaves them out" in done


def test_a_rig_has_faults_of_its_own(tmp_path):
    fault = {"fault": "overtaken", "sensor": "a", "start_s": 0.01, "end_s": 0.02, "fraction": 0.5, "by": 2}
    rig = load_rig(RIG | {"faults": (fault, fault | {"sensor": "b"})})
    save_rig(rig, tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml").faults == rig.faults
    assert [one.sensor for one in rig.without("a").faults] == ["b"]
    assert load_faults("none", "ab") == load_faults([], "ab") == ()
    assert load_faults(rig.faults, "ab") == rig.faults
    with pytest.raises(LidarcfgError, match=r"rig 'two' has faults, which only export makes"):
        Writer(Drive(rig), tmp_path / "a.pcap")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("fault: losd, sensor: a, start_s: 0, end_s: 1", "3:4: faults[0].fault: 'losd' is not allowed; did you mean"),
        ("sensor: a, start_s: 0, end_s: 1", "3:3: faults[0]: missing key fault; allowed: lost, doubled, late"),
        ("fault: lost, sensor: c, start_s: 0, end_s: 1", "3:17: faults[0].sensor: no sensor is called 'c'; allowed: a"),
        ("fault: lost, sensor: a, start_s: 1, end_s: 1", "3:40: faults[0].end_s: 1 is not after start_s, 1"),
        ("fault: lost, sensor: a, start_s: 0, end_s: 1, fraction: 0", "faults[0].fraction: 0 is too small"),
        ("fault: late, sensor: a, start_s: 0, end_s: 1", "faults[0].delay_s: missing"),
        ("fault: lost, sensor: a, start_s: 0, end_s: 1, by: 2", "faults[0].by: unknown key; allowed: fault, sensor"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, line, said):
    path = tmp_path / "faults.yaml"
    path.write_text(f"# faults\nfaults:\n- {{{line}}}\n")
    with pytest.raises(ConfigError) as error:
        load_faults(path, ["a"])
    assert said in str(error.value)


def test_in_a_vlan_a_fragmented_packet_is_hit_whole(world, tmp_path):
    """As without the tag, which stands before IP: the same packets come."""
    lost = {"fault": "lost", "sensor": "b", "start_s": SPAN_S[0], "end_s": SPAN_S[1], "fraction": 0.5}
    contents = []
    for tag in (None, 7):
        path = tmp_path / f"{tag}.pcap"
        sensors = ({**RIG["sensors"][1], "host": "192.168.1.202", **({"vlan_id": tag} if tag else {})},)
        rig = load_rig({"name": "one", "sensors": sensors, "faults": (lost,)})
        write_pcap(path, in_time_order(simulated_packets(rig, world, np.eye(4), DURATION_NS)))
        contents.append([one.payload for one in datagrams_of(path)])
    assert contents[0] == contents[1]
    assert len(contents[0]) > 30
