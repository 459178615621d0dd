"""Rigs side by side in one study: a table of what differs, and one report."""

import math
import string
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg import __version__
from lidarcfg.config.document import yaml_text
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.placement.evaluation import Evaluation
from lidarcfg.placement.report_inputs import ReportInputs
from lidarcfg.placement.study import Study
from lidarcfg.report import drawings
from lidarcfg.report.describe import (
    beams,
    counted,
    date,
    describe_limits,
    describe_object,
    describe_origin,
    describe_rig,
    mounts_table,
    region_rows,
    versions,
)
from lidarcfg.report.document import Baseline, Commands
from lidarcfg.report.html import BestCell, KeyFigure, Table, render
from lidarcfg.report.misses import describe_interval, percent
from lidarcfg.report.results import evaluation_dict, to_json
from lidarcfg.report.robustness import FAR, draw_lost
from lidarcfg.report.text import DRAWN, HEAD, truncate
from lidarcfg.report.verdict import FAIL, PASS, signed
from lidarcfg.sensors.rig import Rig

RIGS_MAX = 10
COMPARED = ("compare.json", "compare.html")  # the files of a comparison
COLUMNS_MAX = 4  # rigs in a row, so that a table fits a printed page


@dataclass(frozen=True)
class Contender:
    """A rig that is compared."""

    letter: str  # identifies it, even if the same rig is compared twice
    rig: Rig
    file: str
    details: ReportInputs

    @property
    def found(self) -> Evaluation:
        """Its evaluation."""
        return self.details.evaluation

    @property
    def title(self) -> str:
        """Its letter and name."""
        return f"{self.letter} {truncate(self.rig.name, HEAD)}"


@dataclass(frozen=True)
class ComparisonRow:
    """A line of the table."""

    what: str
    values: list[str]
    best: list[bool]  # none if all are equal, or if more is neither better nor worse


def check_count(rigs: int) -> None:
    """Raise ConfigError unless this many rigs can be compared."""
    if not 2 <= rigs <= RIGS_MAX:
        raise ConfigError(f"{counted(rigs, 'rig')} to compare; allowed: 2 to {RIGS_MAX}")


def contenders(named: Sequence[tuple[str, Rig, ReportInputs]]) -> list[Contender]:
    """The rigs as (file, rig, details), lettered in their order. Raises ConfigError unless there are 2 to 10."""
    check_count(len(named))
    return [
        Contender(letter, rig, file, details)
        for letter, (file, rig, details) in zip(string.ascii_uppercase, named, strict=False)
    ]


def with_baseline(rig: Rig, file: Path, details: ReportInputs, baseline: Baseline) -> list[Contender]:
    """A result and its baseline."""
    return contenders([(str(file), rig, details), (baseline.file, baseline.rig, baseline.details)])


def rows(study: Study, rigs: Sequence[Contender]) -> list[ComparisonRow]:
    """The rows of the comparison, rig by rig."""

    def row(what: str, form: str, value: Callable[[Contender], float], sign: int = 0) -> ComparisonRow:
        texts = [format(value(rig), form) for rig in rigs]
        values = [sign * float(text.rstrip("%").replace(",", "")) for text in texts]  # as printed
        best = [sign != 0 and min(values) < max(values) and v == max(values) for v in values]
        return ComparisonRow(what, texts, best)

    out = [
        *_verdict_rows(rigs),
        *_misses_rows(rigs, row),
        row("sensors", ",", lambda rig: len(rig.rig.mounts)),
        row("beams", ",", lambda rig: beams(rig.rig)),
        row("max VSR (m)", ".6f", lambda rig: rig.found.max_vsr_m, -1),
    ]
    if bars := _extrapolated_row(rigs):
        out.append(bars)
    for i, zone in enumerate(rigs[0].found.zones):
        out.append(row(f"max VSR in {truncate(zone.name, DRAWN)} (m)", ".6f", partial(_zone, i), -1))
    out += _robust_rows(rigs, row)
    out += [
        row("subspaces", ",", lambda rig: len(rig.found.subspaces)),
        row("volume of the worst (m³)", ".2f", lambda rig: rig.found.worst[0].volume_m3, -1),
        row("inner radius of the worst (m)", ".3f", lambda rig: rig.found.worst[0].inscribed_radius_m, -1),
        row("largest inner radius of any (m)", ".3f", lambda rig: rig.details.sphere_m, -1),
    ]
    for item in study.detection:
        out.append(row(f"detection of {truncate(item.name, DRAWN)}", ".4f", partial(_rate, item.name), 1))
    for i, posts in enumerate(rigs[0].found.posts if all(rig.found.posts for rig in rigs) else ()):
        what = f"post of {posts.height_m:g} m"
        out.append(row(f"{what}, first seen at most (m)", ".2f", partial(_first_seen, i), -1))
        out.append(row(f"{what}, longest gap (m)", ".2f", partial(_longest_gap, i), -1))
    out += _sight_rows(rigs, row) if study.visibility else []
    out += [
        row("beams across an upright pole, median", "g", lambda rig: rig.details.coverage.median_beams, 1),
        row("positions with no beam", ".2%", lambda rig: rig.details.coverage.by_none, -1),
        row("positions with one sensor's beams", ".2%", lambda rig: rig.details.coverage.by_one_sensor, -1),
    ]
    return out


