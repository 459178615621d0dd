"""lidarcfg export, decode and replay: captures written, read and sent again."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lidarcfg.commands.options import (
    FILE,
    MODEL,
    START_HELP,
    Seconds,
    from_option,
    nanoseconds,
    progress,
    quiet_option,
    sensor_option,
    to_option,
    warn,
    way,
)
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.capture.stream import SourceStats
    from lidarcfg.simulate.simulator import Counts


@click.command()
@click.argument("rig", type=FILE)
@click.option("--scene", type=FILE, required=True, help="The scene's YAML.")
@click.option("--duration", type=Seconds(86_400), required=True, help="Seconds.")
@click.option("-o", "--output", type=FILE, required=True, help="The .pcap to write.")
@click.option("--split", is_flag=True, help="One file a sensor instead, FILE-NAME.pcap.")
@click.option("--at", default="0,0,0", metavar="X,Y,YAW_DEG", help="Where the vehicle stands in the scene.")
@click.option("--start", metavar="TIME", help=START_HELP)
@click.option("--trajectory", type=FILE, help="How the vehicle moves from there: .yaml, or timed poses as .tum.")
@click.option("--truth", type=FILE, help="Write object, exact range and noise of each return to this .npz.")
@click.option("--no-skip", is_flag=True, help="Cast every beam, also those that cannot meet anything.")
@click.option("--stats", is_flag=True, help="Say how many beams were fired and how many were cast.")
@quiet_option
def export(
    rig: Path,
    scene: Path,
    duration: float,
    output: Path,
    split: bool,
    at: str,
    start: str | None,
    trajectory: Path | None,
    truth: Path | None,
    no_skip: bool,
    stats: bool,
    quiet: bool,
) -> None:
    """Write what the sensors of RIG send while the vehicle stands or moves in a scene, as UDP in a pcap.

    The same input gives the same bytes.

    \b
    Example:
      lidarcfg export out/two/rig.yaml --scene data/scenes/street.yaml \\
          --at=-30,-10,0 --duration 1 -o out/two.pcap
    """
    import time
    from contextlib import ExitStack

    from lidarcfg.capture.pcap import write_pcap
    from lidarcfg.rig import load_rig
    from lidarcfg.simulate import export as capture
    from lidarcfg.simulate.ground_truth import TruthFile
    from lidarcfg.world.scene import load_scene

    for path, suffix, option in ((output, ".pcap", "-o"), (truth, ".npz", "--truth")):
        if path and path.suffix != suffix:
            raise click.BadParameter(f"{str(path)!r} does not end in {suffix}", param_hint=option)
    mounted, stage = load_rig(rig), load_scene(scene)
    duration_ns, began = round(duration * SECOND_NS), time.monotonic()
    counted = [0, 0, 0]

    def on_rays(counts: "Counts") -> None:
        counted[:] = map(sum, zip(counted, counts, strict=True))

    with progress(quiet) as on_share, ExitStack() as stack:

        def on_progress(done_ns: int) -> None:
            rate = done_ns / SECOND_NS / max(time.monotonic() - began, 1e-9)
            on_share(done_ns / duration_ns, f"{done_ns / SECOND_NS:.1f} s simulated, {rate:.1f}× real time")

        names = [mount.name for mount in mounted.mounts]
        beside = stack.enter_context(TruthFile(truth, names, stage.names)) if truth else None
        start_ns = nanoseconds(start) if start else capture.START_NS
        streams = capture.export(
            mounted,
            stage,
            way(trajectory, at, start_ns),
            duration_ns,
            start_ns,
            on_progress,
            on_truth=beside.add if beside else None,
            on_rays=on_rays,
            skip=not no_skip,
        )
        if split:
            paths = [output.with_name(f"{output.stem}-{name}.pcap") for name in names]
            counts = [write_pcap(path, stream) for path, stream in zip(paths, streams, strict=True)]
        else:
            paths, counts = [output], [write_pcap(output, capture.in_time_order(streams))]
        records = beside.save() if beside else 0
    if not quiet:
        for path, count in zip(paths, counts, strict=True):
            click.echo(f"{path}: {count:,} packets, {duration:g} s")
        if truth:
            click.echo(f"{truth}: {records:,} returns")
    if stats:
        rays, nothing, few = counted
        some = max(rays, 1)  # a narrow sector may fire none
        click.echo(
            f"{rays:,} rays: {nothing:,} ({nothing / some:.1%}) could meet nothing in range, "
            f"{few:,} ({few / some:.1%}) were settled by a few triangles, {rays - nothing - few:,} were cast"
        )


@click.command()
@click.argument("pcap", type=FILE)
@click.option("--rig", type=FILE, help="Merge by this rig's poses; without it each source keeps its own frame.")
@click.option("--model", type=MODEL, help="What the sensor is, whatever its packets say.")
@click.option("--trajectory", type=FILE, help="How the vehicle moved: takes the motion out; points are in the world.")
@click.option("--at", metavar="X,Y,YAW_DEG", help="Where the trajectory starts.  [default: 0,0,0]")
@click.option("--start", metavar="TIME", help="When the trajectory starts; " + START_HELP)
@from_option
@to_option
@sensor_option
@click.option("-o", "--output", type=FILE, required=True, help="The .ply, .pcd or .npz to write.")
@click.option("--stats", is_flag=True, help="Say of each source: model, return mode, rpm, lost packets.")
@quiet_option
def decode(
    pcap: Path,
    rig: Path | None,
    model: str | None,
    trajectory: Path | None,
    at: str | None,
    start: str | None,
    from_s: float,
    to_s: float,
    sensors: tuple[str, ...],
    output: Path,
    stats: bool,
    quiet: bool,
) -> None:
    """Read the LiDAR packets in PCAP, ours or a real recording, into a point cloud.

    Each sensor's points are where it saw them from as it was then; with --trajectory they are in one frame, the world.
    With --from, --to and --sensor only that part of the file is read.

    \b
    Example:
      lidarcfg decode out/two.pcap --rig out/two/rig.yaml -o out/two.ply
    """
    from dataclasses import replace

    from lidarcfg.capture.decode import decode_pcap
    from lidarcfg.capture.selection import Selection
    from lidarcfg.cloud import save_clouds
    from lidarcfg.rig import load_rig
    from lidarcfg.simulate.export import START_NS

    if trajectory and not rig:
        raise click.UsageError("--trajectory needs --rig, which says where the sensors are on the vehicle")
    if (at or start) and not trajectory:
        raise click.UsageError("--at and --start say where and when a --trajectory starts")
    seen: list[SourceStats] = []
    on_stats, selection = seen.append if stats else None, Selection(from_s, to_s, sensors)
    clouds = decode_pcap(pcap, warn, load_rig(rig) if rig else None, model, on_stats=on_stats, selection=selection)
    if trajectory:
        moved = way(trajectory, at or "0,0,0", nanoseconds(start) if start else START_NS)
        clouds = (replace(cloud, xyz=moved.world(cloud.xyz, cloud.time_ns)) for cloud in clouds)
    count = save_clouds(output, clouds)
    if not quiet:
        click.echo(f"{output}: {count:,} points")
    for source in seen:
        click.echo(
            f"{source.name}: {' or '.join(source.models)}, {' and '.join(source.return_modes)}, {source.rpm:.1f} rpm, "
            f"{source.packets:,} packets, {source.lost:,} lost, {source.duplicates:,} doubled, "
            f"{source.reordered:,} out of order"
        )


@click.command()
@click.argument("pcap", type=FILE)
@click.option("--to", "target", metavar="HOST[:PORT]", required=True, help="Without a port each keeps its own.")
@click.option("--speed", type=Seconds(1e6), default=1.0, show_default=True, help="Times real time.")
@quiet_option
def replay(pcap: Path, target: str, speed: float, quiet: bool) -> None:
    """Send the UDP datagrams in PCAP to a host at their own pace, so that a driver can be tested live.

    \b
    Example:
      lidarcfg replay out/two.pcap --to 127.0.0.1:2368
    """
    from lidarcfg.capture.pcap import read_datagrams
    from lidarcfg.capture.replay import replay as send

    host, _, port = target.partition(":")
    if ":" in target and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise click.BadParameter(f"{port!r} is not a port, 1 to 65535", param_hint="--to")
    sent = send(read_datagrams(pcap, warn), host, int(port) if port else None, speed)
    if not quiet:
        late = f"the latest {sent.latest_s * 1000:.1f} ms after its time"
        click.echo(f"{sent.packets:,} datagrams to {target} in {sent.seconds:.2f} s, {late}")
