#!/usr/bin/env python3
"""How fast an OS1-128's packets are read, beside ouster-sdk, and written; and its exports, beside the bare tracer.

    .venv/bin/python tools/bench_ouster.py             # prints the tables of docs/ouster.md

Decoding is from packets in memory to x, y, z and all fields: ouster-sdk's FrameBatcher and XYZLut, which are one thread
and give a place to every pixel; ours give the cloud's columns of what returned, revolution by revolution on one thread,
and on all cores as `decode` does. Medians of several runs in turns, and the spread of their ratios. The tracer casts
the same rays in the same order.
"""

import argparse
import os
import platform
import tempfile
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from bench_capture import seconds
from ouster.sdk import core

import lidarcfg
from lidarcfg.capture.frames import frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config import Section
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Octets, codec
from lidarcfg.packets.ouster.decode import OusterDecoder
from lidarcfg.packets.ouster.metadata import read
from lidarcfg.rig import Mount, Rig, load_rig
from lidarcfg.simulate.export import CHUNK_RAYS, START_NS, export, in_time_order
from lidarcfg.simulate.simulator import Simulator
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import standing
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import Tracer

ROOT = Path(__file__).parent.parent
RUNS, REVOLUTIONS, PACKETS = 9, 8, 64  # packets of a revolution
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

    def __init__(self, mount: Mount, scene: Scene, profile: str) -> None:
        settings = Section({"profile": profile, "firmware": "3.2", "imu": False})
        self._mount = replace(mount, return_mode=PROFILES[profile], settings=settings)
        self._maker, packets = codec(mount.sensor), REVOLUTIONS * PACKETS
        pace, still = self._maker.pace(self._mount), standing(np.eye(4))
        simulator = Simulator(0, self._mount, Tracer(scene, np.zeros(3)), still)
        self._measured, first = [], 0
        for batch in self._maker.schedule(self._mount, START_NS, packets, CHUNK_RAYS // pace.firings):
            found, _ = simulator.echoes(batch.firings, first)
            self._measured.append((batch, found.range_m, found.reflectivity))
            first += len(batch.firings.time_ns)
        self.pixels = sum(range_m.size for _, range_m, _ in self._measured)  # and returns, of each
        self.packets = np.concatenate([self._maker.encode(self._mount, *one).data for one in self._measured])
        metadata = self._maker.companions(self._mount)[".json"]
        self._decoder = OusterDecoder("memory", read("memory", metadata), "os1-128")  # type: ignore[arg-type]  # a name for its source will do
        self._info = core.SensorInfo(metadata.decode())
        self._theirs = [_packet(core.PacketFormat.from_info(self._info), one) for one in self.packets]
        self._lut, self._dual = core.XYZLut(self._info), PROFILES[profile] == "dual"
        self.returns = sum(self._revolution(i) for i in range(REVOLUTIONS))

    def _revolution(self, number: int) -> int:
        some = self.packets[number * PACKETS : (number + 1) * PACKETS]
        return len(self._decoder.decode(some, np.empty(0, np.int64), np.ones(len(some), np.bool_)).time_ns)

    def ours(self) -> None:
        """Decode on one thread."""
        for number in range(REVOLUTIONS):
            self._revolution(number)

    def threads(self, pool: ThreadPoolExecutor) -> None:
        """Decode on all cores."""
        list(pool.map(self._revolution, range(REVOLUTIONS)))

    def sdk(self) -> None:
        """Decode with ouster-sdk."""
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
        """Encode and write a pcap."""
        encoded = (self._maker.encode(self._mount, *one) for one in self._measured)
        write_pcap(path, (frames(self._mount.host, one) for one in encoded))


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
    print(
        "\n| decode | ouster-sdk, million returns/s | one thread | times | all cores | times | one thread by CPU time |"
        "\n|---|---|---|---|---|---|---|"
    )
    writing = []
    for profile in PROFILES:
        capture = Capture(mount, scene, profile)
        sdk, one, many, write = timed(capture, folder / "a.pcap")
        fast = [f"{capture.returns / np.median(some[:, 0]) / 1e6:.0f}" for some in (sdk, one, many)]
        times = [middle(ratio) for ratio in (sdk[:, 0] / one[:, 0], sdk[:, 0] / many[:, 0], sdk[:, 1] / one[:, 1])]
        print(f"| {profile} | {fast[0]} | {fast[1]} | {times[0]} | {fast[2]} | {times[1]} | {times[2]} |", flush=True)
        rates = [middle(capture.pixels / write[:, by] / 1e6, 0) for by in (0, 1)]
        writing.append(f"| {profile} | {rates[0]} | {rates[1]} |")
    print("\n| encode and write | million returns/s | by the processor's time |\n|---|---|---|")
    print("\n".join(writing))


def timed(capture: Capture, path: Path) -> Array:
    """Seconds (4, RUNS, 2) by the clock and of the processor: ouster-sdk, one thread, all cores, writing."""
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        work = (capture.sdk, capture.ours, partial(capture.threads, pool), partial(capture.write, path))
        rows = [[seconds(one) for one in work] for _ in range(RUNS + 1)]
    return np.array(rows[1:]).transpose(1, 0, 2)  # the first is not counted


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
    parser.add_argument("--seconds", type=float, default=2.0, help="simulated in each export (2)")
    arguments = parser.parse_args()
    versions = (
        f"lidarcfg {lidarcfg.__version__}, ouster-sdk {version('ouster-sdk')}, Python {platform.python_version()}"
    )
    print(f"{versions}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, medians of {RUNS} runs")
    scene = load_scene(ROOT / "data/scenes/street.yaml")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.yaml").write_text(RIG)
        rig = load_rig(folder / "rig.yaml")
        packets(folder, rig.mounts[0], scene)
        exports(folder, rig, scene, arguments.seconds)


if __name__ == "__main__":
    warnings.simplefilter("error")
    main()
