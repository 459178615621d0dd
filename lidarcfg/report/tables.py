"""Results as tables on the terminal."""

from rich.console import Console

from lidarcfg.geometry import Array
from lidarcfg.report.describe import beams_alone, describe_places, describe_returns, has_cones
from lidarcfg.report.evaluation import mounts_table, robust_lines, worst_table, zones_table
from lidarcfg.report.terminal import print_facts, print_table, terminal
from lidarcfg.report.text import MANY, truncate
from lidarcfg.report.verdict import print_verdict
from lidarcfg.search.run import Placement
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation
from lidarcfg.study.extrapolation import Extrapolated
from lidarcfg.study.study import Study

FEW = 4  # of very many LiDARs: the volumes that fewer see are listed one by one


def print_placement(study: Study, found: Placement, evaluation: Evaluation) -> None:
    """Print the verdict, a summary of the search, then the rig and its evaluation."""
    if found.verdict:
        print_verdict(found.verdict)
    for line in found.remarks:
        terminal().print(line)
    _print_misses(study, found.rig, evaluation, found)
    search: list[tuple[str, str]] = []
    if study.only_required:
        search.append(("least margin", f"{found.objective:+.2%} of what is demanded"))
    elif not (study.is_max_vsr or study.is_misses):
        search.append(("objective", f"{found.objective:.6f}"))
    if has_cones(found.rig):
        search.append(("max VSR, midpoint of the bounds", f"{found.midpoint_max_vsr_m:.4f} m"))
        which = "optimised" if study.is_max_vsr else "this rig"
        search.append((f"max VSR, {which}", f"{evaluation.max_vsr_m:.4f} m"))
    first = f", and {found.first_evaluations:,} of plain rigs" if study.requirements else ""
    search.append(("evaluations", f"{found.evaluations:,}{first}"))
    search.append(("seconds", f"{found.seconds:.1f}"))
    print_facts(search)
    _print_rest(study, found.rig, evaluation)
    for line in found.at_bounds:
        terminal().print(line)


def print_evaluation(study: Study, rig: Rig, found: Evaluation) -> None:
    """Print the verdict, what is missed, the rig, its max VSR and detection rates, and the worst subspaces."""
    if found.verdict:
        print_verdict(found.verdict)
    _print_misses(study, rig, found)
    _print_rest(study, rig, found)


def _print_misses(study: Study, rig: Rig, found: Evaluation, placement: Placement | None = None) -> None:
    """What the rig misses, beside others; nothing where that is not known."""
    from lidarcfg.report.misses import describe_misses, misses_lines, misses_table, rigs_seen  # which loads drawings

    rigs = rigs_seen(study, rig, found, placement)
    if not rigs:
        return
    print_table(misses_table(rigs))
    console = terminal()
    for line in misses_lines(study, rigs, placement):
        console.print(line)
    console.print(f"misses: {describe_misses(rigs[0].misses)}; in brackets: the interval of 95 %")


def _print_rest(study: Study, rig: Rig, found: Evaluation) -> None:
    """The rig, its max VSR and detection rates, and the worst subspaces."""
    console = terminal()
    print_table(mounts_table(rig).without("model", "beams", "elevation"))
    cones = has_cones(rig)
    if cones:
        _print_max_vsr(console, rig, found)
    for item in study.detection:
        name = item.name
        detection = found.detection[name]
        how = describe_places(study, item, detection)
        whose = "the paper's " if found.misses and not item.returns else ""
        console.print(f"{whose}detection rate of {truncate(name)}: {detection.rate:.4f} ({how})")
        if detection.returns:
            console.print(f"  {describe_returns(detection.returns)}")
    if study.visibility:
        console.print(volumes_line(found.seen_by_m3))
    if cones:
        console.print("the worst subspaces:")
        print_table(worst_table(found).without("", "surface"))


def _print_max_vsr(console: Console, rig: Rig, found: Evaluation) -> None:
    alone = beams_alone(rig)
    console.print(f"max VSR {found.max_vsr_m:.6f} m in {len(found.subspaces):,} subspaces{', ' * bool(alone)}{alone}")
    if found.extrapolated:
        console.print(extrapolated_line(found.extrapolated))
    if found.zones:
        print_table(zones_table(found.zones))
    for line in robust_lines(found.robustness) if found.robustness else ():
        console.print(line)


def volumes_line(seen_by_m3: Array) -> str:
    """The volume by the number of LiDARs that see it (LiDARs + 1,)."""
    total = float(seen_by_m3.sum())
    volumes = {f"{n}": volume for n, volume in enumerate(seen_by_m3.tolist())}
    if len(volumes) > MANY + 1:
        volumes = dict(list(volumes.items())[:FEW]) | {f"{FEW} or more": float(seen_by_m3[FEW:].sum())}
    parts = [f"{n}: {volume:,.2f} m³ ({volume / total:.1%})" for n, volume in volumes.items()]
    return f"volume by the number of LiDARs that see it: {', '.join(parts)}"


def extrapolated_line(found: Extrapolated) -> str:
    """The max VSR for ever smaller cuboids, its error bar, and whether that is the tolerance asked for."""
    edges = " × ".join(f"{edge:g}" for edge in found.cuboid_m)
    reached = f"within the tolerance of {found.tolerance:.3g}" if found.tolerance < 1 else "by two halvings"
    if not found.reached:
        error = found.error_m / found.max_vsr_m
        reached = f"NOT within the tolerance of {found.tolerance:.3g}, but of {error:.2g}: no finer grid is tried"
    return (
        f"extrapolated to ever smaller cuboids {found.max_vsr_m:.6f} ± {found.error_m:.6f} m, {reached} "
        f"({found.cuboids:,} cuboids of {edges} m, {found.seconds:.2f} s)"
    )
