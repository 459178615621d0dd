#!/usr/bin/env python3
"""Whether a live rig keeps real time, and how regularly its packets come, as the receiving socket's kernel stamps them.

    .venv/bin/python tools/bench_live.py --seconds 20   # prints the table of docs/evidence/benchmarks.md; on Linux

Four VLP-16 and an OT128 drive along data/scenes/street.yaml, moved by poses, while a bus is moved beside them.
"""

import argparse
import multiprocessing
import socket
import struct
import time
from multiprocessing.connection import Connection

import numpy as np
from page import ROOT, machine

from lidarcfg import Live, load_rig
from lidarcfg.geometry import Array, pose
from lidarcfg.packets.families import codec

RIG = {
    "name": "four VLP-16 and an OT128",
    "sensors": [
        {"name": "front_left", "model": "vlp-16", "position_m": [0.8, 0.6, 1.9], "rpy_deg": [-5, 3, 0]},
        {"name": "front_right", "model": "vlp-16", "position_m": [0.8, -0.6, 1.9], "rpy_deg": [5, 3, 0]},
        {"name": "rear_left", "model": "vlp-16", "position_m": [-0.8, 0.6, 1.9], "rpy_deg": [-5, -3, 0]},
        {"name": "rear_right", "model": "vlp-16", "position_m": [-0.8, -0.6, 1.9], "rpy_deg": [5, -3, 0]},
        {"name": "roof", "model": "ot128", "position_m": [0, 0, 2.1]},
    ],
}
SO_TIMESTAMPNS = 35  # of Linux: include/uapi/asm-generic/socket.h
SPEED_M_S = 5.0
BEGIN = 100  # packets of each sensor, that are not counted


def receive(pipe: Connection) -> None:
    """Send the port, then, when nothing more comes, the arrivals: address, bytes, seconds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
        opened.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(20)
        pipe.send(opened.getsockname()[1])
        got = []
        try:
            while True:
                payload, extra, _, (address, _) = opened.recvmsg(2048, 256)
                seconds, nanoseconds = struct.unpack("qq", extra[0][2])
                got.append((address, len(payload), seconds * 10**9 + nanoseconds))
                opened.settimeout(2)
        except TimeoutError:
            pipe.send(got)


def late_s(arrived_ns: Array, period_ns: int) -> Array:
    """By how much packets are later or earlier than the middle one, if they are to come in a rhythm."""
    off_ns = arrived_ns - arrived_ns[0] - np.arange(len(arrived_ns)) * period_ns
    return np.asarray((off_ns - np.median(off_ns)) / 1e9)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    rig = load_rig(RIG)
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    receiver = multiprocessing.get_context("spawn").Process(target=receive, args=(theirs,))
    receiver.start()
    spent_s = time.process_time()
    with Live(rig, ROOT / "data/scenes/street.yaml", f"127.0.0.1:{ours.recv()}") as live:
        while (at_s := live.statistics.time_s) < seconds:
            live.move("vehicle", pose((SPEED_M_S * at_s - 20, 0, 0), (0, 0, 0)))
            live.move("parked_south_5", pose((SPEED_M_S * at_s - 20, 3, 0.55), (0, 0, 0)))
            live.step()
    cores = (time.process_time() - spent_s) / seconds
    done = live.statistics
    got = ours.recv()
    print(machine())
    print(f"{seconds:g} s: {done.packets:,} packets, {cores:.2f} cores; {done.slowed_s:.3f} s slower than real time")
    print(f"received {len(got):,}; the latest was sent {done.latest_s * 1000:.1f} ms late\n")
    print("| sensor | packets | 50 % within | 99 % within | all within |\n|---|---|---|---|---|")
    for mount in rig.mounts:
        address = "127" + mount.host[mount.host.index(".") :]
        sizes = [size for one, size, _ in got if one == address]
        data = max(set(sizes), key=sizes.count)
        arrived_ns = np.array([at for one, size, at in got if one == address and size == data])[BEGIN:]
        off_ms = abs(late_s(arrived_ns, codec(mount.sensor).pace(mount).period_ns)) * 1000
        within = " | ".join(f"{np.percentile(off_ms, q):.2f} ms" for q in (50, 99, 100))
        print(f"| {mount.sensor.name} {mount.name} | {len(arrived_ns):,} | {within} |")


if __name__ == "__main__":
    main()
