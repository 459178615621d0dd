#!/usr/bin/env python3
"""Captures made odd, millions of packets of them, through the decoder: nothing may crash, hang, grow or be nonsense.

    .venv/bin/python tools/fuzz.py --packets 10000000     # the table of docs/evidence/reliability.md
    .venv/bin/python tools/fuzz.py --case HEX              # one case again

A case is a string of bytes that says which capture is made and what is changed in it: packets of every model and mode
(and recordings, where LIDARCFG_CAPTURES names a folder of them), their fields, their order, headers, fragments, files
beside the capture, the file around them, and what the decoder is asked for. --makers takes the other makers' only, not
Velodyne's. With atheris from the package index, cases that reach new branches of the decoder are kept and varied, and
all is done on one thread, as atheris sees no other; without it, or with --random, they are random. tools/test
--sanitize tests/test_fuzz.py has a short run on a core that finds reads and writes beyond arrays.
"""

import argparse
import contextlib
import functools
import json
import os
import resource
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
try:
    import atheris
except ImportError:
    atheris = None
if "--random" in sys.argv:
    atheris = None

import numpy as np
from numpy.typing import NDArray

with (
    atheris.instrument_imports(include=["lidarcfg.capture", "lidarcfg.packets"])
    if atheris
    else contextlib.nullcontext()
):
    from lidarcfg.capture import decode as decoder
    from lidarcfg.capture import source_finder
    from lidarcfg.capture.ethernet import ETHERNET_HEADER, IP, RECORD, UDP
    from lidarcfg.capture.pcap import PCAP_MAGIC, read_batches
    from lidarcfg.capture.selection import Selection
    from lidarcfg.packets.velodyne.encode import encode
    from lidarcfg.packets.velodyne.layout import PACKET, packets_of
    from lidarcfg.packets.velodyne.model import unit
    from lidarcfg.sensors.schedule import firings
    from tools import fuzz_makers
from lidarcfg.clouds.cloud import PointCloud, concatenate
from lidarcfg.errors import LidarcfgError
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import load_sensor

MODELS = ("vlp-16", "puck-hi-res", "vlp-32c", "hdl-32e", "vls-128", "hdl-64e-s2", "hdl-64e-s3")
MODES = ("strongest", "last", "dual")
START_NS = 1_700_000_000 * 10**9
ODD = (3, 4, 5, 6, 7, 8, 11)  # changes that no check of flags and ids refuses
SLOW_S = 60.0  # a case that takes longer hangs
REACH_M = 65535 * 0.004 + 100.0  # the largest distance on the wire, and offsets that a calibration may carry
RETURNS_MAX = 384
SPAN_S = 4.0  # of a packet; of most captures
CLASSIC = struct.pack("<I", 0xA1B2C3D4)
ROUND = 1_000_000  # packets: atheris, not the decoder, keeps about a megabyte of each capture
SYNTHETIC = len(MODELS) * len(MODES)
SEEDS = SYNTHETIC + 7  # and as many recordings at most
CASE_BYTES = 64
WARM = 1000  # captures, after which all is loaded and compiled and has been used at its largest
FRAME = np.dtype([("record", RECORD), ("ethernet", ETHERNET_HEADER), ("ip", IP), ("udp", UDP), ("packet", PACKET)])

load_sensor = functools.cache(load_sensor)
source_finder.load_sensor = load_sensor  # its YAML is another matter


class Here(ThreadPoolExecutor):
    """Does things at once, on this thread."""

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """What the function gave or raised."""
        done: Future[Any] = Future()
        try:
            done.set_result(function(*args, **kwargs))
        except LidarcfgError as error:
            done.set_exception(error.with_traceback(None))
        return done


if atheris:
    decoder.ThreadPoolExecutor = Here