def _verdict_rows(rigs: Sequence[Contender]) -> list[ComparisonRow]:
    """Whether each requirement is met, and by how much; none without requirements."""
    verdicts = [rig.found.verdict for rig in rigs if rig.found.verdict]
    if len(verdicts) < len(rigs):
        return []
    out = []
    for ones in zip(*(found.requirements for found in verdicts), strict=True):
        texts = [f"{PASS if one.passed else FAIL} {signed(one.margin, one.unit)}" for one in ones]
        margins = [one.relative_margin for one in ones]
        best = [min(margins) < max(margins) and margin == max(margins) for margin in margins]
        out.append(ComparisonRow(truncate(ones[0].name, DRAWN), texts, best))
    return out


def _misses_rows(rigs: Sequence[Contender], row: Callable[..., ComparisonRow]) -> list[ComparisonRow]:
    """What each rig misses, over all objects and by object; none where that is not known of all."""
    known = [rig.found.misses for rig in rigs if rig.found.misses]
    if len(known) < len(rigs):
        return []
    names = [truncate(one.name, DRAWN) for one in known[0].objects]
    return [
        row("misses", ".2%", lambda rig: rig.found.misses.mean, -1),
        *(row(f"misses of {name}", ".2%", partial(_missed, number), -1) for number, name in enumerate(names)),
    ]


def _missed(number: int, rig: Contender) -> float:
    return rig.found.misses.objects[number].share if rig.found.misses else math.nan


def _zone(i: int, rig: Contender) -> float:
    return rig.found.zones[i].max_vsr_m


def _robust_rows(rigs: Sequence[Contender], row: Callable[..., ComparisonRow]) -> list[ComparisonRow]:
    """The worst effects of failures and mounting errors; none if they were omitted."""
    known = [rig.found.robustness for rig in rigs]
    if None in known:
        return []
    out = []
    if all(found and found.worst for found in known):
        out.append(row("max VSR with the worst LiDAR lost (m)", ".6f", _worst_lost, -1))
    for angles, far in zip((False, True), FAR, strict=True):
        out.append(row(f"max VSR grows with a mount {far} off (mm)", ".1f", partial(_growth, angles), -1))
    return out


def _worst_lost(rig: Contender) -> float:
    found = rig.found.robustness
    return found.worst.max_vsr_m if found and found.worst else rig.found.max_vsr_m


def _growth(angles: bool, rig: Contender) -> float:
    return 1e3 * rig.found.robustness.largest_m(angles) if rig.found.robustness else 0.0


def _sight_rows(rigs: Sequence[Contender], row: Callable[..., ComparisonRow]) -> list[ComparisonRow]:
    """Volumes by the number of LiDARs that see them."""
    return [
        row("shadow (m³)", ",.2f", lambda rig: rig.found.seen_by_m3[0], -1),
        row("volume seen by one LiDAR (m³)", ",.2f", lambda rig: rig.found.seen_by_m3[1]),
        row("volume seen by two or more (m³)", ",.2f", lambda rig: rig.found.seen_by_m3[2:].sum(), 1),
    ]


def _first_seen(i: int, rig: Contender) -> float:
    posts = rig.found.posts[i]
    return float(posts.first_seen_m[posts.known].max())


def _longest_gap(i: int, rig: Contender) -> float:
    return float(np.nanmax(rig.found.posts[i].longest_gap_m))


def _rate(name: str, rig: Contender) -> float:
    return rig.found.detection[name].rate


def _extrapolated_row(rigs: Sequence[Contender]) -> ComparisonRow | None:
    """Every rig whose error bar reaches the best rig's is marked."""
    bars = [rig.found.extrapolated for rig in rigs if rig.found.extrapolated]
    if len(bars) < len(rigs):
        return None
    values = [bar.max_vsr_m for bar in bars]
    reach = min(bar.max_vsr_m + bar.error_m for bar in bars)
    marked = [bar.max_vsr_m == min(values) or bar.max_vsr_m - bar.error_m <= reach for bar in bars]
    texts = [f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f}" for bar in bars]
    return ComparisonRow("max VSR, extrapolated (m)", texts, [mark and not all(marked) for mark in marked])


