#!/usr/bin/env python3
"""How fast rays are traced and captures are written, as medians of several runs, beside Open3D in the same run.

    .venv/bin/python tools/bench_capture.py            # prints the tables of docs/evidence/benchmarks.md
    .venv/bin/python tools/bench_capture.py --long 600 # and the memory of ten minutes, in a file of 2.5 GB

Four VLP-16 stand in data/scenes/street.yaml, whose road is paved here with a mesh of 200,000 triangles; or they are
driven along the paving, to and fro.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
from page import ROOT, machine

from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.geometry import Array, directions, pose, transform
from lidarcfg.packets.families import codec
from lidarcfg.sensors.firing import Firings, spans
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Mount, Rig, load_rig
from lidarcfg.simulate.sensor_runs import CHUNK_RAYS
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Motion, TimedPose, Trajectory, build_path
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import Tracer

RUNS = 5
RIG = """
name: roof corners
sensors:
  - {name: front_left, model: vlp-16, position_m: [0.8, 0.6, 1.9], rpy_deg: [-5, 3, 0]}
  - {name: front_right, model: vlp-16, position_m: [0.8, -0.6, 1.9], rpy_deg: [5, 3, 0]}
  - {name: rear_left, model: vlp-16, position_m: [-0.8, 0.6, 1.9], rpy_deg: [-5, -3, 0]}
  - {name: rear_right, model: vlp-16, position_m: [-0.8, -0.6, 1.9], rpy_deg: [5, -3, 0]}
"""
COLUMNS, ROWS = 500, 200  # cells of the paving, two triangles each
LENGTH_M, WIDTH_M = 60.0, 13.0
SPEED_M_S = 10.0  # along the paving, to and fro
BODY = (50, 50)
MILLION = (708, 708)  # quads of closed bodies of 4,900 and of a million triangles
CUBOIDS = (-30.0, -10.0, -0.75), (30.0, 10.0, 3.25), (60, 40, 20)  # of the paper's region around a body
BODY_SCENE = "name: body\nmeshes: [{name: body, file: body.ply, position_m: [0, 0, 0], reflectivity: 20}]\n"


def pave(folder: Path) -> Path:
    """The street with setts of 3 cm on its road, 200,000 triangles; returns the scene's file."""
    x, y = np.linspace(-LENGTH_M / 2, LENGTH_M / 2, COLUMNS + 1), np.linspace(-WIDTH_M / 2, WIDTH_M / 2, ROWS + 1)
    xx, yy = np.meshgrid(x, y, indexing="ij")
    height = 0.02 + 0.015 * np.sin(xx * (2 * np.pi / 0.6)) * np.sin(yy * (2 * np.pi / 0.4))
    number = np.arange((COLUMNS + 1) * (ROWS + 1)).reshape(COLUMNS + 1, ROWS + 1)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.stack([xx, yy, height], axis=-1).reshape(-1, 3)),
        o3d.utility.Vector3iVector(np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])),
    )
    o3d.io.write_triangle_mesh(str(folder / "setts.ply"), mesh)
    text = (ROOT / "data/scenes/street.yaml").read_text().replace("meshes/", f"{ROOT}/data/scenes/meshes/")
    setts = "  - {name: setts, file: setts.ply, position_m: [0, 0, 0], reflectivity: 20}\n"
    (folder / "scene.yaml").write_text(text.replace("meshes:\n", "meshes:\n" + setts))
    (folder / "rig.yaml").write_text(RIG)
    return folder / "scene.yaml"


def seconds(function: Callable[[], object]) -> tuple[float, float]:
    """By the clock, and of the processor: the latter says more where other work is done beside."""
    began = time.perf_counter()
    spent = time.process_time()
    function()
    return time.perf_counter() - began, time.process_time() - spent


