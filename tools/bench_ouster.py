#!/usr/bin/env python3
"""How fast an OS1-128's packets are read, beside ouster-sdk, and written; and its exports, beside the bare tracer.

    .venv/bin/python tools/bench_ouster.py             # prints the tables of docs/benchmarks.md

Decoding is from packets in memory to x, y, z and all fields, none of which is kept. ouster-sdk's FrameBatcher and
XYZLut are one thread, fill the same frame again and again, and give a place to every pixel. Ours give the cloud's
columns of what returned: of a revolution at a time; of a quarter, whose columns stay in a core's cache; and of
revolutions on all cores. What memory allows is timed by adding up the packets' words and filling columns of those sizes
with a constant. Medians of several runs in turns, and the spread of their ratios. Files are read by
ouster-sdk's open_source and by decode_pcap, which gives as much at a time; and with everything kept, as a list of
ouster-sdk's frames and their points, or as decode's one cloud. The tracer casts the same rays in the same order.
"""

import argparse
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from bench_capture import seconds
from ouster.sdk import core, open_source
from page import ROOT, machine

import lidarcfg
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.frames import frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config import Section
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Octets
from lidarcfg.packets.families import codec
from lidarcfg.packets.ouster.decode import OusterDecoder
from lidarcfg.packets.ouster.telemetry import read_metadata
from lidarcfg.rig import Mount, Rig, load_rig
from lidarcfg.simulate.export import export, in_time_order
from lidarcfg.simulate.simulator import Simulator
from lidarcfg.simulate.tasks import CHUNK_RAYS, START_NS
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import standing
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import Tracer

RUNS, REVOLUTIONS, PACKETS = 9, 8, 64  # packets of a revolution
AGAIN = 8  # times that all of them are decoded in a run: threads take their time to start
QUARTER = PACKETS // 4
IN_FILE = 40  # revolutions of a file that is read
PROFILES = {
    "RNG19_RFL8_SIG16_NIR16": "strongest",
    "RNG19_RFL8_SIG16_NIR16_DUAL": "dual",
    "RNG15_RFL8_NIR8": "strongest",
    "FUSA_RNG15_RFL8_NIR8_DUAL": "dual",
    "LEGACY": "strongest",
}
RIG = """
name: two
sensors:
  - {name: left, model: os1-128, position_m: [0.5, 0.6, 1.9], rpy_deg: [-5, 3, 0]}
  - {name: right, model: os1-128, position_m: [0.5, -0.6, 1.9], rpy_deg: [5, 3, 0]}
"""


