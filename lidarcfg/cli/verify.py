"""lidarcfg verify: does a rig meet its requirements?"""

from pathlib import Path

import click
import cloup

from lidarcfg.cli.evaluate import check_rig
from lidarcfg.cli.options import FILE, command_line, json_option, quiet_option, warn, warn_of
from lidarcfg.cli.progress import progress

NOT_MET = 3  # the exit code if a requirement is not met


@cloup.command(
    epilog="""
    \b
    Example:
      lidarcfg verify data/studies/sedan-requirements.yaml \\
          data/rigs/roof.yaml --junit out/verdict.xml
    """
)
@cloup.argument("study", type=FILE, help="YAML: the requirements, and the vehicle.")
@cloup.argument("rig", type=FILE, help="YAML: the sensors and their poses.")
@cloup.option("-o", "--output", type=FILE, metavar="DIR", help="Folder for verdict.html and verdict.json.")
@cloup.option("--against", type=FILE, metavar="RIG", help="Say what is better and worse than with this rig.")
@cloup.option("--junit", type=FILE, metavar="FILE", help="Write the verdict as JUnit XML, for CI.")
@json_option
@quiet_option
@click.pass_context
def verify(
    context: click.Context,
    study: Path,
    rig: Path,
    output: Path | None,
    against: Path | None,
    junit: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Verify that a rig meets the study's requirements.

    Prints PASS or FAIL for each requirement, with its margin, the worst place, and the sensors lost there. Places are
    tried on a grid, more closely around the lowest counts, and in narrow shadows of the vehicle's bodies. Exits with 0
    if all requirements are met, else with 3.
    """
    with progress(quiet or as_json, keep=False) as on_progress:
        on_progress(0.0, f"reading {study}")
        from lidarcfg.errors import ConfigError
        from lidarcfg.files import replacing
        from lidarcfg.report.junit import junit as junit_text
        from lidarcfg.report.results import VERIFIED, check_writable, save_verdict, to_json
        from lidarcfg.report.verdict import print_verdict, verdict_dict
        from lidarcfg.requirements.verify import Verifier
        from lidarcfg.sensors.rig import load_rig
        from lidarcfg.study.checks import requirement_warnings
        from lidarcfg.study.loading import load_study

        loaded = load_study(study)
        if loaded.requirements is None:
            raise ConfigError(f"{study}: has no requirements; give some under requirements")
        paths = [rig, *([against] if against else [])]
        rigs = [load_rig(path) for path in paths]
    warn_of(loaded.vehicle)
    for message in requirement_warnings(study):
        warn(message)
    verifier = Verifier(loaded.requirements)
    for path, one in zip(paths, rigs, strict=True):
        check_rig(loaded, path, one)
        try:
            verifier.check(one.mounts)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
    if output:
        check_writable(output, VERIFIED)
    with progress(quiet or as_json, keep=False) as on_progress:
        verdicts = []
        for n, one in enumerate(rigs):

            def on_verified(fraction: float, name: str, n: int = n) -> None:
                on_progress((n + fraction) / len(rigs), f"verifying {name}")

            verdicts.append(verifier.verify(one.mounts, on_verified))
        beside = verdicts[1] if against else None
        values = verdict_dict(verdicts[0], beside, [str(path) for path in paths])
        if output:
            on_progress(1.0, f"writing {output}")
            shown = verifier.verification(rigs[0].mounts, verdicts[0])
            save_verdict(loaded, rigs[0], shown, values, output, command_line(), beside)
    if junit:
        with replacing(junit) as file:
            file.write(junit_text(verdicts[0], f"{study} {rig}"))
    if as_json:
        click.echo(to_json(values))
    elif not quiet:
        print_verdict(verdicts[0], beside)
        if output:
            click.echo(f"written to {output}/: {' '.join(reversed(VERIFIED))}")
    if not verdicts[0].passed:
        context.exit(NOT_MET)