def rays_of(mount: Mount, duration_ns: int) -> Iterator[tuple[Firings, Array, Array]]:
    """Chunks of a mount's firings, with the origins and directions (N, 3) of their rays in the vehicle frame."""
    maker = codec(mount.sensor)
    sensor = mount.sensor
    T = mount.T_vehicle_sensor
    pace = maker.pace(mount)
    for batch in maker.schedule(mount, START_NS, spans(duration_ns // pace.period_ns, CHUNK_RAYS // pace.firings)):
        fired = batch.firings
        azimuth_rad = fired.encoder_rad + sensor.azimuth_offset_rad[fired.laser]
        axes = directions(azimuth_rad, sensor.elevation_rad[fired.laser])
        origins = np.zeros_like(axes)
        origins[:, 2] = sensor.vertical_offset_m[fired.laser]
        yield fired, transform(T, origins), axes @ T[:3, :3].T


def body(folder: Path, columns: int, rows: int) -> Scene:
    """A scene of one closed wavy body around the origin."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, columns), np.linspace(0.02, np.pi - 0.02, rows), indexing="ij")
    size = 1 + 0.03 * np.sin(9 * u) * np.sin(7 * v)
    vertices = np.stack(
        [2.2 * size * np.cos(u) * np.sin(v), 0.9 * size * np.sin(u) * np.sin(v), 0.7 * size * np.cos(v)], axis=-1
    )
    number = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices.reshape(-1, 3)), o3d.utility.Vector3iVector(triangles)
    )
    o3d.io.write_triangle_mesh(str(folder / "body.ply"), mesh)
    (folder / "body.yaml").write_text(BODY_SCENE)
    return load_scene(folder / "body.yaml")


def raycasting(scene: Scene) -> o3d.t.geometry.RaycastingScene:
    """Open3D's, of the same triangles."""
    theirs = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    vertices, triangles = scene.mesh(0.001)
    theirs.add_triangles(tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32)))
    return theirs


def tracing(folder: Path) -> None:
    """The table of rays, one thread each: first hits of four VLP-16, any hits around a body, building."""
    scene = load_scene(pave(folder))
    rig = load_rig(folder / "rig.yaml")
    chunks = [chunk for mount in rig.mounts for chunk in rays_of(mount, 2 * SECOND_NS)]
    orders = [np.argsort(fired.laser, kind="stable") for fired, _, _ in chunks]  # laser by laser, as exports do
    origins, along = (
        np.concatenate([chunk[k][order] for chunk, order in zip(chunks, orders, strict=True)]) for k in (1, 2)
    )
    ours, theirs = Tracer(scene, np.zeros(3)), raycasting(scene)
    rays = o3d.core.Tensor.from_numpy(np.concatenate([origins, along], axis=1).astype(np.float32))
    print(f"\n| one thread; Open3D {o3d.__version__} | million rays/s | Open3D's | ratio | spread |")
    print("|---|---|---|---|---|")
    beside(
        f"first hit, four VLP-16, {len(scene.triangles):,} triangles",
        len(origins),
        lambda: ours.cast(origins, along),
        lambda: theirs.cast_rays(rays, nthreads=1),
    )
    stage = body(folder, *BODY)
    axes = [low + (np.arange(n) + 0.5) * (high - low) / n for low, high, n in zip(*CUBOIDS, strict=True)]
    targets = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    origin = np.array([0.4, 0.3, 0.95])
    tracer = Tracer(stage, np.zeros(3))
    others = raycasting(stage)
    segments = np.concatenate([np.broadcast_to(origin, targets.shape), targets - origin], axis=1)
    given = o3d.core.Tensor.from_numpy(segments.astype(np.float32))
    agree = (tracer.blocked(origin, targets) == others.test_occlusions(given, 0.0, 1.0).numpy()).mean()
    beside(
        f"any hit, {len(targets):,} cuboids around {len(stage.triangles):,} triangles ({agree:.3%} agree)",
        len(targets),
        lambda: tracer.blocked(origin, targets),
        lambda: others.test_occlusions(given, 0.0, 1.0, nthreads=1),
    )
    million = body(folder, *MILLION)
    built = np.array([seconds(lambda: Tracer(million, np.zeros(3)))[1] for _ in range(3)])
    what = f"build, {len(million.triangles):,} triangles, s"
    spread = f"{built.min():.2f} to {built.max():.2f}"
    print(f"| {what} | {np.median(built):.2f} | | | {spread} |")


