"""lidarcfg convert: rigs, clouds and captures in the formats of other tools."""

from pathlib import Path

import click

from lidarcfg.commands.options import FILE, MODEL, quiet_option, warn


@click.command()
@click.argument("source", metavar="INPUT", type=FILE)
@click.option("-o", "--output", type=FILE, required=True, help="The file or folder to write; its suffix is the format.")
@click.option("--to", "name", metavar="FORMAT", help="The format, where the suffix does not say it.")
@click.option("--rig", type=FILE, help="A capture's rig: names its sensors and says where they are (/tf_static).")
@click.option("--model", type=MODEL, help="What a capture's sensors are, whatever their packets say.")
@quiet_option
def convert(source: Path, output: Path, name: str | None, rig: Path | None, model: str | None, quiet: bool) -> None:
    """Hand a rig, a cloud or a capture to the next tool, in that tool's own format.

    What a format cannot hold is said on stderr.

    \b
    INPUT                   OUTPUT    FORMAT
    rig:                    .urdf     urdf          base_link, a link and a fixed joint a sensor
      .yaml .yml .json      .py       launch        ROS 2 launch file of static transforms
                            .json     carla         places and attributes of CARLA's ray-cast LiDARs
                            a folder  nuscenes      sensor.json and calibrated_sensor.json
    cloud:                  .ply .pcd .npz          every field and exact times
      .ply .pcd .npz        .las .laz               LAS 1.4 with ring, sensor and return type
      .las .laz .bin        .bin      kitti         x y z reflectance, float32
    capture:                a folder  rosbag2       a PointCloud2 for each turn of each sensor (SQLite)
      .pcap .pcapng         a folder  rosbag2-mcap  the same, stored as MCAP; needs --to
                            .mcap     mcap          the same as one MCAP file

    \b
    LAS, bags and MCAP need: pip install 'lidarcfg[convert]'

    \b
    Example:
      lidarcfg convert out/two/rig.yaml -o out/two.urdf
      lidarcfg convert out/two.ply -o out/two.laz
      lidarcfg convert out/two.pcap --rig out/two/rig.yaml -o out/two.mcap
    """
    from lidarcfg.formats import formats

    form = formats.chosen(source, output, name)
    if form.kind != "capture" and (rig or model):
        raise click.UsageError("--rig and --model are for captures")
    warnings: list[str] = []
    found = formats.convert(source, output, form, rig, model, warnings.append)
    if not quiet:
        for text in warnings:
            warn(text)
        click.echo(f"{output}: {found}")
