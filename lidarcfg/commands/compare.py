"""lidarcfg compare: rigs side by side in one study."""

from pathlib import Path

import click

from lidarcfg.commands.options import FILE, Share, progress, quiet_option, typed


@click.command()
@click.argument("rigs", type=FILE, nargs=-1, metavar="RIG RIG...")
@click.option("--study", type=FILE, required=True, metavar="STUDY", help="Region and objects to judge them in.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
@click.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for compare.html and compare.json.")
@click.option("--tolerance", type=Share(1), help="Also the analytic max VSR, to this relative error.")
@quiet_option
def compare(
    rigs: tuple[Path, ...], study: Path, as_json: bool, output: Path | None, tolerance: float | None, quiet: bool
) -> None:
    """Judge each RIG in the region of STUDY, side by side: max VSR, worst subspaces, detection, coverage.

    The beams are the rigs'; region and objects are the study's, whose bounds are not enforced. From 2 to 10 rigs;
    one may stand twice. The best of each row is marked.

    \b
    Example:
      lidarcfg compare out/two/rig.yaml data/rigs/roof.yaml --study data/studies/sedan.yaml -o out/compared
    """
    from lidarcfg import report
    from lidarcfg.placement.study import evaluate, load_study
    from lidarcfg.rig import load_rig

    report.check_count(len(rigs))
    loaded, mounted = load_study(study), [load_rig(rig) for rig in rigs]
    if output:
        report.check_writable(output)
    named = []
    with progress(quiet or as_json) as on_share:
        for n, (path, rig) in enumerate(zip(rigs, mounted, strict=True)):
            on_share(n / len(rigs), str(path))
            named.append((str(path), rig, evaluate(loaded, rig, tolerance)))
    found = report.contenders(named)
    if output:
        report.save_comparison(loaded, found, output, report.Commands(typed(), typed()))
    if as_json:
        click.echo(report.to_json(report.comparison_dict(loaded, found)))
    elif not quiet:
        report.print_comparison(loaded, found)
        if output:
            click.echo(f"written to {output}/: compare.html compare.json")