def comparison_dict(study: Study, rigs: Sequence[Contender]) -> dict[str, Any]:
    """What `compare --json` prints and compare.json holds."""
    table = rows(study, rigs)
    best = {row.what: [rig.letter for rig, mark in zip(rigs, row.best, strict=True) if mark] for row in table}
    return {
        "version": __version__,
        "study": study.file,
        "best": {what: letters for what, letters in best.items() if letters},
        "rigs": [
            {
                "letter": rig.letter,
                "name": rig.rig.name,
                "file": rig.file,
                "sensors": len(rig.rig.mounts),
                "beams": beams(rig.rig),
                "inscribed_radius_m": rig.details.sphere_m,
                "median_beams": rig.details.coverage.median_beams,
                "places_without_beam": rig.details.coverage.by_none,
                "places_with_one_sensor": rig.details.coverage.by_one_sensor,
            }
            | {k: v for k, v in evaluation_dict(study, rig.rig, rig.found).items() if k not in ("study", "version")}
            for rig in rigs
        ],
    }


def save_comparison(study: Study, rigs: Sequence[Contender], folder: Path, commands: Commands) -> None:
    """Write compare.json and compare.html into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = to_json(comparison_dict(study, rigs)) + "\n", comparison(study, rigs, commands)
    for name, text in zip(COMPARED, texts, strict=True):
        with replacing(folder / name) as file:
            file.write(text)


def comparison(study: Study, rigs: Sequence[Contender], commands: Commands) -> str:
    """The report as HTML. Raises ConfigError if SOURCE_DATE_EPOCH is not a time."""
    lines = rows(study, rigs)
    parts = [rigs[first : first + COLUMNS_MAX] for first in range(0, len(rigs), COLUMNS_MAX)]
    coverage = [(rig.title, rig.rig, rig.details.coverage) for rig in rigs]
    shown = drawings.least_detected([rig.found for rig in rigs])
    rings = [(name, {rig.title: rig.details.rings[name] for rig in rigs}) for name in shown]
    return render(
        "comparison.html",
        title=f"Comparison: {study.name}",
        about=f"{len(rigs)} rigs in the study {study.name}; compared by lidarcfg {__version__} on {date()}",
        summary=_summary(rigs),
        files=Table(
            "The rigs",
            ("rig", "what it is", "file"),
            [[r.title, describe_rig(r.rig), r.file] for r in rigs],
            texts=(1, 2),
        ),
        tables=[_table(lines, rigs, first) for first in range(0, len(rigs), COLUMNS_MAX)],
        objects=[(truncate(item.name), describe_object(item)) for item in study.detection],
        region=region_rows(study.region),
        mounts=[(rig.title, mounts_table(rig.rig)) for rig in rigs],
        commands=commands,
        repeat=[("seed", "not needed"), ("versions", versions()), ("date", date())],
        study_yaml=yaml_text(study.file) if study.file else None,
        worst=[
            drawings.compare_worst(f"worst{n}", [(rig.title, rig.rig, rig.found) for rig in part])
            for n, part in enumerate(parts)
        ],
        lost=draw_lost([(rig.title, rig.found.robustness) for rig in rigs if rig.found.robustness]),
        sizes=drawings.draw_sizes([(rig.title, rig.details) for rig in rigs]),
        drawn_objects=len(study.detection) > len(shown) and len(shown),
        rings=drawings.draw_rings(rings) if rings else None,
        limits=describe_limits(study),
        origin=describe_origin(study),
        coverage=drawings.compare_coverage(study.region, coverage),
    )


def _summary(rigs: Sequence[Contender]) -> list[KeyFigure]:
    least = min(rig.found.max_vsr_m for rig in rigs)
    figures = []
    for rig in rigs:
        if found := rig.found.misses:
            what = f"Misses of {rig.title}"
            figures.append(KeyFigure(what, percent(found.mean), describe_interval(found.interval)))
    for rig in rigs:
        more = rig.found.max_vsr_m / least - 1
        detail = "the smallest" if more == 0 else f"{more:.1%} above the smallest"
        figures.append(KeyFigure(f"Max VSR of {rig.title}", f"{rig.found.max_vsr_m:.6f} m", detail))
    return figures


def _table(lines: Sequence[ComparisonRow], rigs: Sequence[Contender], first: int) -> Table:
    """The table of the rigs from the `first` on."""
    part = slice(first, first + COLUMNS_MAX)
    body = []
    for row in lines:
        pairs = zip(row.values[part], row.best[part], strict=True)
        body.append([row.what, *(BestCell(text) if best else text for text, best in pairs)])
    caption = (
        "The best of each row is marked, unless all are alike. Extrapolated values are marked if their error bar "
        "reaches the best one's."
    )
    return Table(caption, ("", *(rig.title for rig in rigs[part])), body)
