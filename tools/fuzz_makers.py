"""Captures of the makers other than Velodyne, for tools/fuzz.py: packets, fragments and files beside them, made odd."""

import functools
import os
import struct
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lidarcfg.capture.ethernet import ETHERNET_HEADER, RECORD, ethernet_frames
from lidarcfg.capture.pcap import FILE_HEADER, read_batches
from lidarcfg.config.models import Section
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import Mount, Rig, ports
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import SECOND_NS
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.motion import Trajectory

START_NS = 1_700_000_000 * 10**9
HESAI = "pandar-xt32", "pandar-xt16", "xt32m2x", "qt128", "ot128", "jt128", "pandar128"
ROBOSENSE = "helios-16p", "helios-32", "airy"
OUSTER = {  # profile and return mode
    "RNG19_RFL8_SIG16_NIR16": "strongest",
    "RNG19_RFL8_SIG16_NIR16_DUAL": "dual",
    "RNG19_RFL8_SIG16_ZONE16_DUAL": "dual",
    "RNG15_RFL8_NIR8": "strongest",
    "RNG15_RFL8_WIN8": "strongest",
    "FUSA_RNG15_RFL8_NIR8_DUAL": "dual",
    "LEGACY": "strongest",
}
LIVOX = ("cartesian_mm", "cartesian_cm", "spherical")
SEYOND = "falcon-k1", "falcon-k2", "robin-w"
MADE = [
    *((model, mode, "") for model in (*HESAI, *ROBOSENSE) for mode in ("strongest", "last", "first", "dual")),
    *((model, mode, "") for model in HESAI for mode in ("first-last", "first-strongest")),
    ("qt128", "two-strongest", ""),
    *((model, mode, "high") for model in ("ot128", "pandar128") for mode in ("strongest", "dual")),
    *(("os0-32", mode, profile) for profile, mode in OUSTER.items()),
    *((model, "strongest", kind) for model in ("mid-360", "hap") for kind in LIVOX),
    *((model, mode, "") for model in SEYOND for mode in ("strongest", "two-strongest", "dual")),
]
RECORDED = 12  # as many recordings at most
SEEDS = len(MADE) + RECORDED
PACKETS = 200
RETURNS_MAX = 4096
SPAN_S = 0.05  # of a packet: an OS0-128 with dual returns; of most captures
REACH_M = 65535 * 0.255 + 10.0  # a Hesai's header says the unit, up to 255 mm
LIVOX_REACH_M = 2**32 / 1000  # a packet's depth has 32 bits of millimetres
FRAGMENT_OFFSET = RECORD.itemsize + ETHERNET_HEADER.itemsize + 6
ODD = (b"\x00", b"\xff", b"\x01", b"\x80")


@dataclass(frozen=True)
class Seed:
    """What a sensor sent."""

    model: str | None  # None: a recording
    groups: tuple[Payloads, ...]  # what it sends besides, then its returns
    host: str
    beside: dict[str, bytes]  # by the end of the file's name


@dataclass(frozen=True)
class Odd:
    """A capture to decode."""

    content: bytes
    count: int  # of packets
    beside: dict[str, bytes]
    model: str | None


def mount(model: str, mode: str, profile: str) -> Mount:
    """A sensor with its maker's ports."""
    sensor = load_sensor(model)
    data_port, telemetry_port = ports(sensor)
    settings = {"profile": profile, "columns": 512, "firmware": "3.2"} if profile in OUSTER else {}
    settings |= {"resolution": profile} if profile == "high" else {}
    if profile in LIVOX:
        settings = {"data_type": profile}
    return Mount(
        name="m",
        sensor=sensor,
        position_m=(0.0, 0.0, 0.0),
        rpy_rad=(0.0, 0.0, 0.0),
        model=model,
        host="192.168.1.201",
        data_port=data_port,
        telemetry_port=telemetry_port,
        rpm=600.0,
        return_mode=mode,
        settings=Section(settings),
    )


def reach_m(model: str | None) -> float:
    """How far away the points of a sensor's packets may be; of a recording's."""
    return LIVOX_REACH_M if model in ("mid-360", "hap") else REACH_M


def rig(model: str) -> Rig:
    """One sensor of a model, in its usual mode."""
    return Rig("one", (mount(model, "strongest", ""),))