class Case:
    """Numbers from a string of bytes; zeros when it ends."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0
        self.rng = np.random.default_rng(list(data[:8]))

    def seldom(self, one_of: int) -> bool:
        """Once in so many, and not when the bytes end."""
        return self.below(one_of) == one_of - 1

    def below(self, count: int) -> int:
        """0 to count - 1, count up to 65536."""
        pair = self._data[self._at : self._at + 2].ljust(2, b"\0")
        self._at += 2
        return int.from_bytes(pair) % count


@functools.cache
def seed_packets(number: int) -> NDArray[Any]:
    """400 packets of a model and mode, or of a recording."""
    recorded = sorted(Path(os.environ.get("LIDARCFG_CAPTURES", "/none")).glob("*.pcap"))
    for path in recorded[number - SYNTHETIC :][:1] if number >= SYNTHETIC else []:
        batches = [batch[batch.size == PACKET.itemsize] for batch in read_batches(path, lambda warning: None)]
        packets = packets_of(np.concatenate([batch.payloads(PACKET.itemsize) for batch in batches]))
        if len(packets):
            return packets[:400]
    sensor = unit(load_sensor(MODELS[number % len(MODELS)]))
    mode = MODES[number % len(MODES)]
    fired = firings(sensor.firing_schedule(mode == "dual"), 600.0, START_NS, range(400))
    rng = np.random.default_rng(number)
    shape = len(fired.time_ns), 1 + (mode == "dual")
    range_m = np.where(rng.random(shape) < 0.8, rng.uniform(1, 100, shape), np.inf)
    return encode(sensor, mode, fired, range_m, rng.integers(0, 256, shape, np.uint8))


def changed(case: Case, packets: NDArray[Any]) -> NDArray[Any]:
    """The packets with fields that are odd in some of them."""
    packets = packets.copy()
    raw = packets.view(np.uint8).reshape(len(packets), -1)
    blocks = packets["blocks"]
    for _ in range(case.below(5)):
        fraction = (0.001, 0.02, 0.3, 1.0)[case.below(4)]
        which = np.flatnonzero(case.rng.random(len(packets)) < fraction)
        what = case.below(12) if case.seldom(3) else ODD[case.below(len(ODD))]
        if what == 0:
            raw[which, case.below(1206)] = case.below(256)
        elif what == 1:
            at = case.below(1206)
            size = 1 + case.below(20)
            raw[which, at : at + size] = case.rng.integers(0, 256, raw[which, at : at + size].shape)
        elif what == 2:
            blocks["flag"][which, case.below(12)] = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF, 0, 0xFFFF)[case.below(6)]
        elif what == 3:
            blocks["azimuth"][which] = case.rng.integers(0, 65536, (len(which), 12))
        elif what == 4:
            blocks["azimuth"][which, case.below(12) :] += np.uint16(case.below(65536))
        elif what == 5:
            blocks["azimuth"][which] = case.below(65536)
        elif what == 6:
            blocks["returns"]["distance"][which] = (0, 1, 65535, case.below(65536))[case.below(4)]
        elif what == 7:
            packets["stamp_us"][which] = case.rng.integers(0, 2**32, len(which))
        elif what == 8:
            packets["stamp_us"][which] += np.uint32(case.below(65536) << case.below(17))
        elif what == 9:
            packets["return_mode"][which] = case.below(256)
        elif what == 10:
            packets["product_id"][which] = case.below(256)
        else:
            raw[which] = raw[case.rng.integers(0, len(packets), len(which))]
    return packets


def capture(case: Case, seed: int) -> tuple[bytes, int]:
    """A file, and how many packets are in it."""
    packets = seed_packets(seed)
    count = (5, 60, 400, 2000)[case.below(4)]
    packets = changed(case, packets[np.arange(count) % len(packets)])
    frames = np.zeros(count, FRAME)
    record = frames["record"]
    ip = frames["ip"]
    udp = frames["udp"]
    frames["packet"] = packets
    time_us = START_NS // 1000 + np.arange(count, dtype=np.int64) * (1327, 553, 160, 100_000)[case.below(4)]
    if case.seldom(3):
        time_us += case.rng.integers(-(10**9), 10**9, count) >> case.below(31)
    record["seconds"], record["microseconds"] = np.divmod(np.maximum(time_us, 0), 10**6)
    record["captured"] = record["length"] = FRAME.itemsize - RECORD.itemsize
    frames["ethernet"]["kind"] = 0x0800
    ip["version"] = 0x45
    ip["protocol"] = socket.IPPROTO_UDP
    ip["length"] = IP.itemsize + UDP.itemsize + PACKET.itemsize
    ip["source"] = [192, 168, 1, 201]
    ip["source"][:, 3] += (np.arange(count) % (1 + case.below(3))).astype(np.uint8)
    udp["source_port"] = udp["port"] = 2368
    for _ in range(case.below(3)):
        which = np.flatnonzero(case.rng.random(count) < (0.01, 0.3)[case.below(2)])
        header = frames.view(np.uint8).reshape(count, -1)[:, : FRAME.itemsize - PACKET.itemsize]
        header[which, RECORD.itemsize + case.below(header.shape[1] - RECORD.itemsize)] = case.below(256)
    if case.seldom(4):
        frames = frames[case.rng.permutation(count)] if case.below(2) else np.sort(frames, order="udp")
    magic = sorted(PCAP_MAGIC)[case.below(4)] if case.seldom(4) else CLASSIC
    body = frames.tobytes()
    link = (1, 1, 1, 113, 101, 12, 195, 0)[case.below(8) if case.seldom(8) else 0]
    data = bytearray(magic + struct.pack("<HHiIII", 2, 4, 0, 0, 65535, link) + body)
    for _ in range(case.below(4) if case.seldom(4) else 0):
        at = case.below(65536) * 7919 % len(data)
        how = case.below(4)
        if how == 0:
            del data[at : at + case.below(3000)]
        elif how == 1:
            data[at:at] = case.rng.bytes(case.below(3000))
        elif how == 2:
            data[at : at + 4] = case.rng.bytes(4)
        else:
            del data[at:]
    return bytes(data), count


def rig(model: str) -> Rig:
    """Three sensors of a model, as the addresses have it."""
    mounts = [
        Mount(
            name=f"m{i}",
            sensor=load_sensor(model),
            position_m=(0.1 * i, 0.0, 2.0),
            rpy_rad=(0.0, 0.1, i),
            model=model,
            host=f"192.168.1.{201 + i}",
            data_port=2368,
            telemetry_port=8308,
            rpm=600.0,
            return_mode="strongest",
        )
        for i in range(3)
    ]
    return Rig("three", tuple(mounts))


@dataclass(frozen=True)
class Question:
    """A capture, and what the decoder is asked."""

    content: bytes
    count: int  # of packets
    beside: dict[str, bytes]  # files, by the end of their names
    rig: Rig | None
    model: str | None
    returns_max: int  # of a packet
    reach_m: float
    span_s: float  # within which windows lie


def question(case: Case, makers: bool) -> Question | None:
    """What the case is; None if it is of a recording that is not there."""
    number = case.below(SEEDS + fuzz_makers.SEEDS) if not makers else SEEDS + case.below(fuzz_makers.SEEDS)
    if number >= SEEDS:
        odd = fuzz_makers.capture(case, number - SEEDS)
        if odd is None:
            return None
        model = fuzz_makers.MADE[case.below(len(fuzz_makers.MADE))][0] if case.seldom(4) or not odd.model else odd.model
        mounted = fuzz_makers.rig(model) if case.seldom(4) else None
        named = model if case.seldom(3) else None
        limits = fuzz_makers.RETURNS_MAX, fuzz_makers.reach_m(odd.model), fuzz_makers.SPAN_S
        return Question(odd.content, odd.count, odd.beside, mounted, named, *limits)
    content, count = capture(case, number)
    model = MODELS[(case.below(len(MODELS)) if case.seldom(4) else number) % len(MODELS)]
    mounted = rig(model) if case.seldom(4) else None
    return Question(content, count, {}, mounted, model if case.seldom(3) else None, RETURNS_MAX, REACH_M, SPAN_S)


def run(data: bytes, folder: Path, makers: bool) -> tuple[int, int, str]:
    """Decode a case; packets, points and, if it was refused, why. Raises AssertionError for what must not be."""
    case = Case(data)
    asked = question(case, makers)
    if asked is None:
        return 0, 0, ""
    path = folder / "case.pcap"
    for old in folder.glob("case*"):
        old.unlink()
    path.write_bytes(asked.content)
    for suffix, content in asked.beside.items():
        path.with_name(f"case{suffix}").write_bytes(content)
    began = time.perf_counter()
    points = 0
    why = ""
    clouds = []
    try:
        low_s, length_s = (asked.span_s / 2000 * one for one in (case.below(1000), 1 + case.below(1000)))
        selection = Selection(low_s, low_s + length_s) if case.seldom(4) else Selection()
        chunk = (1024, 1024, 64, 7)[case.below(4)]
        options = asked.rig, asked.model, chunk, lambda stats: None, selection
        clouds = list(decoder.decode_pcap(path, lambda warning: None, *options))
    except LidarcfgError as error:
        why = str(error)
        assert "\n" not in why, why
    if clouds:
        points = checked(concatenate(clouds), asked)
    took = time.perf_counter() - began
    assert took < SLOW_S, f"{took:.0f} s for {asked.count} packets"
    return asked.count, points, why


def checked(cloud: PointCloud, asked: Question) -> int:
    """The number of points, which must be of this world."""
    points = len(cloud.xyz)
    assert points <= (asked.count + 3) * asked.returns_max, f"{points} points of {asked.count} packets"
    assert np.isfinite(cloud.xyz).all(), "not finite"
    assert abs(cloud.xyz).max(initial=0) <= asked.reach_m, f"{abs(cloud.xyz).max()} m away"
    assert cloud.return_type.max(initial=0) <= 3, f"return type {cloud.return_type.max()}"
    assert cloud.sensor.max(initial=0) < len(cloud.sensor_names), "a sensor without a name"
    return points


def resident_mb() -> float:
    """Of this process, now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


