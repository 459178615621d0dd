#!/usr/bin/env python3
"""How fast captures are decoded, as medians of several runs, beside velodyne-decoder and ouster-sdk in the same run.

    .venv/bin/python tools/bench_decode.py              # prints the tables of docs/evidence/benchmarks.md
    .venv/bin/python tools/bench_decode.py --long 600   # and those of ten minutes of four sensors, a file of 2.3 GB

Velodyne: nine returns of ten are there, at random ranges. The arrays that come are let go one after another, as a
driver would; what each decoder takes to start is measured with few packets, and taken off. The last column is the user
time of one cloud of all points over that of the chunks; the system's time to hand out its memory is not in it. Ouster:
an OS1-128 in the street. A file is read as one cloud, beside ouster-sdk's frames and their points, all of which are
kept; ouster-sdk has one thread, lidarcfg all cores.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import velodyne_decoder as vd
from ouster.sdk import core, open_source
from page import ROOT, machine

import lidarcfg
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ETHERNET_HEADER, IP, RECORD, UDP
from lidarcfg.capture.pcap import FILE_HEADER
from lidarcfg.packets.velodyne.encode import encode
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.packets.velodyne.model import unit
from lidarcfg.sensors.schedule import firings
from lidarcfg.sensors.sensor import load_sensor

RUNS = 7
PACKETS = 40_000
START_NS = 1_767_225_600 * 10**9
HERE = Path(__file__).parent.parent
CASES = {
    ("vlp-16", "strongest"): vd.Model.VLP16,
    ("vlp-16", "dual"): vd.Model.VLP16,
    ("hdl-32e", "strongest"): vd.Model.HDL32E,
    ("vls-128", "strongest"): vd.Model.VLS128,
}
FRAME = np.dtype([("record", RECORD), ("ethernet", ETHERNET_HEADER), ("ip", IP), ("udp", UDP), ("packet", PACKET)])


def write(path: Path, model: str, mode: str, packets: int, sensors: int = 1) -> None:
    """A capture of sensors that send together; every thousand packets their ranges are the same again."""
    sensor = unit(load_sensor(model))
    dual = mode == "dual"
    rng = np.random.default_rng(1)
    fired = firings(sensor.firing_schedule(dual), 600.0, START_NS, range(1000))
    shape = len(fired.time_ns), 1 + dual
    per_packet = len(fired.time_ns) // 1000
    range_m = np.where(rng.random(shape) < 0.1, np.inf, rng.uniform(2, 100, shape))
    reflectivity = rng.integers(1, 256, shape, np.uint8)
    if dual:  # half of the firings had one return
        one = rng.random(len(fired.time_ns)) < 0.5
        range_m[one, 0] = range_m[one, 1]
        reflectivity[one, 0] = reflectivity[one, 1]
    frames = np.zeros((1000, sensors), FRAME)
    frames["record"]["captured"] = frames["record"]["length"] = FRAME.itemsize - RECORD.itemsize
    frames["ethernet"]["kind"] = 0x0800
    ip = frames["ip"]
    ip["version"] = 0x45
    ip["protocol"] = 17
    ip["length"] = FRAME.itemsize - RECORD.itemsize - ETHERNET_HEADER.itemsize
    ip["source"][:] = [[192, 168, 1, 201 + i] for i in range(sensors)]
    frames["udp"]["source_port"] = frames["udp"]["port"] = 2368
    with open(path, "wb") as file:
        file.write(FILE_HEADER)
        for first in range(0, packets, 1000):
            count = min(packets - first, 1000)
            fired = firings(sensor.firing_schedule(dual), 600.0, START_NS, range(first, first + count))
            some = slice(count * per_packet)
            frames["packet"][:count] = encode(sensor, mode, fired, range_m[some], reflectivity[some])[:, None]
            us = sensor.firing_schedule(dual).stamps_ns(fired)[1][:, None] // 1000 + np.arange(sensors)
            frames["record"]["seconds"][:count], frames["record"]["microseconds"][:count] = np.divmod(us, 10**6)
            file.write(frames[:count].tobytes())


def ours(path: Path) -> int:
    """The points of a capture."""
    return sum(len(cloud.xyz) for cloud in decode_pcap(path, print))


def theirs(path: Path, model: vd.Model) -> int:
    """The points of a capture by velodyne-decoder, as its page shows."""
    config = vd.Config(model=model, min_range=0, max_range=1000)
    return sum(len(points) for _, points in vd.read_pcap(str(path), config))


def against(folder: Path) -> None:
    """The table of both decoders, in turns."""
    heads = "capture | lidarcfg, million points/s | velodyne-decoder | times as fast | by CPU time | one cloud / chunks"
    print(f"\n| {heads} |\n|---|---|---|---|---|---|")
    for (name, mode), model in CASES.items():
        path = folder / "a.pcap"
        few = folder / "few.pcap"
        write(path, name, mode, PACKETS)
        write(few, name, mode, 20)
        rows = []
        for run in range(RUNS + 1):
            row = []
            for function, arguments in ((ours, ()), (theirs, (model,))):
                _, start_s, start_cpu_s = timed(function, few, *arguments)
                count, wall_s, cpu_s = timed(function, path, *arguments)
                row += [count / (wall_s - start_s) / 1e6, count / (cpu_s - start_cpu_s) / 1e6]
            row.append(user_s(kept_by_us, path) / user_s(ours, path))
            rows += [row] * (run > 0)  # the first is not counted
        mine, mine_cpu, other, other_cpu, whole = (statistics.median(column) for column in zip(*rows, strict=True))
        ratios = [row[0] / row[2] for row in rows]
        spread = f"{statistics.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})"
        print(
            f"| {name}, {mode} | {mine:.1f} | {other:.1f} | {spread} | {mine_cpu / other_cpu:.1f} | {whole:.2f} |",
            flush=True,
        )


def timed(function, *arguments) -> tuple[int, float, float]:
    """What it gives, seconds by the clock, seconds of all threads."""
    began = time.perf_counter()
    began_cpu = time.process_time()
    count = function(*arguments)
    return count, time.perf_counter() - began, time.process_time() - began_cpu


def user_s(function, *arguments) -> float:
    """The user time that it takes, of all threads."""
    began = os.times().user
    function(*arguments)
    return os.times().user - began


PROFILES = {
    "RNG19_RFL8_SIG16_NIR16": "strongest",
    "RNG19_RFL8_SIG16_NIR16_DUAL": "dual",
    "RNG15_RFL8_NIR8": "strongest",
    "FUSA_RNG15_RFL8_NIR8_DUAL": "dual",
    "LEGACY": "strongest",
}
OUSTER_RIG = """
name: one
sensors:
  - name: left
    model: os1-128
    position_m: [0.5, 0.6, 1.9]
    rpy_deg: [-5, 3, 0]
    return_mode: {mode}
    ouster: {{profile: {profile}, firmware: "3.2", imu: false}}
