"""lidarcfg convert: rigs, clouds and captures to the formats of other tools, and other tools' rigs to ours."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.completion import complete_model
from lidarcfg.cli.options import FILE, quiet_option, warn

if TYPE_CHECKING:
    from lidarcfg.config.models import Vec3
    from lidarcfg.simulate.scene_drive import SceneDrive

ORIGIN_MAX_M = 1.0  # of a sensor's beams, from the base of its housing


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg convert out/sedan/rig.yaml -o out/sedan.urdf
      lidarcfg convert out/sedan.urdf -o out/again.yaml
      lidarcfg convert out/sedan.ply -o out/sedan.laz
      lidarcfg convert out/sedan.pcap --rig out/sedan/rig.yaml -o out/sedan.mcap
    """
)
@cloup.argument("source", metavar="INPUT", type=FILE, help="A rig, a kit, a bag, a cloud or a capture.")
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
@cloup.option(
    "--model",
    "models",
    multiple=True,
    metavar="[NAME=]MODEL",
    shell_complete=complete_model,
    help="For a kit, the model of its frame NAME, or of all frames whose model cannot be guessed: a name, a YAML file, "
    "or none. For a capture, the model, whatever the packets say. May be repeated.",
)
@cloup.option(
    "--origin",
    "origins",
    multiple=True,
    metavar="[NAME=]X,Y,Z",
    help="For a kit, where the beams start in the frame NAME, or in all frames of the base of a housing, in metres. "
    "May be repeated.",
)
@cloup.option(
    "--vehicle",
    type=FILE,
    help="The body that crop-box and azimuth-windows cut away: YAML, or a mesh.  [default: the rig's]",
)
@cloup.option("--scene", metavar="NAME", help="The scene of nuScenes' tables whose sensors are read.")
@quiet_option
def convert(
    source: Path,
    output: Path,
    name: str | None,
    rig: Path | None,
    truth: Path | None,
    models: tuple[str, ...],
    origins: tuple[str, ...],
    vehicle: Path | None,
    scene: str | None,
    quiet: bool,
) -> None:
    """Convert rigs, clouds and captures; import rigs.

    Another tool's kit of sensors becomes a rig. Anything that the format cannot hold is a warning on stderr. If the
    manifest of an exported capture is beside it, bags also hold the vehicle's poses and the boxes of objects.

    \b
    INPUT                 OUTPUT   FORMAT
    rig:                  .urdf    urdf          base_link, links, fixed joints
      .yaml .yml .json    .py      launch        ROS 2 static transforms
                          .json    carla         poses, attributes for CARLA
                          folder   nuscenes      a folder of two JSON tables
                          .yaml    crop-box      the body's box, for Autoware
                          .json    azimuth-windows  views that miss the body
    kit of sensors:       .yaml    rig           the LiDARs of the kit
      .urdf .xacro .xml                          URDF, after xacro
      .yaml .yml, folder                         Autoware's calibration files
      .json, folder                              nuScenes' tables, or carla's
      .txt, folder                               KITTI's calib
    bag:                  .yaml    rig           its /tf_static
      .bag .mcap .db3,    .pcap    pcap          the packets a driver recorded
      folder
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

    LAS, bags and MCAP need: pip install 'lidarcfg[convert]'
    """
    from lidarcfg.io import formats

    form = formats.choose_format(source, output, name)
    warnings: list[str] = []
    if vehicle and form.name not in formats.SELF_FILTERS:
        raise click.UsageError(f"--vehicle is for --to {' and --to '.join(formats.SELF_FILTERS)}")
    if form.name == formats.RIG:
        if rig or truth:
            raise click.UsageError("--rig and --truth are for captures")
        found = formats.import_rig(source, output, _by_name(models), _origins_m(origins), scene, warnings.append)
        _say(output, found, warnings, quiet)
        return
    if scene:
        raise click.UsageError("--scene is for nuScenes' tables, which become a rig")
    if origins:
        raise click.UsageError("--origin is for kits, which become a rig")
    model = _single(models)
    if form.name in formats.SELF_FILTERS and not (rig or truth or model):
        found = formats.save_self_filter(source, output, form.name, vehicle, warnings.append)
        _say(output, found, warnings, quiet)
        return
    if form.kind != "capture" and ((rig and form.kind != "bag") or model or truth):
        raise click.UsageError("--rig, --truth and --model are for captures")
    if rig and (truth or form.name in formats.FOLDERS):
        what = "--truth goes" if truth else f"{form.name} goes"
        raise click.UsageError(f"{what} by the manifest beside an exported capture, which names the rig; remove --rig")
    drive = None if rig or form.kind != "capture" else _drive(source, form.name, truth)
    if drive:
        from lidarcfg.io.drive_dataset import load_drive

        made = load_drive(source, drive, truth, model, warnings.append)
        found = str(formats.save_dataset(output, form, made, False, warnings.append))
    else:
        found = formats.convert(source, output, form, rig, model, warnings.append)
    _say(output, found, warnings, quiet)


def _say(output: Path, found: str, warnings: list[str], quiet: bool) -> None:
    if not quiet:
        for text in warnings:
            warn(text)
        click.echo(f"{output}: {found}")


def _by_name(models: tuple[str, ...]) -> dict[str, str]:
    """The models of a kit's frames by name; that without a name, under the empty one, is for all others."""
    found: dict[str, str] = {}
    for text in models:
        name, equals, model = text.rpartition("=")
        if name in found or not model or (equals and not name):
            raise click.BadParameter(f"{text!r} is not NAME=MODEL, once for each NAME", param_hint="--model")
        found[name] = model
    return found


def _origins_m(origins: tuple[str, ...]) -> "dict[str, Vec3]":
    """Where beams start, by the name of the frame; that without a name, under the empty one, is for all others."""
    found: dict[str, Vec3] = {}
    for text in origins:
        name, equals, values = text.rpartition("=")
        try:
            x, y, z = (float(value) for value in values.split(","))
        except ValueError:
            x = y = z = math.nan
        if name in found or (equals and not name) or not all(abs(value) <= ORIGIN_MAX_M for value in (x, y, z)):
            what = f"{text!r} is not NAME=X,Y,Z in metres, up to {ORIGIN_MAX_M:g}, once for each NAME"
            raise click.BadParameter(what, param_hint="--origin")
        found[name] = x, y, z
    return found


def _single(models: tuple[str, ...]) -> str | None:
    """The model of a capture's sensors."""
    if len(models) > 1:
        raise click.UsageError("--model is given once for a capture; a rig says which sensor is which")
    return models[0] if models else None


def _drive(capture: Path, name: str, truth: Path | None) -> "SceneDrive | None":
    """The drive that an export's manifest describes; None for a recording. Raises ConfigError where it is needed."""
    from lidarcfg.capture.manifest import load_manifest, manifest_path
    from lidarcfg.errors import ConfigError
    from lidarcfg.io.formats import FOLDERS

    beside = manifest_path(capture)
    if not beside.exists():
        if truth or name in FOLDERS:
            raise ConfigError(f"{beside}: the capture has no manifest; --truth and {', '.join(FOLDERS)} need it")
        return None
    if name in FOLDERS and not truth:
        raise click.UsageError(
            f"{name} needs the objects of points; give the --truth that export wrote with the capture"
        )
    whole = name in FOLDERS or truth is not None
    inputs = load_manifest(capture).inputs("export it again" if whole else "--rig takes the sensors' poses alone")
    if whole and not inputs.scene:
        raise ConfigError(f"{beside}: names no scene; export with the scene's file")
    return inputs.load()