class Tally:
    """What a worker has done, kept in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.captures = self.packets = self.points = self.refused = 0
        self.first_mb = self.most_mb = 0.0

    def add(self, count: int, points: int, why: str) -> None:
        """One more case."""
        self.captures = self.captures + 1
        self.packets = self.packets + count
        self.points = self.points + points
        self.refused += bool(why)
        if self.captures % 100 == 0:
            self.save()

    def save(self) -> None:
        """Look at the memory, and write all down."""
        now_mb = resident_mb()
        if self.captures <= WARM:
            self.first_mb = max(self.first_mb, now_mb)
        self.most_mb = max(self.most_mb, now_mb)
        self._path.write_text(json.dumps({key: value for key, value in vars(self).items() if key != "_path"}))


def work(folder: Path, packets: int, seed: int, makers: bool) -> None:
    """Cases until so many packets are through."""
    tally = Tally(folder / "tally.json")

    def one(data: bytes) -> None:
        try:
            tally.add(*run(bytes(data), folder, makers))
        except BaseException:  # whatever ends the case, it is to be found again
            (folder / "failed").write_text(bytes(data).hex())
            raise
        if tally.packets >= packets:
            tally.save()
            os._exit(0)  # atheris knows no other end

    rng = np.random.default_rng(seed)
    if atheris:
        corpus = folder / "corpus"
        corpus.mkdir(exist_ok=True)
        for i in range(200):
            (corpus / str(i)).write_bytes(rng.bytes(CASE_BYTES))
        options = [f"-max_len={2 * CASE_BYTES}", "-rss_limit_mb=4000", "-timeout=120", f"-seed={seed}"]
        atheris.Setup([sys.argv[0], *options, str(corpus)], one)
        atheris.Fuzz()
    while True:
        one(rng.bytes(CASE_BYTES))


def main() -> None:
    """Run a worker and say what it did."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--packets", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--random", action="store_true", help="without atheris")
    parser.add_argument("--makers", action="store_true", help="all but Velodyne only")
    parser.add_argument("--case", type=bytes.fromhex)
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        work(args.worker, args.packets, args.seed, args.makers)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.case is not None:
            print(run(args.case, folder, args.makers))
            return
        began = time.perf_counter()
        whole = Counter[str]()
        while whole["packets"] < args.packets:
            least = args.packets - whole["packets"]
            least = min(least, ROUND) if atheris else least
            number = str(args.seed + whole["rounds"])
            command = [sys.executable, __file__, "--worker", name, "--packets", str(least), "--seed", number]
            command += ["--random"] * args.random + ["--makers"] * args.makers
            done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
            if done.returncode:
                failed = folder / "failed"
                sys.exit(done.stdout[-3000:] + (f"\nfailed: --case {failed.read_text()}" if failed.exists() else ""))
            tally = json.loads((folder / "tally.json").read_text())
            whole.update({key: tally[key] for key in ("captures", "packets", "points", "refused")} | {"rounds": 1})
        counts = ", ".join(f"{whole[key]:,} {key}" for key in ("captures", "packets", "points", "refused"))
        print(f"{counts}, in {(time.perf_counter() - began) / 60:.1f} minutes")
        if atheris:
            covered = [line for line in done.stdout.splitlines() if " cov: " in line]
            print(f"coverage: {covered[-1].split('exec/s')[0].strip()}")
        else:
            print(f"memory: {tally['first_mb']:.0f} MB in the first {WARM:,}, {tally['most_mb']:.0f} MB at most")
        print("no crash, no hang, nothing that is not so")


if __name__ == "__main__":
    main()
