"""lidarcfg export, decode and replay: captures written, read and sent again."""

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.commands.options import (
    FILE,
    START,
    START_HELP,
    Factor,
    PositiveNumber,
    from_option,
    load_trajectory,
    model_option,
    nanoseconds,
    quiet_option,
    sensor_option,
    to_option,
    warn,
    warn_of,
)
from lidarcfg.commands.progress import progress
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lidarcfg.capture.pcap import Datagram
    from lidarcfg.capture.stream import SourceStats
    from lidarcfg.rig import ReturnMode, Rig
    from lidarcfg.simulate.simulator import Counts
    from lidarcfg.simulate.tasks import Drive, Run

    OnPath = Callable[[Path], None]


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg export out/two/rig.yaml --scene data/scenes/street.yaml \\
          --at=-30,-10,0 --duration 1 -o out/two.pcap
    """
)
@cloup.argument("rig", type=FILE, help="YAML: the sensors and their poses.")
@cloup.option_group(
    "Scene and motion",
    cloup.option("--scene", type=FILE, required=True, help="The scene's YAML."),
    cloup.option(
        "--at", default="0,0,0", metavar="X,Y,YAW_DEG", help="Pose of the vehicle in the scene.  [default: 0,0,0]"
    ),
    cloup.option("--trajectory", type=FILE, help="Motion from there: YAML, or timed poses as .tum."),
    cloup.option(
        "--vehicle",
        type=FILE,
        metavar="FILE|none",
        help="What travels along: YAML, or a mesh.  [default: the rig's]",
    ),
    cloup.option("--start", metavar="TIME", help=START_HELP),
    cloup.option(
        "--return-mode",
        type=click.Choice(["strongest", "last", "first", "dual", "first-last", "first-strongest", "two-strongest"]),
        metavar="MODE",
        help="Of every sensor: strongest, last, first or dual; of Hesai's also first-last, first-strongest and "
        "two-strongest.  [default: the rig's]",
    ),
    cloup.option("--duration", type=PositiveNumber(86_400), metavar="SECONDS", required=True, help="Simulated time."),
)
@cloup.option_group(
    "Output",
    cloup.option("-o", "--output", type=FILE, required=True, help="The file or folder to write; see above."),
    cloup.option("--to", "name", metavar="FORMAT", help="The format, where the suffix does not name it."),
    cloup.option("--split", is_flag=True, help="Write one file per sensor: NAME-SENSOR.pcap."),
    cloup.option("--truth", type=FILE, help="Write the ground truth of each return, as .npz: object, range, noise."),
    cloup.option("--deskew", is_flag=True, help="Points in the world frame; of .ply, .pcd and .npz."),
    cloup.option("--stats", is_flag=True, help="Print how many rays were traced and how many hit."),
    quiet_option,
)
def export(
    rig: Path,
    scene: Path,
    duration: float,
    output: Path,
    name: str | None,
    split: bool,
    at: str,
    start: str | None,
    return_mode: "ReturnMode | None",
    trajectory: Path | None,
    vehicle: Path | None,
    truth: Path | None,
    deskew: bool,
    stats: bool,
    quiet: bool,
) -> None:
    """Simulate what a rig's sensors send, or see, in a scene.

    A pcap holds their packets; other formats hold points with the ground truth. The vehicle stands, or moves along a
    trajectory. The same input gives the same bytes. A YAML file beside the output notes rig, scene and trajectory, so
    that `decode --deskew` and `view` need not be told again.

    \b
    OUTPUT      FORMAT
    .pcap       packets
    .ply .npz   one cloud, objects of points, boxes
    .pcd        the same without boxes
    .mcap       points, objects, boxes, /tf of ROS 2
    .bag        rosbag1: the same of ROS 1
    folder      rosbag2, rosbag2-mcap: of ROS 2
    folder      kitti-odometry, kitti-object,
                nuscenes: each needs --to
    """
    if not output.name:
        raise click.BadParameter(f"{str(output)!r} names neither a file nor a folder to write", param_hint="-o")
    with progress(quiet, keep=False) as on_fraction:
        on_fraction(0.0, f"reading {rig} and {scene}")
        from lidarcfg.capture.record import save_record
        from lidarcfg.rig import load_rig
        from lidarcfg.simulate.tasks import START_NS, Drive
        from lidarcfg.world.scene import load_scene
        from lidarcfg.world.vehicle import NONE, carried, check_outside

        mounted, world = _in_mode(load_rig(rig), return_mode), load_scene(scene)
        bodies = carried(mounted, vehicle)
        if bodies:
            check_outside(bodies, mounted.mounts, rig)
    warn_of(bodies)
    start_ns = nanoseconds(start) if start else START_NS
    moved = load_trajectory(trajectory, at, start_ns)
    drive = Drive(mounted, world, moved, bodies, start_ns, round(duration * SECOND_NS))
    total = [0, 0]
    files = {"rig": rig, "scene": scene, "trajectory": trajectory, "vehicle": vehicle if bodies else None}
    values = {"at": at, "start": start or START, "duration_s": duration, "return_mode": return_mode}
    values |= {"vehicle": NONE} if vehicle and not bodies else {}

    def record(path: Path) -> None:
        save_record(path, files, mounted, world, bodies, values)

    if output.suffix == ".pcap" and name is None:
        if deskew:
            raise click.UsageError("--deskew is for points; packets stay as a sensor sends them")
        lines = _export_packets(drive, output, split, truth, record, total, quiet)
    else:
        if split or truth:
            raise click.UsageError("--split and --truth are for a .pcap; points have their objects")
        lines = _export_points(drive, output, name, deskew, record, total, quiet)
    for line in [] if quiet else lines:
        click.echo(line)
    if stats:
        rays, hits = total
        click.echo(f"{rays:,} rays traced, of which {hits:,} ({hits / max(rays, 1):.1%}) hit something in range")


@contextmanager
def _run(duration_ns: int, total: list[int], quiet: bool) -> "Iterator[Run]":
    """How an export runs: with a progress bar, counting rays."""
    from lidarcfg.compiling import clock
    from lidarcfg.simulate.tasks import Run

    began = clock()

    def on_rays(counts: "Counts") -> None:
        total[:] = map(sum, zip(total, counts, strict=True))

    with progress(quiet) as on_fraction:

        def on_progress(done_ns: int) -> None:
            rate = done_ns / SECOND_NS / max(clock() - began, 1e-9)
            on_fraction(done_ns / duration_ns, f"{done_ns / SECOND_NS:.1f} s simulated, {rate:.1f}× real time")

        on_fraction(0.0, "simulating")
        yield Run(on_progress, on_rays)


def _export_packets(
    drive: "Drive", output: Path, split: bool, truth: Path | None, record: "OnPath", total: list[int], quiet: bool
) -> list[str]:
    """Write one pcap, or one of each sensor, and what readers need besides. Returns what to print."""
    from contextlib import ExitStack

    from lidarcfg.capture.pcap import write_pcap
    from lidarcfg.files import together
    from lidarcfg.simulate import export as capture
    from lidarcfg.simulate.ground_truth import TruthFile

    if truth and truth.suffix != ".npz":
        raise click.BadParameter(f"{str(truth)!r} does not end in .npz", param_hint="--truth")
    mounts = drive.rig.mounts
    names = [mount.name for mount in mounts]
    with _run(drive.duration_ns, total, quiet) as run, ExitStack() as stack:
        stack.enter_context(together())
        objects = capture.object_names(drive.scene, drive.vehicle)
        beside = stack.enter_context(TruthFile(truth, names, objects)) if truth else None
        streams = capture.export(
            drive.rig,
            drive.scene,
            drive.trajectory,
            drive.duration_ns,
            drive.start_ns,
            beside.add if beside else None,
            drive.vehicle,
            run,
        )
        if split:
            paths = [output.with_name(f"{output.stem}-{name}.pcap") for name in names]
            pairs = zip(paths, mounts, strict=True)
            companions = [one for path, mount in pairs for one in capture.save_companions(path, [mount])]
            counts = [write_pcap(path, stream) for path, stream in zip(paths, streams, strict=True)]
        else:
            companions = capture.save_companions(output, mounts)
            paths, counts = [output], [write_pcap(output, capture.in_time_order(streams))]
        records = beside.save() if beside else 0
        for path in paths:
            record(path)
    duration = f"{drive.duration_ns / SECOND_NS:g} s"
    lines = [f"{path}: {count:,} packets, {duration}" for path, count in zip(paths, counts, strict=True)]
    lines += [f"{path}: what readers of the capture need besides" for path in companions]
    return lines + [f"{truth}: {records:,} returns"] * bool(truth)


def _export_points(
    drive: "Drive", output: Path, name: str | None, deskew: bool, record: "OnPath", total: list[int], quiet: bool
) -> list[str]:
    """Write points and their ground truth, in the format that suffix or name say. Returns what to print."""
    from lidarcfg.files import together
    from lidarcfg.formats import formats
    from lidarcfg.formats.recording import Recording
    from lidarcfg.sensor import FIRING
    from lidarcfg.simulate.scans import simulated_scans

    form = formats.format_of("drive", output, name)
    if deskew and form.name not in formats.CLOUDS:
        raise click.UsageError(f"--deskew is for {', '.join(formats.CLOUDS)}")
    warnings = [
        f"{mount.name}: {mount.sensor.name} has no firing facts; all lasers fire at once, every {FIRING.step_deg:g} deg"
        for mount in drive.rig.mounts
        if not (mount.sensor.codec or mount.sensor.firing)
    ]
    with _run(drive.duration_ns, total, quiet) as run, together():
        recording = Recording(drive, simulated_scans(drive, run))
        found = formats.save_recording(output, form, recording, deskew, warnings.append)
        record(output)
    for text in [] if quiet else warnings:
        warn(text)
    return [f"{output}: {found}, {drive.duration_ns / SECOND_NS:g} s"]


def _in_mode(rig: "Rig", return_mode: "ReturnMode | None") -> "Rig":
    """The rig with the return mode of all of its sensors replaced."""
    if return_mode is None:
        return rig
    from dataclasses import replace

    mounts = tuple(replace(one, return_mode=return_mode) for one in rig.mounts)
    thin = [one.name for one in mounts if one.dual and not (one.realism and one.realism.divergence)]
    if thin:
        warn(f"{', '.join(thin)}: beams without divergence have one echo, so that both returns are the same")
    return replace(rig, mounts=mounts)


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg decode out/two.pcap --rig out/two/rig.yaml -o out/two.ply
    """
)
@cloup.argument("pcap", type=FILE, help="A capture, simulated or recorded.")
@cloup.option("-o", "--output", type=FILE, required=True, help="The .ply, .pcd or .npz to write.")
@cloup.option_group(
    "Sensors",
    cloup.option(
        "--rig",
        type=FILE,
        metavar="FILE|none",
        help="Merge by this rig's poses, or keep each sensor's own frame.  [default: as its export noted, or none]",
    ),
    model_option,
)
@cloup.option_group("Selection", from_option, to_option, sensor_option, help="Read only a part of the capture.")
@cloup.option_group(
    "Motion",
    cloup.option(
        "--deskew", is_flag=True, help="Deskew by what an export noted beside the pcap: rig, trajectory, start."
    ),
    cloup.option("--trajectory", type=FILE, help="Deskew by this motion of the vehicle; needs --rig."),
    cloup.option("--at", metavar="X,Y,YAW_DEG", help="Where the trajectory starts.  [default: 0,0,0]"),
    cloup.option("--start", metavar="TIME", help="When it starts; " + START_HELP),
)
@cloup.option(
    "--truth", type=FILE, metavar="NPZ", help="Also write each point's object, by export's --truth; needs --rig."
)
@cloup.option("--stats", is_flag=True, help="Print each sensor's model, return mode, speed and lost packets.")
@quiet_option
def decode(
    pcap: Path,
    rig: Path | None,
    model: str | None,
    deskew: bool,
    trajectory: Path | None,
    at: str | None,
    start: str | None,
    from_s: float,
    to_s: float,
    sensors: tuple[str, ...],
    output: Path,
    truth: Path | None,
    stats: bool,
    quiet: bool,
) -> None:
    """Decode a capture into a point cloud.

    Each point is in the vehicle frame of the moment it was measured; with --deskew or --trajectory, all points are in
    the world frame.
    """
    from dataclasses import replace

    from lidarcfg.capture.decode import decode_pcap
    from lidarcfg.capture.record import load_record, record_path, rig_file
    from lidarcfg.capture.selection import Selection
    from lidarcfg.cloud import concatenate, save_clouds
    from lidarcfg.rig import load_rig

    if deskew:
        record = load_record(pcap)
        trajectory = trajectory or record.path("trajectory", record_path(pcap))
        at, start = at or record.at, start or record.start
    rig = rig_file(pcap, rig)
    if deskew and not rig:
        raise click.UsageError("--deskew needs the rig, which says where the sensors are on the vehicle")
    if trajectory and not rig:
        raise click.UsageError("--trajectory needs --rig, which says where the sensors are on the vehicle")
    if truth and not rig:
        raise click.UsageError("--truth needs --rig, which says which sensor is which")
    if (at or start) and not (trajectory or deskew):
        raise click.UsageError("--at and --start say where and when a --trajectory starts")
    sources: list[SourceStats] = []
    selection = Selection(from_s, to_s, sensors)
    on_stats = sources.append if stats else None
    mounted = load_rig(rig) if rig else None
    clouds = decode_pcap(pcap, warn, mounted, model, on_stats=on_stats, selection=selection)
    if truth and mounted:
        from lidarcfg.capture.objects import with_objects

        clouds = iter([with_objects(truth, concatenate(list(clouds)), mounted)])
    if trajectory or deskew:
        from lidarcfg.simulate.export import START_NS

        moved = load_trajectory(trajectory, at or "0,0,0", nanoseconds(start) if start else START_NS)
        clouds = (replace(cloud, xyz=moved.world(cloud.xyz, cloud.time_ns)) for cloud in clouds)
    count = save_clouds(output, clouds)
    if not quiet:
        click.echo(f"{output}: {count:,} points")
    for source in sources:
        click.echo(
            f"{source.name}: {' or '.join(source.models)}, {' and '.join(source.return_modes)}, {source.rpm:.1f} rpm, "
            f"{source.packets:,} packets, {source.lost:,} lost, {source.duplicates:,} duplicates, "
            f"{source.reordered:,} out of order"
        )


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg replay out/two.pcap 127.0.0.1:2368
      lidarcfg replay out/two.pcap 127.0.0.1 --speed 2x --from 0.02 --to 0.08
    """
)
@cloup.argument("pcap", type=FILE, help="A capture.")
@cloup.argument("target", metavar="HOST[:PORT]", help="Where to. Without a port each datagram keeps its own.")
@cloup.option("--speed", type=Factor(10**6), metavar="FACTOR", default=1.0, help="Times real time.  [default: 1]")
@cloup.option("--loop", is_flag=True, help="Start over at the end, until Ctrl-C.")
@cloup.option_group("Selection", from_option, to_option, help="Send only a part of the capture.")
@quiet_option
def replay(pcap: Path, target: str, speed: float, loop: bool, from_s: float, to_s: float, quiet: bool) -> None:
    """Send a capture's datagrams to a host, to test a driver live.

    They keep the pace of the recording, times --speed."""
    from lidarcfg.capture.replay import looped, selected
    from lidarcfg.capture.replay import replay as send
    from lidarcfg.capture.selection import Selection

    host, _, port = target.partition(":")
    if ":" in target and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise click.BadParameter(f"{port!r} is not a port, 1 to 65535", param_hint="HOST[:PORT]")
    selection = Selection(from_s, to_s)

    def read() -> "Iterator[Datagram]":
        return selected(pcap, warn, selection)

    sent = send(looped(read) if loop else read(), host, int(port) if port else None, speed)
    if not quiet:
        late = f"at most {sent.latest_s * 1000:.1f} ms late"
        click.echo(f"{sent.packets:,} datagrams to {target} in {sent.seconds:.2f} s, {late}")
    if sent.interrupted and not loop:
        sys.exit(130)