def beside(what: str, count: int, ours: Callable[[], object], theirs: Callable[[], object]) -> None:
    """A row: rates by the processor's time, in turns, and how many times as fast."""
    spent = np.array([[seconds(one)[1] for one in (ours, theirs)] for _ in range(RUNS + 1)])[1:]
    rates = count / np.median(spent, axis=0) / 1e6
    ratio = spent[:, 1] / spent[:, 0]
    spread = f"{ratio.min():.2f} to {ratio.max():.2f}"
    print(f"| {what} | {rates[0]:.1f} | {rates[1]:.1f} | {np.median(ratio):.2f} | {spread} |")


def bare(rig: Rig, scene: Scene, duration_ns: int) -> tuple[Callable[[], None], int]:
    """What casts the capture's rays, chunk by chunk, by Open3D alone; and how many they are."""
    caster = raycasting(scene)
    tensor = o3d.core.Tensor.from_numpy
    chunks = [
        tensor(np.concatenate([origins, axes], axis=1).astype(np.float32))
        for mount in rig.mounts
        for _, origins, axes in rays_of(mount, duration_ns)
    ]

    def cast() -> None:
        for chunk in chunks:
            caster.cast_rays(chunk)

    return cast, sum(len(chunk) for chunk in chunks)


def encoding(mount: Mount, packets: int, path: Path) -> tuple[Callable[[], None], int]:
    """What encodes and writes so many packets, all of whose returns are there; and how many returns."""
    maker = codec(mount.sensor)
    (batch,) = maker.schedule(mount, START_NS, [range(packets)])
    range_m = np.random.default_rng(1).uniform(1, 99, (len(batch.firings.time_ns), 1))
    reflectivity = np.full(range_m.shape, 9, np.uint8)

    def write() -> None:
        write_pcap(path, [ethernet_frames(mount.host, maker.encode(mount, batch, range_m, reflectivity))])

    return write, int(range_m.size)