@functools.cache
def seed(number: int) -> Seed | None:
    """What a model and mode, or a recording, sends; None where there is none."""
    if number >= len(MADE):
        return _recorded(number - len(MADE))
    of = mount(*MADE[number])
    maker = codec(of.sensor)
    rng = np.random.default_rng(number)
    (batch,) = maker.schedule(of, START_NS, [range(PACKETS)])
    shape = len(batch.firings.time_ns), 1 + of.dual
    range_m = np.where(rng.random(shape) < 0.8, rng.uniform(1, 45, shape), np.inf)
    returns = maker.encode(of, batch, range_m, rng.integers(0, 256, shape, np.uint8))
    besides = maker.housekeeping(of, Trajectory.static(np.eye(4)), GeoOrigin(), START_NS, range(SECOND_NS // 10))
    return Seed(of.model, (*besides, returns), of.host, dict(maker.sidecar_files(of)))


def _recorded(number: int) -> Seed | None:
    folder = Path(os.environ.get("LIDARCFG_CAPTURES", "/none"))
    paths = sorted(folder.glob("*/*.pcap"))
    if number >= len(paths):
        return None
    path = paths[number]
    like = seed(0)
    assert like
    (batch,) = list(read_batches(path, lambda warning: None))[:1]
    groups = []
    for port, size in sorted(set(zip(batch.port.tolist(), batch.size.tolist(), strict=True))):
        mine = batch[(batch.port == port) & (batch.size == size)]
        time_ns = mine.time_ns[:PACKETS]
        data = mine.payloads(size)[:PACKETS]
        groups.append(replace(like.groups[-1], time_ns=time_ns, data=data, port=port))
    beside = {f"-{one.name}": one.read_bytes() for one in path.parent.glob(f"{path.stem}*.json")}
    return Seed(None, tuple(groups), like.host, beside)


def changed(case, payloads: Payloads) -> Payloads:
    """The payloads with octets that are odd in some of them."""
    data = payloads.data.copy()
    count, size = data.shape
    for _ in range(case.below(4)):
        which = np.flatnonzero(case.rng.random(count) < (0.01, 0.1, 0.5, 1.0)[case.below(4)])
        what = case.below(8)
        at = case.below(size)
        if what == 0:
            data[which, at] = case.below(256)
        elif what == 1:
            data[which, case.below(min(size, 64))] = case.below(256)
        elif what == 2:
            data[which, size - 1 - case.below(min(size, 64))] = case.below(256)
        elif what == 3:
            end = at + 1 + case.below(40)
            data[which, at:end] = case.rng.integers(0, 256, data[which, at:end].shape)
        elif what == 4:
            data[which, at : at + 1 + case.below(size)] = ODD[case.below(4)][0]
        elif what == 5:
            data[which, at :: 1 + case.below(132)] = case.below(256)
        elif what == 6:
            data[which] = data[case.rng.integers(0, count, len(which))]
        else:
            data[which] = case.rng.integers(0, 256, (len(which), size))
    time_ns = payloads.time_ns
    if case.seldom(4):
        time_ns = np.maximum(time_ns + (case.rng.integers(-(10**12), 10**12, count) >> case.below(40)), 0)
    return replace(payloads, data=data, time_ns=time_ns)


def reordered(case, records: list[bytes]) -> list[bytes]:
    """The frames with some missing, twice, out of order, or as fragments that overlap or leave gaps."""
    for _ in range(case.below(3)):
        fraction = (0.01, 0.2)[case.below(2)]
        what = case.below(5)
        drawn = case.rng.random(len(records)) < fraction
        if what == 0:
            records = [one for one, gone in zip(records, drawn, strict=True) if not gone]
        elif what == 1:
            records = [one for one, twice in zip(records, drawn, strict=True) for _ in range(1 + twice)]
        elif what == 2:
            keys = np.arange(len(records)) + drawn * case.rng.integers(0, 40, len(records))
            records = [records[i] for i in np.argsort(keys, kind="stable")]
        elif what == 3:
            shift = case.below(1 << 14)
            records = [_moved(one, shift) if odd else one for one, odd in zip(records, drawn, strict=True)]
        else:
            end = 1 + case.below(60)
            records = [_cut(one, end) if odd else one for one, odd in zip(records, drawn, strict=True)]
    return records


def _moved(record: bytes, shift: int) -> bytes:
    """A frame whose fragment lies elsewhere in its datagram."""
    (flags,) = struct.unpack_from(">H", record, FRAGMENT_OFFSET)
    return record[:FRAGMENT_OFFSET] + struct.pack(">H", flags ^ shift) + record[FRAGMENT_OFFSET + 2 :]


def _cut(record: bytes, end: int) -> bytes:
    """A frame of which so many octets at its end were not captured."""
    captured = max(len(record) - RECORD.itemsize - end, 0)
    return record[:8] + struct.pack("<I", captured) + record[12 : RECORD.itemsize + captured]


def besides(case, beside: dict[str, bytes]) -> dict[str, bytes]:
    """The files beside the capture: as they are, cut off, changed, another sensor's, or none."""
    out = {}
    for suffix, content in beside.items():
        what = case.below(8)
        body = bytearray(content)
        if what == 0:
            continue
        if what == 1:
            del body[case.below(len(body)) :]
        elif what == 2:
            for _ in range(1 + case.below(4)):
                body[case.below(len(body))] = 32 + case.below(95)
        elif what == 3:
            at = case.below(len(body))
            del body[at : at + case.below(200)]
        elif what == 4:
            other = seed(case.below(len(MADE)))
            assert other
            body = bytearray(next(iter(other.beside.values()), b""))
        out[suffix] = bytes(body)
    return out


def capture(case, number: int) -> Odd | None:
    """A capture of a seed, made odd; None where the seed is none."""
    sent = seed(number)
    if sent is None:
        return None
    some = slice((5, 30, PACKETS)[case.below(3)])
    groups = [replace(one, time_ns=one.time_ns[some], data=one.data[some]) for one in sent.groups]
    if case.seldom(6) and len(groups) > 1:
        groups = groups[1:]  # what it sends besides never comes
    groups = [changed(case, one) for one in groups]
    if case.seldom(4):
        groups = [replace(one, fragments=False) for one in groups]
    made = [ethernet_frames(sent.host, one) for one in groups]
    pairs = [pair for one in made for pair in zip(one.time_ns.tolist(), one.records, strict=True)]
    records = reordered(case, [record for _, record in sorted(pairs, key=lambda pair: pair[0])])
    count = sum(len(one.data) for one in groups)
    return Odd(
        FILE_HEADER + b"".join(records),
        count,
        besides(case, sent.beside) if case.seldom(3) else sent.beside,
        sent.model,
    )
