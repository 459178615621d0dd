"""Results as tables on the terminal."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from lidarcfg.geometry import Array
from lidarcfg.placement.evaluation import Evaluation
from lidarcfg.placement.extrapolation import Extrapolated
from lidarcfg.placement.search_run import Placement
from lidarcfg.placement.study import Study
from lidarcfg.placement.subspace import BLIND
from lidarcfg.report.describe import beams_alone, counted, describe_places, describe_returns, has_cones, price
from lidarcfg.report.robustness import robust_lines
from lidarcfg.report.text import MANY, summarize, terminal, truncate
from lidarcfg.report.verdict import print_verdict
from lidarcfg.sensors.rig import Rig

if TYPE_CHECKING:
    from lidarcfg.placement.front import Front  # which loads CMA-ES, and so matplotlib
    from lidarcfg.report.comparison import Contender

FEW = 4  # of very many LiDARs: the volumes that fewer see are listed one by one


def print_placement(study: Study, found: Placement, evaluation: Evaluation) -> None:
    """Print the verdict, a summary of the search, then the rig and its evaluation."""
    if found.verdict:
        print_verdict(found.verdict)
    for line in found.remarks:
        terminal().print(line)
    _print_misses(study, found.rig, evaluation, found)
    search = Table(box=SIMPLE, show_header=False)
    if study.only_required:
        search.add_row("least margin", f"{found.objective:+.2%} of what is demanded")
    elif not (study.is_max_vsr or study.is_misses):
        search.add_row("objective", f"{found.objective:.6f}")
    if has_cones(found.rig):
        search.add_row("max VSR, midpoint of the bounds", f"{found.midpoint_max_vsr_m:.4f} m")
        which = "optimised" if study.is_max_vsr else "this rig"
        search.add_row(f"max VSR, {which}", f"{evaluation.max_vsr_m:.4f} m")
    first = f", and {found.first_evaluations:,} of plain rigs" if study.requirements else ""
    search.add_row("evaluations", f"{found.evaluations:,}{first}")
    search.add_row("seconds", f"{found.seconds:.1f}")
    terminal().print(search)
    _print_rest(study, found.rig, evaluation)
    for line in found.at_bounds:
        terminal().print(line)


def print_front(study: Study, found: "Front") -> None:
    """Print a line for each rig on the front, and what the search spent."""
    objects = [item.name for item in study.detection]
    missed = all(point.placement.evaluation.misses for point in found.points)
    numbers = (
        "price",
        "objective",
        *["misses"] * missed,
        "max VSR (m)",
        *(f"detection of {truncate(name)}" for name in objects),
    )
    table = Table(
        *(Column(name, justify="right") for name in numbers), "sensors", Column("folder", overflow="fold"), box=SIMPLE
    )
    for point in found.points:
        evaluation = point.placement.evaluation
        table.add_row(
            price(point.combination.price),
            f"{point.placement.objective:.4f}",
            *([f"{evaluation.misses.mean:.4f}"] if missed and evaluation.misses else []),
            f"{evaluation.max_vsr_m:.4f}",
            *(f"{evaluation.detection[name].rate:.4f}" for name in objects),
            point.combination.sensors,
            f"points/{truncate(point.combination.name)}",
        )
    console = terminal()
    console.print(table)
    tried = sum(one.evaluations > 0 for one in found.candidates)
    all_of_them = counted(len(found.candidates), "combination")
    console.print(f"{counted(len(found.points), 'rig')} on the front; {tried} of {all_of_them} tried")
    console.print(
        f"{found.evaluations:,} evaluations, {found.dominated_evaluations:,} of them of combinations not on the front; "
        f"{found.seconds:.1f} s"
    )


def print_evaluation(study: Study, rig: Rig, found: Evaluation) -> None:
    """Print the verdict, what is missed, the rig, its max VSR and detection rates, and the worst subspaces."""
    if found.verdict:
        print_verdict(found.verdict)
    _print_misses(study, rig, found)
    _print_rest(study, rig, found)


def _print_misses(study: Study, rig: Rig, found: Evaluation, placement: Placement | None = None) -> None:
    """What the rig misses, beside others; nothing where that is not known."""
    from lidarcfg.report.misses import describe_misses, misses_lines, misses_rows, rigs_seen  # which loads drawings

    rigs = rigs_seen(study, rig, found, placement)
    if not rigs:
        return
    console = terminal()
    table = Table("misses", *(Column(one.title, justify="right") for one in rigs), box=SIMPLE)
    *rows, mean = misses_rows(rigs)
    for row in rows:
        table.add_row(*row)
    table.add_row(*mean, style="bold")
    console.print(table)
    for line in misses_lines(study, rigs, placement):
        console.print(line)
    console.print(f"misses: {describe_misses(rigs[0].misses)}; in brackets: the interval of 95 %")


def _print_rest(study: Study, rig: Rig, found: Evaluation) -> None:
    """The rig, its max VSR and detection rates, and the worst subspaces."""
    console = terminal()
    poses = Table("sensor", "x (m)", "y (m)", "z (m)", "roll (°)", "pitch (°)", "yaw (°)", box=SIMPLE)
    for mount in rig.mounts:
        angles = np.degrees(mount.rpy_rad)
        poses.add_row(truncate(mount.name), *(f"{v:z.3f}" for v in mount.position_m), *(f"{v:z.2f}" for v in angles))
    console.print(poses)
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
        _print_worst(console, found)


def _print_max_vsr(console: Console, rig: Rig, found: Evaluation) -> None:
    alone = beams_alone(rig)
    console.print(f"max VSR {found.max_vsr_m:.6f} m in {len(found.subspaces):,} subspaces{', ' * bool(alone)}{alone}")
    if found.extrapolated:
        console.print(extrapolated_line(found.extrapolated))
    for zone in found.zones:
        weighted = f"; {zone.weight * zone.max_vsr_m:.6f} m with its weight of {zone.weight:g}"
        console.print(f"max VSR in {truncate(zone.name)}: {zone.max_vsr_m:.6f} m{weighted}")
    for line in robust_lines(found.robustness) if found.robustness else ():
        console.print(line)


def _print_worst(console: Console, found: Evaluation) -> None:
    worst = Table(
        "VSR (m)", "volume (m³)", "inner radius (m)", "centroid (m)", "between the beams at (°), by sensor", box=SIMPLE
    )
    for space in found.worst:
        worst.add_row(
            f"{space.vsr_m:.4f}",
            f"{space.volume_m3:.2f}",
            f"{space.inscribed_radius_m:.3f}",
            ", ".join(f"{v:z.2f}" for v in space.centroid_m),
            "  ".join(summarize([_between(*one) for one in zip(space.gap, space.between_deg, strict=True)])),
        )
    console.print("the worst subspaces:")
    console.print(worst)


def print_comparison(study: Study, rigs: "Sequence[Contender]") -> None:
    """Print a row for each property, a column for each rig; a star marks the best of a row."""
    from lidarcfg.report.comparison import rows  # which loads what pages are made with

    names = Table("rig", "name", "file", box=SIMPLE)
    for rig in rigs:
        names.add_row(rig.letter, truncate(rig.rig.name), rig.file)
    lines = rows(study, rigs)
    console = terminal()
    console.print(names)
    cells = [
        [f"{value} *" if best else f"{value}  " for value, best in zip(row.values, row.best, strict=True)]
        for row in lines
    ]
    widest = max(len(cell) for line in cells for cell in line) + 3  # and the gap between columns
    fit = max((console.width - max(len(row.what) for row in lines) - 4) // widest, 1)
    for first in range(0, len(rigs), fit):
        part = slice(first, first + fit)
        side = Table("", *(Column(f"{rig.letter}  ", justify="right") for rig in rigs[part]), box=SIMPLE)
        for row, line in zip(lines, cells, strict=True):
            side.add_row(row.what, *line[part])
        console.print(side)
    console.print("* best of its row")


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


def _between(gap: int, between_deg: Sequence[float | None]) -> str:
    if gap == BLIND:
        return "blind"
    if all(angle is None for angle in between_deg):
        return "no cones"
    return "…".join("" if angle is None else f"{angle:g}" for angle in between_deg)