def writing(folder: Path, simulated_s: float) -> None:
    """The table of exports."""
    scene = load_scene(pave(folder))
    rig = load_rig(folder / "rig.yaml")
    duration_ns = round(simulated_s * SECOND_NS)
    cast, count = bare(rig, scene, duration_ns)
    write, returns = encoding(rig.mounts[0], 2000, folder / "b.pcap")

    def whole() -> None:
        write_pcap(folder / "a.pcap", in_time_order(simulated_packets(rig, scene, np.eye(4), duration_ns)))

    leg_s = LENGTH_M / SPEED_M_S
    turns = tuple(
        TimedPose(time_s=n * leg_s, position_m=(LENGTH_M * (n % 2), 0.0, 0.0))
        for n in range(int(simulated_s / leg_s) + 3)
    )
    drive = Trajectory(pose((-LENGTH_M / 2, 0.0, 0.0), (0.0, 0.0, 0.0)), build_path(Motion(poses=turns)), START_NS)

    def driven() -> None:
        write_pcap(folder / "c.pcap", in_time_order(simulated_packets(rig, scene, drive, duration_ns)))

    wide = replace(rig, mounts=tuple(replace(one, realism=Realism(divergence=True)) for one in rig.mounts))
    street = load_scene(ROOT / "data/scenes/street.yaml")

    def sent(of: Rig, stage: Scene) -> Callable[[], None]:
        return lambda: write_pcap(
            folder / "d.pcap", in_time_order(simulated_packets(of, stage, np.eye(4), duration_ns // 4))
        )

    def start() -> None:
        next(in_time_order(simulated_packets(rig, scene, np.eye(4), duration_ns)))

    measured: dict[str, list[tuple[float, float]]] = {}
    for run in range(RUNS + 1):  # the first is not counted
        for name, function in (
            ("whole", whole),
            ("cast", cast),
            ("driven", driven),
            ("start", start),
            ("write", write),
            ("thin", sent(rig, scene)),
            ("wide", sent(wide, scene)),
            ("thin street", sent(rig, street)),
            ("wide street", sent(wide, street)),
        ):
            found = seconds(function)
            if run:
                measured.setdefault(name, []).append(found)
    (whole_s, whole_cpu), (cast_s, cast_cpu), (driven_s, _), (start_s, _), (write_s, write_cpu) = (
        np.array(measured[name]).T for name in ("whole", "cast", "driven", "start", "write")
    )
    wider = {
        place: np.array(measured[f"wide{place}"])[:, 1] / np.array(measured[f"thin{place}"])[:, 1]
        for place in ("", " street")
    }
    print(
        f"\n| four VLP-16, a street and a mesh, {len(scene.triangles):,} triangles | median | spread |\n|---|---|---|"
    )
    for name, values, digits in (
        ("export to pcap, × real time", simulated_s / whole_s, 1),
        ("export, million rays/s", count / whole_s / 1e6, 1),
        ("bare `cast_rays`, the same rays, million rays/s", count / cast_s / 1e6, 1),
        ("export's rate against that of bare `cast_rays`, %", 100 * cast_s / whole_s, 0),
        ("the same by the processor's time, %", 100 * cast_cpu / whole_cpu, 0),
        (f"export while they are driven at {SPEED_M_S:g} m/s, × real time", simulated_s / driven_s, 1),
        ("with wide beams (divergence), times the processor's time", wider[""], 1),
        ("the same in the street without the mesh", wider[" street"], 1),
        ("its start, until the first packets, s", start_s, 2),
        ("encode + write alone, one thread, million returns/s", returns / write_s / 1e6, 1),
        ("the same by the processor's time, million returns/s", returns / write_cpu / 1e6, 1),
    ):
        print(f"| {name} | {np.median(values):.{digits}f} | {values.min():.{digits}f} to {values.max():.{digits}f} |")


LONG = """
import sys, time
import numpy as np
from pathlib import Path
from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.world.scene import load_scene
from lidarcfg.sensors.rig import load_rig
folder, minutes = Path(sys.argv[1]), float(sys.argv[2]) / 60
began, marks = time.perf_counter(), [m for m in (1, 5) if m < minutes] + [minutes]
def peak_mb():
    return int(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]) / 1024
def progress(done_ns):
    while marks and done_ns >= marks[0] * 60e9:
        print(f"| {marks.pop(0):g} | {peak_mb():.0f} | {time.perf_counter() - began:.0f} |", flush=True)
scene, rig = load_scene(folder / "scene.yaml"), load_rig(folder / "rig.yaml")
streams = simulated_packets(rig, scene, np.eye(4), round(minutes * 60e9), options=SimulationOptions(progress))
write_pcap(folder / "long.pcap", in_time_order(streams))
"""


def long(folder: Path, simulated_s: float) -> None:
    """The table of memory, of a process that does nothing else."""
    pave(folder)
    print("\n| minutes simulated | peak memory (MB) | seconds |\n|---|---|---|", flush=True)
    subprocess.run([sys.executable, "-c", LONG, str(folder), str(simulated_s)], check=True)
    print(f"\nThe file has {(folder / 'long.pcap').stat().st_size / 1e9:.2f} GB.")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="simulated in each run (30)")
    parser.add_argument("--long", type=float, metavar="SECONDS", help="also measure the memory of so long a capture")
    arguments = parser.parse_args()
    print(f"{machine()}, medians of {RUNS} runs of {arguments.seconds:g} s")
    with tempfile.TemporaryDirectory() as folder:
        tracing(Path(folder))
        writing(Path(folder), arguments.seconds)
        if arguments.long:
            long(Path(folder), arguments.long)


if __name__ == "__main__":
    main()
