#!/usr/bin/env python3
"""How fast each family's packets are written and read, as medians of several runs, all models in turn in each run.

    .venv/bin/python tools/bench_packets.py     # prints the table of docs/hesai.md and docs/robosense.md

Every laser hits something, at random ranges. Encoding and writing is one thread, from ranges to the pcap; decoding is
from the pcap to points, on all cores; the arrays are let go one after another, as a driver would. The second table is
by the processor's time, of all cores together, which says more where other work is done beside. hydra4, which is plain
Python, reads the PandarXT-32's packets in the same run.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from page import machine

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.frames import frames
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.packets.families import codec
from lidarcfg.rig import Mount, ports
from lidarcfg.sensor import load_sensor
from lidarcfg.simulate.export import save_companions
from lidarcfg.simulate.tasks import START_NS
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import standing
from lidarcfg.world.scene import GeoOrigin

MODELS = ("vlp-16", "os1-128", "pandar-xt32", "pandar-xt16", "xt32m2x", "qt128", "helios-16p", "helios-32")
MODES = ("strongest", "dual")
RUNS, RETURNS, CHUNK = 5, 3_000_000, 200_000  # returns of a capture, and at a time, about
HYDRA_PACKETS = 200


def mount(model: str, return_mode: str) -> Mount:
    """The sensor alone, with its maker's ports."""
    sensor = load_sensor(model)
    data_port, telemetry_port = ports(sensor)
    return Mount(
        name=model,
        sensor=sensor,
        position_m=(0.0, 0.0, 0.0),
        rpy_rad=(0.0, 0.0, 0.0),
        model=model,
        host="192.168.1.201",
        data_port=data_port,
        telemetry_port=telemetry_port,
        rpm=600.0,
        return_mode=return_mode,  # type: ignore[arg-type]  # a text from a table above
    )


class Capture:
    """What one sensor measured, to be written to a file and read from it."""

    def __init__(self, folder: Path, model: str, return_mode: str) -> None:
        self._of, self._maker = mount(model, return_mode), codec(load_sensor(model))
        self.path = folder / f"{model}-{return_mode}.pcap"
        pace, columns = self._maker.pace(self._of), 1 + (return_mode == "dual")
        packets, chunk = RETURNS // (pace.firings * columns), CHUNK // (pace.firings * columns)
        rng, self._measured = np.random.default_rng(1), []
        for batch in self._maker.schedule(self._of, START_NS, packets, chunk):
            shape = len(batch.firings.time_ns), columns
            range_m = np.sort(rng.uniform(1.0, 49.0, shape), axis=1)
            self._measured.append((batch, range_m, rng.integers(0, 256, shape, np.uint8)))
        self.returns = sum(range_m.size for _, range_m, _ in self._measured)
        still, origin = standing(np.eye(4)), GeoOrigin()
        self._housekeeping = list(self._maker.housekeeping(self._of, still, origin, START_NS, SECOND_NS))
        save_companions(self.path, [self._of])

    def write(self) -> int:
        """How many returns are encoded and written."""
        packets = (self._maker.encode(self._of, *one) for one in self._measured)
        write_pcap(self.path, (frames(self._of.host, one) for group in (self._housekeeping, packets) for one in group))
        return self.returns

    def read(self) -> int:
        """How many points are decoded."""
        return sum(len(cloud.xyz) for cloud in decode_pcap(self.path, print))

    def hydra4(self) -> int:
        """The same by hydra4, of the first packets."""
        from hydra4.decoders.pandar_xt32 import PandarXT32

        payloads = self._maker.encode(self._of, *self._measured[0]).data[:HYDRA_PACKETS]
        (angles,) = self.path.parent.glob(f"{self.path.stem}-*-angles.csv")
        decode, count = PandarXT32(angles, 0.0, 1000.0), 0
        for payload in payloads:
            count += sum(len(block.points) for block in decode(SimpleNamespace(data=payload.tobytes())))
        return count


def rates(function: Callable[[], int]) -> tuple[float, float]:
    """Millions a second, by the clock and by the processor's time."""
    began, spent = time.perf_counter(), time.process_time()
    count = function()
    return count / (time.perf_counter() - began) / 1e6, count / (time.process_time() - spent) / 1e6


def cell(values: list[float]) -> str:
    """The median, and the spread."""
    return f"{statistics.median(values):.0f} ({min(values):.0f} to {max(values):.0f})"


def main() -> None:
    """Print the machine and the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    print(f"{machine()}, medians of {RUNS} runs and their spread")
    measured: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        captures = {(model, mode): Capture(Path(name), model, mode) for model in MODELS for mode in MODES}
        hydra = []
        for run in range(RUNS + 1):  # the first is not counted
            for (model, mode), capture in captures.items():
                for what, function in (("write", capture.write), ("read", capture.read)):
                    found = rates(function)
                    if run:
                        measured.setdefault((model, mode, what), []).append(found)
            hydra.append(rates(captures["pandar-xt32", "strongest"].hydra4)[1])
    for by, title in enumerate(("million returns/s", "by the processor's time")):
        print(f"\n| {title} | encode and write, single | dual | decode, single | dual |\n|---|---|---|---|---|")
        for model in MODELS:
            of = ([row[by] for row in measured[model, mode, what]] for what in ("write", "read") for mode in MODES)
            print(f"| `{model}` | {' | '.join(map(cell, of))} |")
    rate = statistics.median(hydra)
    times = statistics.median(row[1] for row in measured["pandar-xt32", "strongest", "read"]) / rate
    hydra4 = f"hydra4 {version('hydra4')} reads `pandar-xt32` at {rate:.2f} million points/s"
    print(f"\n{hydra4} of the processor's time: lidarcfg is {times:.0f} times as fast.")


if __name__ == "__main__":
    main()
