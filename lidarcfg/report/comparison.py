"""Rigs side by side in one study: a table of what differs, and one report."""

import string
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg import __version__
from lidarcfg.config.document import yaml_text
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.report import drawings
from lidarcfg.report.describe import (
    beams,
    counted,
    date,
    describe_limits,
    describe_object,
    describe_origin,
    describe_rig,
    region_rows,
    versions,
)
from lidarcfg.report.document import Baseline, Commands
from lidarcfg.report.evaluation import FAR, mounts_table
from lidarcfg.report.html import KeyFigure, render
from lidarcfg.report.inputs import ReportInputs
from lidarcfg.report.misses import describe_interval, percent
from lidarcfg.report.results import evaluation_dict, to_json
from lidarcfg.report.table import COUNT, Cell, Column, Row, Table, as_written, named
from lidarcfg.report.terminal import print_table
from lidarcfg.report.text import DRAWN, HEAD, truncate
from lidarcfg.report.verdict import FAIL, PASS, signed
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation
from lidarcfg.study.study import Study

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


def comparison_table(study: Study, rigs: Sequence[Contender]) -> Table:
    """A row for each figure, a column for each rig; the best of a row is marked, unless all are alike."""
    caption = (
        "The best of each row is marked, unless all are alike. Extrapolated values are marked if their error bar "
        "reaches the best one's."
    )
    return Table(caption, [Column(""), *(Column(rig.title, ".6f") for rig in rigs)], _rows(study, rigs))


def rigs_table(rigs: Sequence[Contender]) -> Table:
    """What is compared."""
    columns = [Column("rig"), Column("name"), Column("what it is"), Column("file")]
    rows = [[rig.letter, named(rig.rig.name), describe_rig(rig.rig), rig.file] for rig in rigs]
    return Table("The rigs", columns, rows)


def _marked(what: str, cells: Sequence[Cell], goodness: Sequence[float]) -> Row:
    """A row in which the best cells are marked; none if all are alike."""
    least, most = min(goodness), max(goodness)
    good = zip(cells, goodness, strict=True)
    return [what, *(replace(cell, mark="best") if least < most == value else cell for cell, value in good)]


def _row(what: str, form: str, values: Iterable[float], sign: int = 0) -> Row:
    """A row of numbers; `sign`: 1 if more is better, −1 if less is."""
    cells = [Cell(float(value), form=form) for value in values]
    return _marked(what, cells, [sign * as_written(cell.value, form) for cell in cells])


def _rows(study: Study, rigs: Sequence[Contender]) -> list[Row]:
    found = [rig.found for rig in rigs]
    coverage = [rig.details.coverage for rig in rigs]
    zones = zip(*(one.zones for one in found), strict=True)
    return [
        *_verdict_rows(found),
        *_misses_rows(found),
        _row("sensors", COUNT, (len(rig.rig.mounts) for rig in rigs)),
        _row("beams", COUNT, (beams(rig.rig) for rig in rigs)),
        _row("max VSR (m)", ".6f", (one.max_vsr_m for one in found), -1),
        *_extrapolated_rows(found),
        *(
            _row(f"max VSR in {truncate(ones[0].name, DRAWN)} (m)", ".6f", (one.max_vsr_m for one in ones), -1)
            for ones in zones
        ),
        *_robust_rows(found),
        _row("subspaces", COUNT, (len(one.subspaces) for one in found)),
        _row("volume of the worst (m³)", ".2f", (one.worst[0].volume_m3 for one in found), -1),
        _row("inner radius of the worst (m)", ".3f", (one.worst[0].inscribed_radius_m for one in found), -1),
        _row("largest inner radius of any (m)", ".3f", (rig.details.sphere_m for rig in rigs), -1),
        *(
            _row(f"detection of {truncate(name, DRAWN)}", ".4f", (one.detection[name].rate for one in found), 1)
            for name in (item.name for item in study.detection)
        ),
        *_post_rows(found),
        *(_sight_rows(found) if study.visibility else []),
        _row("beams across an upright pole, median", "g", (one.median_beams for one in coverage), 1),
        _row("positions with no beam", ".2%", (one.by_none for one in coverage), -1),
        _row("positions with one sensor's beams", ".2%", (one.by_one_sensor for one in coverage), -1),
    ]


def _verdict_rows(found: Sequence[Evaluation]) -> list[Row]:
    """Whether each requirement is met, and by how much; none without requirements."""
    verdicts = [one.verdict for one in found if one.verdict]
    if len(verdicts) < len(found):
        return []
    out = []
    for ones in zip(*(verdict.requirements for verdict in verdicts), strict=True):
        cells = [Cell(one.margin, f"{PASS if one.passed else FAIL} {signed(one.margin, one.unit)}") for one in ones]
        out.append(_marked(truncate(ones[0].name, DRAWN), cells, [one.relative_margin for one in ones]))
    return out


