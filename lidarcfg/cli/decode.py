"""lidarcfg decode: a capture as a point cloud."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import (
    FILE,
    START_HELP,
    StartPose,
    StartTime,
    from_option,
    model_option,
    quiet_option,
    sensor_option,
    sidecar_option,
    to_option,
    warn,
)

if TYPE_CHECKING:
    from lidarcfg.capture.stream import SourceStats


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg decode out/sedan.pcap --rig out/sedan/rig.yaml -o out/sedan.ply
    """
)
@cloup.argument("pcap", type=FILE, help="A capture, simulated or recorded; or a bag of packets.")
@cloup.option("-o", "--output", type=FILE, required=True, help="The .ply, .pcd or .npz to write.")
@cloup.option_group(
    "Sensors",
    cloup.option(
        "--rig",
        type=FILE,
        metavar="FILE|none",
        help="Merge the sensors by this rig's poses, or (none) keep each sensor's own frame.  [default: the rig in the "
        "export's manifest, or none]",
    ),
    model_option,
    sidecar_option,
)
@cloup.option_group("Selection", from_option, to_option, sensor_option, help="Read only a part of the capture.")
@cloup.option_group(
    "Motion",
    cloup.option(
        "--deskew", is_flag=True, help="Deskew by the export's manifest beside the pcap: rig, trajectory, start."
    ),
    cloup.option("--trajectory", type=FILE, help="Deskew by this motion of the vehicle; needs --rig."),
    cloup.option(
        "--at", type=StartPose(), metavar="X,Y,YAW_DEG", help="Where the trajectory starts.  [default: 0,0,0]"
    ),
    cloup.option("--start", type=StartTime(), metavar="TIME", help="When the trajectory starts; " + START_HELP),
)
@cloup.option(
    "--truth",
    type=FILE,
    metavar="NPZ",
    help="Also write each point's object, from the ground truth that export --truth wrote; needs --rig.",
)
@cloup.option(
    "--driver-view",
    is_flag=True,
    help="Angles and times as the maker's driver computes them: Hesai's SDK with its firing time file, rs_driver.",
)
@cloup.option("--stats", is_flag=True, help="Print each sensor's model, return mode, speed and lost packets.")
@quiet_option
def decode(
    pcap: Path,
    rig: Path | None,
    model: str | None,
    sidecars: tuple[Path, ...],
    deskew: bool,
    trajectory: Path | None,
    at: str | None,
    start: str | None,
    from_s: float,
    to_s: float,
    sensors: tuple[str, ...],
    output: Path,
    truth: Path | None,
    driver_view: bool,
    stats: bool,
    quiet: bool,
) -> None:
    """Decode a capture into a point cloud.

    Each point is in the vehicle frame of the moment it was measured; with --deskew or --trajectory, all points are in
    the world frame.
    """
    from contextlib import ExitStack
    from dataclasses import replace

    from lidarcfg.capture.decode import decode_pcap
    from lidarcfg.capture.manifest import DriveInputs, load_manifest, rig_file
    from lidarcfg.capture.selection import Selection
    from lidarcfg.clouds.cloud import concatenate, save_clouds
    from lidarcfg.io.bag_reader import is_bag
    from lidarcfg.sensors.rig import load_rig

    if deskew:
        manifest = load_manifest(pcap)
        trajectory = trajectory or manifest.input_path("trajectory")
        at = at or manifest.at
        start = start or manifest.start
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
    with ExitStack() as stack:
        if is_bag(pcap):
            from lidarcfg.io.packet_bag import packets_of

            pcap = stack.enter_context(packets_of(pcap, mounted, warn))
        clouds = decode_pcap(
            pcap,
            warn,
            mounted,
            model,
            on_stats=on_stats,
            selection=selection,
            driver_view=driver_view,
            sidecars=sidecars,
        )
        if truth and mounted:
            from lidarcfg.capture.ground_truth import with_objects

            clouds = iter([with_objects(truth, concatenate(list(clouds)), mounted)])
        if trajectory or deskew:
            moved = DriveInputs(trajectory=trajectory, at=at, start=start).motion()
            clouds = (replace(cloud, xyz=moved.world(cloud.xyz, cloud.time_ns)) for cloud in clouds)
        count = save_clouds(output, clouds)
    if not quiet:
        click.echo(f"{output}: {count:,} points")
    for source in sources:
        click.echo(_stats_line(source))


def _stats_line(source: "SourceStats") -> str:
    speed = f"{source.rpm:.1f} rpm" if source.rpm > 0 else "speed not known"  # of a single packet it is not a number
    return (
        f"{source.name}: {' or '.join(source.models)}, {' and '.join(source.return_modes)}, {speed}, "
        f"{source.packets:,} packets, {source.lost:,} lost, {source.duplicates:,} duplicates, "
        f"{source.reordered:,} out of order"
    )
