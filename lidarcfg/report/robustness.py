"""Failures, mounting errors and zones in a report."""

from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

from markupsafe import Markup

from lidarcfg.placement.evaluation import OFFSETS, STEP_DEG, STEP_M, DegradedRig, Robustness
from lidarcfg.placement.study import Study
from lidarcfg.placement.study_file import COORDINATES
from lidarcfg.placement.zones import ZoneVsr
from lidarcfg.report.canvas import colour, drawing, label
from lidarcfg.report.html import Table
from lidarcfg.report.text import truncate
from lidarcfg.sensors.rig import Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEGEND_ROW = 0.12  # of the height of bars
WHOLE = "none"
UNITS = f"{100 * STEP_M:g} cm", f"{STEP_DEG:g}°"
FAR = f"{100 * STEP_M * OFFSETS[-1]:g} cm", f"{STEP_DEG * OFFSETS[-1]:g}°"
SENSITIVITY = (
    f"How max VSR changes when one coordinate of one mount is off: mm per {UNITS[0]} or {UNITS[1]}, fitted up to "
    f"{FAR[0]} or {FAR[1]}. In brackets: the largest increase within that range (mm)."
)


def zones_table(zones: Sequence[ZoneVsr]) -> Table:
    """Max VSR of each zone."""
    rows = [
        [truncate(zone.name), f"{zone.weight:g}", f"{zone.max_vsr_m:.6f}", f"{zone.weight * zone.max_vsr_m:.6f}"]
        for zone in zones
    ]
    return Table("Max VSR by zone", ("zone", "weight", "max VSR (m)", "weighted (m)"), rows)


def lost_table(found: Robustness, study: Study) -> Table:
    """Max VSR with each LiDAR lost, in all and by zone, and the study's objective if it is another."""
    with_objective = bool(study.zones) or not study.objective.is_max_vsr

    def row(left: DegradedRig) -> list[str]:
        more = left.max_vsr_m / found.whole.max_vsr_m - 1
        values = [f"{left.max_vsr_m:.6f}", f"{more:+.1%}" if left.lost is not None else ""]
        values += [f"{zone.max_vsr_m:.6f}" for zone in left.zones]
        return [truncate(left.lost or WHOLE), *values, *([f"{left.objective:.6f}"] if with_objective else [])]

    zones = [f"in {truncate(zone.name)} (m)" for zone in found.whole.zones]
    head = ("LiDAR that fails", "max VSR (m)", "change", *zones, *(["objective"] if with_objective else []))
    return Table("What is left if one LiDAR fails", head, [row(left) for left in (found.whole, *found.without)])


def sensitivity_table(rig: Rig, found: Robustness) -> Table:
    """How max VSR changes with each coordinate of each mount."""
    rows = []
    for mount, slopes, largest in zip(rig.mounts, 1e3 * found.slope_m, 1e3 * found.increase_m, strict=True):
        pairs = zip(slopes.tolist(), largest.tolist(), strict=True)
        rows.append(
            [truncate(mount.name), *(f"{slope:+.2f} ({most:.1f})" if slope or most else "0" for slope, most in pairs)]
        )
    head = [f"{name} (per {UNITS[axis > 2]})" for axis, name in enumerate(COORDINATES)]
    return Table(SENSITIVITY, ("mount", *head), rows)


def lost_view(axes: "Axes", titled: Sequence[tuple[str, Robustness]]) -> None:
    """Bars of max VSR for the whole rig and with each LiDAR lost; one of each group for each title."""
    most = max(len(found.without) for _, found in titled)
    width = 0.8 / len(titled)
    names = [[left.lost or "" for left in found.without] for _, found in titled]
    alike = [dict.fromkeys(label(name, 14) for name in of if name) for of in zip_longest(*names, fillvalue="")]
    for i, (title, found) in enumerate(titled):
        values = [left.max_vsr_m for left in (found.whole, *found.without)]
        at = [n + (i - (len(titled) - 1) / 2) * width for n in range(len(values))]
        axes.bar(at, values, 0.92 * width, color=colour(i), label=label(title))
    axes.set_xticks(range(most + 1), ["whole rig", *("without\n" + " / ".join(of) for of in alike)])
    axes.set(xlim=(-0.6, most + 0.6), ylabel="max VSR (m)")
    axes.grid(True, axis="y")
    axes.set_axisbelow(True)
    if len(titled) > 1:
        axes.legend(ncols=2, loc="upper left")
        axes.set_ylim(0, axes.get_ylim()[1] * (1 + LEGEND_ROW * -(-len(titled) // 2)))  # above the bars


def draw_lost(titled: Sequence[tuple[str, Robustness]]) -> Markup | None:
    """Max VSR with each LiDAR lost; None where no rig has two."""
    if not any(found.without for _, found in titled):
        return None

    def draw(figure: "Figure") -> None:
        lost_view(figure.subplots(), titled)

    return drawing("lost", 2.8, "max VSR of the whole rig, and with each LiDAR lost", draw)


def robust_lines(found: Robustness) -> list[str]:
    """The worst LiDAR to lose and the most sensitive axes, in words."""
    lines = []
    if worst := found.worst:
        more = worst.max_vsr_m / found.whole.max_vsr_m - 1
        name = truncate(worst.lost or WHOLE)
        lines.append(f"max VSR if {name} fails, the worst to lose: {worst.max_vsr_m:.6f} m ({more:+.1%})")
    growth = [1e3 * found.largest_m(angles) for angles in (False, True)]
    off = [f"{most:.1f} mm if it is off by {step}" for most, step in zip(growth, FAR, strict=True)]
    lines.append(f"max VSR grows with one coordinate of one mount by at most {', '.join(off)}")
    return lines