class Capture:
    """What an OS1-128 in the street sends with a profile, and what it measured."""

    def __init__(self, mount: Mount, scene: Scene, profile: str, revolutions: int = REVOLUTIONS) -> None:
        settings = Section({"profile": profile, "firmware": "3.2", "imu": False})
        self._mount = replace(mount, return_mode=PROFILES[profile], settings=settings)
        self._maker, packets = codec(mount.sensor), revolutions * PACKETS
        pace, still = self._maker.pace(self._mount), standing(np.eye(4))
        simulator = Simulator(0, self._mount, Tracer(scene, np.zeros(3)), still)
        self._measured, first = [], 0
        for batch in self._maker.schedule(self._mount, START_NS, packets, CHUNK_RAYS // pace.firings):
            found, _ = simulator.echoes(batch.firings, first)
            self._measured.append((batch, found.range_m, found.reflectivity))
            first += len(batch.firings.time_ns)
        self.pixels = sum(range_m.size for _, range_m, _ in self._measured)  # and returns, of each
        self.packets = np.concatenate([self._maker.encode(self._mount, *one).data for one in self._measured])
        metadata = self._maker.sidecar_files(self._mount)[".json"]
        self._decoder = OusterDecoder("memory", read_metadata("memory", metadata), "os1-128")  # type: ignore[arg-type]  # a name for its source will do
        self._metadata, self._info = metadata, core.SensorInfo(metadata.decode())
        self._theirs = [_packet(core.PacketFormat.from_info(self._info), one) for one in self.packets]
        self._lut, self._dual = core.XYZLut(self._info), PROFILES[profile] == "dual"
        self.returns = AGAIN * sum(map(self._decode, self._parts(PACKETS)))
        returns = self.returns // AGAIN // REVOLUTIONS
        self._columns = [np.empty(3 * returns), np.empty(returns, np.int64), *(np.empty((3, returns), np.uint8))]

    def _parts(self, packets: int) -> list[Octets]:
        return np.split(self.packets, len(self.packets) // packets)

    def _decode(self, some: Octets) -> int:
        return len(self._decoder.decode(some, np.empty(0, np.int64), np.ones(len(some), np.bool_)).time_ns)

    def ours(self, packets: int) -> None:
        """Decode on one thread, so many packets at a time."""
        for some in self._parts(packets) * AGAIN:
            self._decode(some)

    def threads(self, pool: ThreadPoolExecutor) -> None:
        """Decode on all cores."""
        list(pool.map(self._decode, self._parts(PACKETS) * AGAIN))

    def memory(self) -> None:
        """Read the packets and write the columns, without more."""
        for some in self._parts(PACKETS) * AGAIN:
            some.view(np.uint64).sum()
            for column in self._columns:
                column.fill(1)

    def sdk(self) -> None:
        """Decode with ouster-sdk."""
        for _ in range(AGAIN):
            self._sdk()

    def _sdk(self) -> None:
        batcher, frame, done = core.FrameBatcher(self._info), core.LidarFrame(self._info), 0
        for i, packet in enumerate(self._theirs, 1):
            if batcher.batch(packet, frame) or i % PACKETS == 0:
                self._lut(frame)
                if self._dual:
                    self._lut(frame.field("RANGE2"))
                done += 1
                if i % PACKETS == 0:
                    batcher, frame = core.FrameBatcher(self._info), core.LidarFrame(self._info)
        assert done == REVOLUTIONS

    def write(self, path: Path) -> None:
        """Encode and write a pcap, and the metadata beside it."""
        path.with_suffix(".json").write_bytes(self._metadata)
        encoded = (self._maker.encode(self._mount, *one) for one in self._measured)
        write_pcap(path, (frames(self._mount.host, one) for one in encoded))

    def read(self, path: Path) -> None:
        """Read what has been written, and decode it."""
        for _ in decode_pcap(path, print):
            pass

    def sdk_reads(self, path: Path) -> None:
        """The same with ouster-sdk."""
        for _ in self._sdk_frames(path):
            pass

    def read_whole(self, path: Path) -> None:
        """Read it as one cloud."""
        lidarcfg.decode(path)

    def sdk_reads_whole(self, path: Path) -> None:
        """Read it with ouster-sdk and keep everything."""
        list(self._sdk_frames(path))

    def _sdk_frames(self, path: Path) -> Iterator[Any]:
        for found in open_source(str(path), meta=[str(path.with_suffix(".json"))]):
            for frame in found.valid_frames():
                yield frame, self._lut(frame), self._lut(frame.field("RANGE2")) if self._dual else None


def _packet(form: Any, octets: Octets) -> Any:
    packet = core.LidarPacket(form)
    packet.buf[:] = octets
    packet.host_timestamp = 1
    return packet


def middle(values: Array, digits: int = 1) -> str:
    """Median, and the spread."""
    return f"{np.median(values):.{digits}f} ({values.min():.{digits}f} to {values.max():.{digits}f})"


def packets(folder: Path, mount: Mount, scene: Scene) -> None:
    """The tables of decoding and of writing."""
    ways = "ouster-sdk", "a revolution", "a quarter", "all cores", "memory alone"
    print(f"\n| million returns/s | {' | '.join(ways)} |\n|{'---|' * 6}")
    ratios, writing = [], []
    for profile in PROFILES:
        capture = Capture(mount, scene, profile)
        *decoding, write = timed(capture, folder / "a.pcap")
        fast = [f"{capture.returns / np.median(some[:, 0]) / 1e6:.0f}" for some in decoding]
        print(f"| {profile} | {' | '.join(fast)} |", flush=True)
        sdk, *ours = decoding
        for by, what in enumerate(("the clock", "the processor's time")):
            times = [middle(sdk[:, by] / some[:, by]) for some in ours]
            ratios.append(f"| {profile} by {what} | {' | '.join(times)} |")
        rates = [middle(capture.pixels / write[:, by] / 1e6, 0) for by in (0, 1)]
        writing.append(f"| {profile} | {rates[0]} | {rates[1]} |")
    print(f"\n| times ouster-sdk | {' | '.join(ways[1:])} |\n|{'---|' * 5}")
    print("\n".join(ratios))
    print("\n| encode and write | million returns/s | by the processor's time |\n|---|---|---|")
    print("\n".join(writing))


def timed(capture: Capture, path: Path) -> Array:
    """Seconds (6, RUNS, 2) by the clock and of the processor: ouster-sdk, ours in three ways, memory, writing."""
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        decoding = [partial(capture.ours, PACKETS), partial(capture.ours, QUARTER), partial(capture.threads, pool)]
        work = (capture.sdk, *decoding, capture.memory, partial(capture.write, path))
        rows = [[seconds(one) for one in work] for _ in range(RUNS + 1)]
    return np.array(rows[1:]).transpose(1, 0, 2)  # the first is not counted


def cores() -> None:
    """How much of the machine is ours: arithmetic on all threads, beside one."""
    count = os.cpu_count() or 1

    def work(_: int) -> None:
        values = np.full(4096, 2.0)
        for _ in range(2000):
            np.sqrt(values, out=values)

    with ThreadPoolExecutor(count) as pool:
        alone, together = (
            np.array([seconds(partial(list, each(work, range(count))))[0] for _ in range(RUNS)])
            for each in (map, pool.map)
        )
    print(f"\narithmetic on {count} threads: {middle(alone / together)} times one")


def files(folder: Path, mount: Mount, scene: Scene) -> None:
    """The table of reading from a file: ouster-sdk on one thread, ours on all cores."""
    names = "ouster-sdk, ms | lidarcfg | times ouster-sdk | of the processor: ouster-sdk | lidarcfg | times ouster-sdk"
    print(f"\n| from a file of {IN_FILE} revolutions | {names} |\n|{'---|' * 7}")
    for profile in PROFILES:
        capture, path = Capture(mount, scene, profile, IN_FILE), folder / "long.pcap"
        capture.write(path)
        work = [partial(one, path) for one in (capture.sdk_reads, capture.read)]
        work += [partial(one, path) for one in (capture.sdk_reads_whole, capture.read_whole)]
        rows = 1000 * np.array([[seconds(one) for one in work] for _ in range(RUNS + 1)])[1:]
        for at, what in ((0, ""), (2, ", all kept")):
            sdk, ours = rows[:, at], rows[:, at + 1]
            said = [
                f"{np.median(sdk[:, i]):.0f} | {np.median(ours[:, i]):.0f} | {middle(sdk[:, i] / ours[:, i])}"
                for i in (0, 1)
            ]
            print(f"| {profile}{what} | {' | '.join(said)} |", flush=True)


def exports(folder: Path, rig: Rig, scene: Scene, simulated_s: float) -> None:
    """The table of an export of two OS1-128."""
    duration_ns = round(simulated_s * SECOND_NS)
    still, tracer = standing(np.eye(4)), Tracer(scene, np.zeros(3))
    work: list[Callable[[], object]] = []
    rays = 0
    for number, mount in enumerate(rig.mounts):
        maker, simulator = codec(mount.sensor), Simulator(number, mount, tracer, still)
        pace = maker.pace(mount)
        for batch in maker.schedule(mount, START_NS, duration_ns // pace.period_ns, CHUNK_RAYS // pace.firings):
            work.append(lambda simulator=simulator, fired=batch.firings: simulator.echoes(fired, 0))
            rays += len(batch.firings.time_ns)

    def bare(pool: ThreadPoolExecutor) -> None:
        list(pool.map(lambda one: one(), work))

    def whole() -> None:
        write_pcap(folder / "b.pcap", in_time_order(export(rig, scene, np.eye(4), duration_ns)))

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        rows = [[seconds(partial(bare, pool)), seconds(whole)] for _ in range(RUNS + 1)]
    (traced_s, traced_cpu), (took_s, took_cpu) = np.array(rows[1:]).transpose(1, 2, 0)
    print(f"\n| two OS1-128 in the street, {simulated_s:g} s | median and spread |\n|---|---|")
    print(f"| tracer alone, million rays/s | {middle(rays / traced_s / 1e6)} |")
    print(f"| export to pcap, million rays/s | {middle(rays / took_s / 1e6)} |")
    print(f"| export's rate against the tracer's, % | {middle(100 * traced_s / took_s, 0)} |")
    print(f"| the same by the processor's time, % | {middle(100 * traced_cpu / took_cpu, 0)} |")
    print(f"| export, × real time | {middle(simulated_s / took_s, 2)} |")


def main() -> None:
    """Print the machine and the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--decode", action="store_true", help="decoding and writing only")
    parser.add_argument("--seconds", type=float, default=2.0, help="simulated in each export (2)")
    arguments = parser.parse_args()
    print(f"{machine()}, ouster-sdk {version('ouster-sdk')}, medians of {RUNS} runs")
    scene = load_scene(ROOT / "data/scenes/street.yaml")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.yaml").write_text(RIG)
        rig = load_rig(folder / "rig.yaml")
        cores()
        packets(folder, rig.mounts[0], scene)
        files(folder, rig.mounts[0], scene)
        if not arguments.decode:
            exports(folder, rig, scene, arguments.seconds)


if __name__ == "__main__":
    warnings.simplefilter("error")
    main()
