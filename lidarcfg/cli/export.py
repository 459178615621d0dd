"""lidarcfg export: what a rig's sensors send or see in a scene."""

import time
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lidarcfg.cli.options import (
    FILE,
    START_HELP,
    Seconds,
    StartTime,
    at_option,
    quiet_option,
    scene_option,
    trajectory_option,
    vehicle_option,
    warn,
    warn_of,
)
from lidarcfg.cli.progress import progress
from lidarcfg.units import SECOND_NS

KNOWN = 0.02  # of an export, after which the fraction of rays that return is known
COPIES = 2  # of a cloud on the disk, while it is written: its points are in a file of their own first
LESS = "a shorter time or fewer sensors need less"

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lidarcfg.capture.manifest import DriveInputs
    from lidarcfg.sensors.rig import ReturnMode, Rig
    from lidarcfg.simulate.scene_drive import SceneDrive
    from lidarcfg.simulate.sensor_runs import SimulationOptions
    from lidarcfg.simulate.simulator import RayCounts

    Size = Callable[[float], str]  # of the files, as far as it is known when a fraction of the work is done


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg export out/sedan/rig.yaml --scene data/scenes/street.yaml \\
          --at=0,-1.8,0 --duration 1 -o out/sedan.pcap
    """
)
@cloup.argument("rig", type=FILE, help="YAML: the sensors and their poses.")
@cloup.option_group(
    "Scene and motion",
    scene_option,
    at_option,
    trajectory_option,
    vehicle_option,
    cloup.option("--start", type=StartTime(), metavar="TIME", help=START_HELP),
    cloup.option(
        "--return-mode",
        type=click.Choice(["strongest", "last", "first", "dual", "first-last", "first-strongest", "two-strongest"]),
        metavar="MODE",
        help="For every sensor: strongest, last, first or dual; Hesai's sensors also allow first-last, first-strongest "
        "and two-strongest.  [default: the rig's]",
    ),
    cloup.option(
        "--faults",
        type=FILE,
        metavar="FILE|none",
        help="What goes wrong with which sensor, and when: YAML; only for a .pcap.  [default: the rig's]",
    ),
    cloup.option("--duration", type=Seconds(86_400), metavar="SECONDS", required=True, help="Simulated time."),
)
@cloup.option_group(
    "Output",
    cloup.option("-o", "--output", type=FILE, required=True, help="The file or folder to write; see above."),
    cloup.option("--to", "name", metavar="FORMAT", help="The format, if the suffix does not name it."),
    cloup.option("--split", is_flag=True, help="Write one file per sensor: NAME-SENSOR.pcap."),
    cloup.option("--truth", type=FILE, help="Write the ground truth of each return, as .npz: object, range, noise."),
    cloup.option("--deskew", is_flag=True, help="Write points in the world frame; only for .ply, .pcd and .npz."),
    cloup.option("--stats", is_flag=True, help="Print how many rays were traced and how many hit."),
    quiet_option,
)
def export(**given: Any) -> None:
    """Simulate what a rig's sensors send or see in a scene.

    A pcap holds their packets; the other formats hold points with the ground truth. The vehicle stands, or moves
    along a trajectory. The same input gives the same bytes. A YAML file beside the output, the manifest, names
    rig, scene and trajectory, so that `decode --deskew` and `view` find them.

    \b
    OUTPUT      FORMAT
    .pcap       packets
    .ply .npz   one cloud, each point's object, boxes
    .pcd        the same without boxes
    .mcap       points, objects, boxes, /tf for ROS 2
    .bag        rosbag1: the same for ROS 1
    folder      rosbag2, rosbag2-mcap: for ROS 2
    folder      kitti-odometry, kitti-object,
                nuscenes: each needs --to
    """
    options = ExportOptions(**given)
    if not options.output.name:
        what = f"{str(options.output)!r} names neither a file nor a folder to write"
        raise click.BadParameter(what, param_hint="-o")
    with progress(options.quiet, keep=False) as on_fraction:
        on_fraction(0.0, f"reading {options.rig} and {options.scene}")
        from lidarcfg.capture.manifest import manifest_path
        from lidarcfg.files import check_replaceable
        from lidarcfg.study.checks import rig_warnings

        drive = options.inputs.load()
    warn_of(drive.vehicle)
    for message in rig_warnings(options.rig, vehicle=drive.vehicle):
        warn(message)
    if options.return_mode:
        _warn_of_thin_beams(drive.rig)
    for path in options.paths(drive.rig):  # not after hours
        if options.is_capture:
            check_replaceable(path)
        check_replaceable(manifest_path(path))
    rays = RayTally()
    lines = _export_packets(options, drive, rays) if options.is_capture else _export_points(options, drive, rays)
    for line in [] if options.quiet else lines:
        click.echo(line)
    if options.stats:
        click.echo(f"{rays.traced:,} rays traced, of which {rays.hits:,} ({rays.fraction:.1%}) hit something in range")


@dataclass(frozen=True)
class ExportOptions:
    """The arguments and options of the command."""

    rig: Path
    scene: Path
    trajectory: Path | None
    vehicle: Path | None
    at: str
    start: str | None
    duration: float
    return_mode: "ReturnMode | None"
    faults: Path | None
    output: Path
    name: str | None
    split: bool
    truth: Path | None
    deskew: bool
    stats: bool
    quiet: bool

    @property
    def inputs(self) -> "DriveInputs":
        """What the drive is assembled from."""
        from lidarcfg.capture.manifest import DriveInputs

        motion = self.trajectory, self.vehicle, self.at, self.start
        return DriveInputs(self.rig, self.scene, *motion, self.duration, self.return_mode, self.faults)

    @property
    def is_capture(self) -> bool:
        """Whether packets are written; else points."""
        return self.output.suffix == ".pcap" and self.name is None

    def paths(self, rig: "Rig") -> list[Path]:
        """The files or the folder to write."""
        if self.split and self.output.suffix == ".pcap":
            return [self.output.with_name(f"{self.output.stem}-{mount.name}.pcap") for mount in rig.mounts]
        return [self.output]

    def save_manifest(self, path: Path, drive: "SceneDrive", hits: "Counter[int]") -> None:
        """Write the manifest beside what was written, with how many packets each fault has hit."""
        from lidarcfg.capture.manifest_writer import ManifestInputs

        ManifestInputs.of(drive, path, self.inputs).with_faults(drive, hits).save(path, warn)


@dataclass
class RayTally:
    """The rays of an export so far, and the packets with faults."""

    traced: int = 0
    hits: int = 0
    faulty: Counter[int] = field(default_factory=Counter)  # packets, by the fault that hit them

    def add(self, counts: "RayCounts") -> None:
        """Count those of a chunk."""
        self.traced += counts.rays
        self.hits += counts.hits

    def add_fault(self, number: int, packets: int) -> None:
        """Count packets that a fault has hit."""
        self.faulty[number] += packets

    @property
    def fraction(self) -> float:
        """That hit something in range."""
        return self.hits / max(self.traced, 1)


@contextmanager
def _run(duration_ns: int, size: "Size", rays: RayTally, quiet: bool) -> "Iterator[SimulationOptions]":
    """A run with a progress bar, which says how large the files will be, and counts the rays."""
    from lidarcfg.simulate.sensor_runs import SimulationOptions

    began = time.perf_counter()

    with progress(quiet) as on_fraction:

        def on_progress(done_ns: int) -> None:
            rate = done_ns / SECOND_NS / max(time.perf_counter() - began, 1e-9)
            done_s = done_ns / SECOND_NS
            said = f"{done_s:.1f} s simulated, {rate:.2g}× real time; {size(done_ns / duration_ns)} in all"
            on_fraction(done_ns / duration_ns, said)

        on_fraction(0.0, f"simulating {duration_ns / SECOND_NS:g} s; {size(0.0)} in all")
        yield SimulationOptions(on_progress, rays.add, rays.add_fault)


def _export_packets(options: ExportOptions, drive: "SceneDrive", rays: RayTally) -> list[str]:
    """Write one pcap, or with `split` one of each sensor, and the files that readers need. Returns what to print."""
    from contextlib import ExitStack

    from lidarcfg.capture.export import data_bytes, in_time_order, save_sidecar_files, simulated_packets
    from lidarcfg.capture.ground_truth import TruthFile
    from lidarcfg.capture.pcap import write_pcap
    from lidarcfg.inputs import check_room, format_bytes
    from lidarcfg.simulate.scene_drive import object_names
    from lidarcfg.world.boxes import lack_of_categories

    if options.deskew:
        raise click.UsageError("--deskew is for points; packets stay as a sensor sends them")
    truth = options.truth
    paths = options.paths(drive.rig)
    if truth and truth.suffix != ".npz":
        raise click.BadParameter(f"{str(truth)!r} does not end in .npz", param_hint="--truth")
    if truth and (said := lack_of_categories(drive.scene)) and not options.quiet:
        warn(said)
    mounts = drive.rig.mounts
    names = [mount.name for mount in mounts]
    size = data_bytes(drive)
    check_room(paths[0], size, LESS)
    with (
        _run(drive.duration_ns, lambda done: f"about {format_bytes(size)}", rays, options.quiet) as run,
        ExitStack() as stack,
    ):
        objects = object_names(drive.scene, drive.vehicle)
        beside = stack.enter_context(TruthFile(truth, names, objects)) if truth else None
        streams = simulated_packets(
            drive.rig,
            drive.scene,
            drive.trajectory,
            drive.duration_ns,
            drive.start_ns,
            beside.add if beside else None,
            drive.vehicle,
            run,
        )
        if options.split:
            counts = [write_pcap(path, stream) for path, stream in zip(paths, streams, strict=True)]
            pairs = zip(paths, mounts, strict=True)
            sidecars = [one for path, mount in pairs for one in save_sidecar_files(path, [mount])]
        else:
            counts = [write_pcap(paths[0], in_time_order(streams))]
            sidecars = save_sidecar_files(paths[0], mounts)
        records = beside.save() if beside else 0
        for path in paths:
            options.save_manifest(path, drive, rays.faulty)
    duration = f"{drive.duration_ns / SECOND_NS:g} s"
    lines = [f"{path}: {count:,} packets, {duration}" for path, count in zip(paths, counts, strict=True)]
    lines += [f"{path}: readers of the capture need it, too" for path in sidecars]
    lines += [
        f"{fault.sensor}: {fault.fault} from {fault.start_s:g} to {fault.end_s:g} s, {rays.faulty[i]:,} packets"
        for i, fault in enumerate(drive.rig.faults)
    ]
    return lines + [f"{truth}: {records:,} returns"] * bool(truth)


def _export_points(options: ExportOptions, drive: "SceneDrive", rays: RayTally) -> list[str]:
    """Write points and their ground truth, in the format that suffix or name say. Returns what to print."""
    from lidarcfg.clouds.cloud import row_bytes
    from lidarcfg.errors import LidarcfgError
    from lidarcfg.inputs import format_bytes, free_bytes
    from lidarcfg.io import formats
    from lidarcfg.io.drive_dataset import DriveDataset
    from lidarcfg.sensors.sensor import FIRING
    from lidarcfg.simulate.scans import most_returns, simulated_scans

    if options.split or options.truth:
        raise click.UsageError("--split and --truth are for a .pcap; points have their objects")
    if drive.rig.faults:
        raise click.UsageError("faults are of packets, for a .pcap; --faults none leaves them out")
    output = options.output
    form = formats.format_of("drive", output, options.name)
    if options.deskew and form.name not in formats.CLOUDS:
        raise click.UsageError(f"--deskew is for {', '.join(formats.CLOUDS)}")
    warnings = [
        f"{mount.name}: {mount.sensor.name} has no firing facts; all lasers fire together every {FIRING.step_deg:g} deg"
        for mount in drive.rig.mounts
        if not mount.sensor.fires
    ]
    most = most_returns(drive)
    free = free_bytes(output)

    def size(done: float) -> str:
        known = done >= KNOWN
        points = most * rays.fraction
        if form.name not in formats.CLOUDS:
            return f"about {points:,.0f} points" if known else f"at most {most:,} points"
        needed = row_bytes(output) * (points if known else most)
        if known and COPIES * needed > free:
            sizes = f"needs {format_bytes(COPIES * needed)} on the disk while it is written"
            raise LidarcfgError(f"{output}: {sizes}; {format_bytes(free)} are free; {LESS}")
        return f"{'about' if known else 'at most'} {format_bytes(needed)}"

    for text in [] if options.quiet else warnings:
        warn(text)
    warnings.clear()
    with _run(drive.duration_ns, size, rays, options.quiet) as run:
        dataset = DriveDataset(drive, simulated_scans(drive, run))
        found = formats.save_dataset(output, form, dataset, options.deskew, warnings.append)
        options.save_manifest(output, drive, rays.faulty)
    for text in [] if options.quiet else warnings:
        warn(text)
    return [f"{output}: {found}, {drive.duration_ns / SECOND_NS:g} s"]


def _warn_of_thin_beams(rig: "Rig") -> None:
    """Warn of sensors with two returns, whose beams have one echo."""
    thin = [one.name for one in rig.mounts if one.dual and not (one.realism and one.realism.divergence)]
    if thin:
        warn(f"{', '.join(thin)}: beams without divergence have one echo, so that both returns are the same")