def _misses_rows(found: Sequence[Evaluation]) -> list[Row]:
    """What each rig misses, over all objects and by object; none where that is not known of all."""
    known = [one.misses for one in found if one.misses]
    if len(known) < len(found):
        return []
    by_object = zip(*(one.objects for one in known), strict=True)
    return [
        _row("misses", ".2%", (one.mean for one in known), -1),
        *(
            _row(f"misses of {truncate(ones[0].name, DRAWN)}", ".2%", (one.share for one in ones), -1)
            for ones in by_object
        ),
    ]


def _extrapolated_rows(found: Sequence[Evaluation]) -> list[Row]:
    """Every rig whose error bar reaches the best rig's is marked; none if one has no bar."""
    bars = [one.extrapolated for one in found if one.extrapolated]
    if len(bars) < len(found):
        return []
    least = min(bar.max_vsr_m for bar in bars)
    reach = min(bar.max_vsr_m + bar.error_m for bar in bars)
    marked = [bar.max_vsr_m == least or bar.max_vsr_m - bar.error_m <= reach for bar in bars]
    cells = [Cell(bar.max_vsr_m, f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f}") for bar in bars]
    return [_marked("max VSR, extrapolated (m)", cells, marked)]


def _robust_rows(found: Sequence[Evaluation]) -> list[Row]:
    """The worst effects of failures and mounting errors; none if they were omitted."""
    known = [one.robustness for one in found if one.robustness]
    if len(known) < len(found):
        return []
    worst = [one.worst for one in known if one.worst]
    rows = []
    if len(worst) == len(known):
        rows.append(_row("max VSR with the worst LiDAR lost (m)", ".6f", (one.max_vsr_m for one in worst), -1))
    for angles, far in zip((False, True), FAR, strict=True):
        growth_mm = (1e3 * one.largest_m(angles) for one in known)
        rows.append(_row(f"max VSR grows with a mount {far} off (mm)", ".1f", growth_mm, -1))
    return rows


def _post_rows(found: Sequence[Evaluation]) -> list[Row]:
    """Where posts are seen; none where that is not known of all."""
    if not all(one.posts for one in found):
        return []
    rows = []
    for ones in zip(*(one.posts for one in found), strict=True):
        what = f"post of {ones[0].height_m:g} m"
        first_m = (posts.first_seen_m[posts.known].max() for posts in ones)
        rows.append(_row(f"{what}, first seen at most (m)", ".2f", first_m, -1))
        rows.append(_row(f"{what}, longest gap (m)", ".2f", (np.nanmax(posts.longest_gap_m) for posts in ones), -1))
    return rows


def _sight_rows(found: Sequence[Evaluation]) -> list[Row]:
    """Volumes by the number of LiDARs that see them."""
    return [
        _row("shadow (m³)", ",.2f", (one.seen_by_m3[0] for one in found), -1),
        _row("volume seen by one LiDAR (m³)", ",.2f", (one.seen_by_m3[1] for one in found)),
        _row("volume seen by two or more (m³)", ",.2f", (one.seen_by_m3[2:].sum() for one in found), 1),
    ]


def print_comparison(study: Study, rigs: Sequence[Contender]) -> None:
    """Print a row for each property, a column for each rig; a star marks the best of a row."""
    print_table(rigs_table(rigs).without("what it is"))
    print_table(comparison_table(study, rigs))


def comparison_dict(study: Study, rigs: Sequence[Contender]) -> dict[str, Any]:
    """What `compare --json` prints and compare.json holds."""
    best = {
        what.text: [rig.letter for rig, cell in zip(rigs, cells, strict=True) if cell.mark == "best"]
        for what, *cells in comparison_table(study, rigs).cells
    }
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
    parts = [rigs[first : first + COLUMNS_MAX] for first in range(0, len(rigs), COLUMNS_MAX)]
    coverage = [(rig.title, rig.rig, rig.details.coverage) for rig in rigs]
    shown = drawings.least_detected([rig.found for rig in rigs])
    rings = [(name, {rig.title: rig.details.rings[name] for rig in rigs}) for name in shown]
    return render(
        "comparison.html",
        title=f"Comparison: {study.name}",
        about=f"{len(rigs)} rigs in the study {study.name}; compared by lidarcfg {__version__} on {date()}",
        summary=_summary(rigs),
        files=rigs_table(rigs),
        tables=comparison_table(study, rigs).parts(COLUMNS_MAX),
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
        lost=drawings.draw_lost([(rig.title, rig.found.robustness) for rig in rigs if rig.found.robustness]),
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