"""


def ouster(folder: Path) -> None:
    """The table of Ouster's profiles: 40 revolutions from a file, everything kept."""
    print("\n| OS1-128, 40 revolutions | lidarcfg, ms | ouster-sdk | times as fast | by CPU time |")
    print("|---|---|---|---|---|")
    path = folder / "os1.pcap"
    for profile, mode in PROFILES.items():
        (folder / "os1.yaml").write_text(OUSTER_RIG.format(profile=profile, mode=mode))
        lidarcfg.export(folder / "os1.yaml", ROOT / "data/scenes/street.yaml", path, duration_s=4.0)
        rows = []
        for run in range(RUNS + 1):
            _, sdk_s, sdk_cpu = timed(kept_by_sdk, path, mode == "dual")
            _, our_s, our_cpu = timed(kept_by_us, path)
            rows += [[our_s, sdk_s, our_cpu, sdk_cpu]] * (run > 0)  # the first is not counted
        ours_s, sdk_s, our_cpu, sdk_cpu = (statistics.median(column) for column in zip(*rows, strict=True))
        ratios = [row[1] / row[0] for row in rows]
        spread = f"{statistics.median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})"
        cells = f"{1e3 * ours_s:.0f} | {1e3 * sdk_s:.0f} | {spread} | {sdk_cpu / our_cpu:.1f}"
        print(f"| {profile} | {cells} |", flush=True)


def kept_by_us(path: Path) -> int:
    """The points of one cloud."""
    return len(lidarcfg.decode(path).xyz)


def kept_by_sdk(path: Path, dual: bool) -> int:
    """The frames of ouster-sdk, each with the points of its returns."""
    metadata = path.with_suffix(".json")
    lut = core.XYZLut(core.SensorInfo(metadata.read_text()))
    kept = [
        (frame, lut(frame), lut(frame.field("RANGE2")) if dual else None)
        for found in open_source(str(path), meta=[str(metadata)])
        for frame in found.valid_frames()
    ]
    return len(kept)


LONG = """
import resource, sys, time
began = time.perf_counter()
from lidarcfg.capture.selection import Selection
import lidarcfg
from lidarcfg.capture.decode import decode_pcap
loaded_s = time.perf_counter() - began
began, count = time.perf_counter(), 0
selection = Selection(float(sys.argv[2]), float(sys.argv[3]))
for cloud in decode_pcap(sys.argv[1], print, selection=selection):
    count += len(cloud.xyz)
peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
print(loaded_s, time.perf_counter() - began, count, peak_mb)
"""


def long(folder: Path, seconds: float) -> None:
    """The table of a long capture of four VLP-16: each row in a process of its own."""
    path = folder / "long.pcap"
    write(path, "vlp-16", "strongest", int(seconds * 1e9) // unit(load_sensor("vlp-16")).period_ns(), sensors=4)
    print(
        f"\n| four VLP-16, {seconds:g} s, {path.stat().st_size / 1e9:.1f} GB | s | of them to load | points | peak MB |"
    )
    print("|---|---|---|---|---|")
    windows = {
        "the first turn": (0.0, 0.1),
        "a turn in the middle": (seconds / 2, seconds / 2 + 0.1),
        "the last turn": (seconds - 0.2, seconds - 0.1),
        "a tenth of it": (0.0, seconds / 10),
        "all of it": (0.0, seconds),
    }
    for name, (low, high) in windows.items():
        rows = []
        for _ in range(3 if high - low < 1 else 1):
            command = [sys.executable, "-c", LONG, str(path), str(low), str(high)]
            out = subprocess.run(command, cwd=HERE, check=True, capture_output=True, text=True).stdout
            rows.append([float(value) for value in out.split()])
        loaded, took, count, peak = (statistics.median(column) for column in zip(*rows, strict=True))
        print(f"| {name} | {loaded + took:.2f} | {loaded:.2f} | {count:,.0f} | {peak:.0f} |", flush=True)


def main() -> None:
    """Print the machine and the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--long", type=float, metavar="S", help="also a capture of so many seconds")
    args = parser.parse_args()
    print(f"{machine()}, velodyne-decoder {version('velodyne-decoder')}, ouster-sdk {version('ouster-sdk')}")
    with tempfile.TemporaryDirectory() as name:
        against(Path(name))
        ouster(Path(name))
        if args.long:
            long(Path(name), args.long)


if __name__ == "__main__":
    main()
