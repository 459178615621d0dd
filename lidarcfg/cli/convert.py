"""lidarcfg convert: rigs, clouds and captures in the formats of other tools."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import FILE, load_trajectory, model_option, nanoseconds, quiet_option, warn

if TYPE_CHECKING:
    from lidarcfg.simulate.tasks import Drive


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg convert out/two/rig.yaml -o out/two.urdf
      lidarcfg convert out/two.ply -o out/two.laz
      lidarcfg convert out/two.pcap --rig out/two/rig.yaml -o out/two.mcap
      lidarcfg convert out/two.pcap -o out/two-firings.npz
    """
)
@cloup.argument("source", metavar="INPUT", type=FILE, help="A rig, a cloud or a capture.")
@cloup.option("-o", "--output", type=FILE, required=True, help="The file or folder to write; its suffix is the format.")
@cloup.option("--to", "name", metavar="FORMAT", help="The format, if the suffix does not name it.")
@cloup.option(
    "--rig", type=FILE, help="The rig that names and places a capture's sensors.  [default: from the export's manifest]"
)
@cloup.option(
    "--truth",
    type=FILE,
    metavar="NPZ",
    help="Also write each point's object, from the ground truth that export --truth wrote.",
)
@model_option
@quiet_option
def convert(
    source: Path, output: Path, name: str | None, rig: Path | None, truth: Path | None, model: str | None, quiet: bool
) -> None:
    """Convert a rig, a cloud or a capture for another tool.

    Anything that the format cannot hold is a warning on stderr. If the manifest of an exported capture is beside it,
    bags also hold the vehicle's poses and the boxes of objects.

    \b
    INPUT                 OUTPUT   FORMAT
    rig:                  .urdf    urdf          base_link, links, fixed joints
      .yaml .yml .json    .py      launch        ROS 2 static transforms
                          .json    carla         poses, attributes for CARLA
                          folder   nuscenes      a folder of two JSON tables
    cloud:                .ply .pcd .npz         every field and exact times
      .ply .pcd .npz      .las .laz              LAS 1.4: ring, sensor, return
      .las .laz .bin      .bin     kitti         x y z reflectance, float32
    capture:              folder   rosbag2       a PointCloud2 per scan (SQLite)
      .pcap .pcapng       folder   rosbag2-mcap  the same as MCAP; needs --to
                          .mcap    mcap          the same as one MCAP file
                          .bag     rosbag1       the same for ROS 1
                          folder   kitti-odometry  needs --truth of an export
                          folder   kitti-object  the same: labels, boxes
                          folder   nuscenes      the same: all tables
                          .npz     firings       all that each laser measured
    firings: .npz         .pcap    pcap          the capture again
                          .pcapng  pcapng        the same as pcapng

    LAS, bags and MCAP need: pip install 'lidarcfg[convert]'
    """
    from lidarcfg.io import formats

    form = formats.choose_format(source, output, name)
    if form.kind != "capture" and (rig or model or truth):
        raise click.UsageError("--rig, --truth and --model are for captures")
    if form.name == "firings" and (rig or truth):
        raise click.UsageError("--rig and --truth are not for firings, which are of each sensor alone")
    if rig and (truth or form.name in formats.FOLDERS):
        what = "--truth goes" if truth else f"{form.name} goes"
        raise click.UsageError(f"{what} by the manifest beside an exported capture, which names the rig; remove --rig")
    warnings: list[str] = []
    drive = None if rig or form.kind != "capture" or form.name == "firings" else _drive(source, form.name, truth)
    if drive:
        from lidarcfg.io.drive_dataset import load_drive

        made = load_drive(source, drive, truth, model, warnings.append)
        found = str(formats.save_dataset(output, form, made, False, warnings.append))
    else:
        found = formats.convert(source, output, form, rig, model, warnings.append)
    if not quiet:
        for text in warnings:
            warn(text)
        click.echo(f"{output}: {found}")


def _drive(capture: Path, name: str, truth: Path | None) -> "Drive | None":
    """The drive that an export's manifest describes; None for a recording. Raises ConfigError where it is needed."""
    from lidarcfg.capture.manifest import load_manifest, manifest_path
    from lidarcfg.errors import ConfigError
    from lidarcfg.io.formats import FOLDERS
    from lidarcfg.sensors.rig import load_rig
    from lidarcfg.simulate.tasks import Drive
    from lidarcfg.units import SECOND_NS
    from lidarcfg.world.scene import load_scene
    from lidarcfg.world.vehicle import resolve_vehicle

    beside = manifest_path(capture)
    if not beside.exists():
        if truth or name in FOLDERS:
            raise ConfigError(f"{beside}: the capture has no manifest; --truth and {', '.join(FOLDERS)} need it")
        return None
    if name in FOLDERS and not truth:
        raise click.UsageError(
            f"{name} needs the objects of points; give the --truth that export wrote with the capture"
        )
    manifest = load_manifest(capture)
    hint = "--rig takes the sensors' poses alone" if name not in FOLDERS and not truth else "export it again"
    rig = manifest.input_path("rig", hint)
    scene = manifest.input_path("scene", hint)
    trajectory = manifest.input_path("trajectory", hint)
    vehicle = manifest.input_path("vehicle", hint)
    assert rig
    if not scene:
        raise ConfigError(f"{beside}: names no scene; export with the scene's file")
    mounted = load_rig(rig)
    start_ns = nanoseconds(manifest.start)
    moved = load_trajectory(trajectory, manifest.at, start_ns)
    duration_ns = round(manifest.duration_s * SECOND_NS)
    return Drive(mounted, load_scene(scene), moved, resolve_vehicle(mounted, vehicle), start_ns, duration_ns)
