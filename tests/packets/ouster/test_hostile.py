"""Mutated packets and metadata: points that make sense, or one line that says what is wrong."""

import json
import random
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.errors import LidarcfgError
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.packets.ouster.telemetry import Metadata, read_metadata
from lidarcfg.sensors.rig import Mount
from tests.packets.ouster.test_encode import START_NS, mount

ODD = (None, True, -1, 0, 3, 1e300, -1e300, float("nan"), "", "a", "LEGACY", [], {}, [1, 2], {"a": 1}, 10**30)


def packets(one: Mount, number: int) -> tuple[Payloads, bytes]:
    """So many of them with returns everywhere, and their metadata."""
    family = codec(one.sensor)
    batch = next(family.schedule(one, START_NS, [range(number)]))
    count = len(batch.firings.time_ns)
    width = 1 + (one.return_mode == "dual")
    rng = np.random.default_rng(1)
    range_m = rng.uniform(1, 70, (count, width))
    gray = rng.integers(0, 256, (count, width)).astype(np.uint8)
    return family.encode(one, batch, range_m, gray), family.sidecar_files(one)[".json"]


def mutated(value, rng: random.Random):
    """The JSON value with one part of it replaced, removed or cut off."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(list(value))
        if rng.random() < 0.15:
            return {other: kept for other, kept in value.items() if other != key}
        return value | {key: mutated(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.7:
        at = rng.randrange(len(value))
        return value[:at] if rng.random() < 0.3 else [*value[:at], mutated(value[at], rng), *value[at + 1 :]]
    return rng.choice(ODD)


def test_mutated_metadata():
    rng = random.Random(5)
    outcomes = {"read": 0, "refused": 0, "none": 0}
    messages = []
    said = json.loads(packets(mount(), 1)[1])
    for _ in range(1500):
        text = json.dumps(mutated(said, rng))
        if rng.random() < 0.1:
            text = text[: rng.randrange(len(text))]
        try:
            found = read_metadata("a.json", text.encode())
        except LidarcfgError as error:
            messages.append(str(error))
            outcomes["refused"] += 1
        else:
            assert found is None or isinstance(found, Metadata)
            outcomes["none" if found is None else "read"] += 1
    assert min(outcomes.values()) > 20
    assert all(one.startswith("a.json: not the metadata of an Ouster: ") and "\n" not in one for one in messages)


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["RNG19_RFL8_SIG16_NIR16", "LEGACY", "FUSA_RNG15_RFL8_NIR8_DUAL"])
def test_mutated_packets(tmp_path, profile):
    one = mount(dual="DUAL" in profile, profile=profile, firmware="3.2", columns=512)
    payloads, metadata = packets(one, 64)
    rng = np.random.default_rng(2)
    whole = 0
    messages = []
    (tmp_path / "a.json").write_bytes(metadata)
    path = tmp_path / "a.pcap"
    for _ in range(25):
        data = payloads.data.copy()
        at = rng.integers(0, data.size, 3000)
        data.reshape(-1)[at] = rng.integers(0, 256, len(at))
        heads = rng.integers(0, len(data), 8)
        data[heads, rng.integers(7 if profile != "LEGACY" else 0, 60, 8)] ^= rng.integers(1, 256, 8).astype(np.uint8)
        changed = Payloads(payloads.time_ns, data, 7502, payloads.network, payloads.header, 0)
        write_pcap(path, [ethernet_frames(one.host, changed)])
        stats = []
        try:
            cloud = concatenate(list(decode_pcap(path, lambda warning: None, on_stats=stats.append)))
        except LidarcfgError as error:
            messages.append(str(error))
            continue
        assert np.isfinite(cloud.xyz).all()
        assert np.linalg.norm(cloud.xyz, axis=1).max() < 1100  # 20 bits of millimetres
        assert cloud.ring.max() < one.sensor.count
        assert stats[0].packets == 64
        whole += 1
    assert whole > 5
    assert not any("\n" in one for one in messages)


def records(path: Path) -> list[bytes]:
    """Of a pcap."""
    data = path.read_bytes()
    at = 24
    found = []
    while at < len(data):
        size = 16 + int.from_bytes(data[at + 8 : at + 12], "little")
        found.append(data[at : at + size])
        at += size
    return found


def moved(record: bytes, octets: int) -> bytes:
    """A fragment that claims to stand so much earlier in its datagram."""
    flags = int.from_bytes(record[36:38], "big") - octets // 8
    return record[:36] + flags.to_bytes(2, "big") + record[38:]


@pytest.mark.parametrize("how", ["out of order", "duplicated", "sent twice", "missing", "overlapping"])
def test_fragments(tmp_path, how):
    """Datagrams whose fragments come in any order, or twice, are whole; others are skipped, and count as lost."""
    one = mount("os1-32", columns=512)
    payloads, metadata = packets(one, 32)
    for name in ("whole", "odd"):
        (tmp_path / f"{name}.json").write_bytes(metadata)
    write_pcap(tmp_path / "whole.pcap", [ethernet_frames(one.host, payloads)])
    whole = concatenate(list(decode_pcap(tmp_path / "whole.pcap", pytest.fail)))
    found = records(tmp_path / "whole.pcap")
    rng = random.Random(1)
    each = len(found) // 32
    assert each == 5  # 6,400 bytes and the UDP header
    datagrams = [found[i : i + each] for i in range(0, len(found), each)]
    damaged = {4, 9, 17} if how in ("missing", "overlapping") else set()
    for i, parts in enumerate(datagrams):
        if how == "out of order":
            rng.shuffle(parts)
        elif how == "duplicated":
            parts.insert(rng.randrange(each), rng.choice(parts))
        elif how == "sent twice":
            parts.extend(parts[:])
        elif i in damaged:
            parts[2:3] = [] if how == "missing" else [moved(parts[2], 8)]
    head = (tmp_path / "whole.pcap").read_bytes()[:24]
    (tmp_path / "odd.pcap").write_bytes(head + b"".join(part for parts in datagrams for part in parts))
    stats = []
    warnings = []
    cloud = concatenate(list(decode_pcap(tmp_path / "odd.pcap", warnings.append, on_stats=stats.append)))
    assert (stats[0].packets, stats[0].lost) == (32 - len(damaged), len(damaged))
    assert stats[0].duplicates == (32 if how == "sent twice" else 0)
    kept = ~np.isin(np.searchsorted(np.unique(whole.time_ns), whole.time_ns) // 16, list(damaged))
    np.testing.assert_array_equal(cloud.xyz, whole.xyz[kept])
    np.testing.assert_array_equal(cloud.time_ns, whole.time_ns[kept])
    said = [one.split(": ", 1)[1] for one in warnings]
    expected = "3 datagrams skipped: fragments of theirs are missing or damaged"
    assert said == ([expected] if damaged else [])
