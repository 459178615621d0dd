"""lidarcfg convert: rigs, clouds and captures in the formats of other tools."""

from pathlib import Path

import click
import cloup

from lidarcfg.commands.options import FILE, model_option, quiet_option, warn


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
@cloup.option("--to", "name", metavar="FORMAT", help="The format, where the suffix does not name it.")
@cloup.option("--rig", type=FILE, help="A capture's rig: its sensors' names and poses (/tf_static).")
@model_option
@quiet_option
def convert(source: Path, output: Path, name: str | None, rig: Path | None, model: str | None, quiet: bool) -> None:
    """Convert a rig, a cloud or a capture for another tool.

    What a format cannot hold is a warning on stderr.

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
                          .bag     rosbag1       the same of ROS 1
                          .npz     firings       all that each laser measured
    firings: .npz         .pcap    pcap          the capture of it again
                          .pcapng  pcapng        the same, of a pcapng

    LAS, bags and MCAP need: pip install 'lidarcfg[convert]'
    """
    from lidarcfg.formats import formats

    form = formats.chosen(source, output, name)
    if form.kind != "capture" and (rig or model):
        raise click.UsageError("--rig and --model are for captures")
    if form.name == "firings" and rig:
        raise click.UsageError("--rig is not for firings, which are of each sensor alone")
    warnings: list[str] = []
    found = formats.convert(source, output, form, rig, model, warnings.append)
    if not quiet:
        for text in warnings:
            warn(text)
        click.echo(f"{output}: {found}")
