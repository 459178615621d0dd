"""lidarcfg view: captures and clouds to look at."""

from pathlib import Path

import click

from lidarcfg.commands.options import FILE, note, quiet_option


@click.command()
@click.argument("files", type=FILE, nargs=-1, required=True)
@click.option("--rig", type=FILE, help="The rig: merges a pcap by its poses and marks its sensors.")
@click.option("--model", help="What a pcap's sensors are, whatever their packets say.")
@click.option("--png", type=FILE, help="Draw a still; needs no screen.")
@click.option("--window", is_flag=True, help="Open Open3D's window.  [default, without --png]")
@quiet_option
def view(
    files: tuple[Path, ...], rig: Path | None, model: str | None, png: Path | None, window: bool, quiet: bool
) -> None:
    """Look at the merged points of captures (.pcap) and clouds (.ply, .pcd, .npz).

    \b
    Example:
      lidarcfg view out/two.pcap --rig out/two/rig.yaml --png out/two.png
    """
    from lidarcfg import view as viewer
    from lidarcfg.capture.decode import decode_pcap
    from lidarcfg.cloud import SUFFIXES, concatenate, load_cloud
    from lidarcfg.rig import load_rig

    mounted = load_rig(rig) if rig else None
    clouds = []
    for path in files:
        if path.suffix.lower() in SUFFIXES:
            clouds.append(load_cloud(path))
        else:
            clouds.extend(decode_pcap(path, note, mounted, model))
    merged = concatenate(clouds)
    if png:
        viewer.save_still(merged, png, mounted)
        if not quiet:
            click.echo(f"{png}: {len(merged.xyz):,} points")
    if window or not png:
        viewer.show_window(merged)
