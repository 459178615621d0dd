"""Rigs side by side in one study: a table of what differs, and one report."""

import string
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidarcfg import __version__
from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError
from lidarcfg.files import loaded, replacing
from lidarcfg.notebook import Shown
from lidarcfg.report import drawings
from lidarcfg.report.describe import beams, counted, date, describe_object, describe_rig, region_rows
from lidarcfg.report.evaluation import mounts_table
from lidarcfg.report.inputs import ReportInputs, report_inputs
from lidarcfg.report.key_figures import KeyFigure, compared_rows, key_figures
from lidarcfg.report.misses import describe_interval, percent
from lidarcfg.report.page import PageSection, Part, facts, figure, heading, page
from lidarcfg.report.repeat import repeat_section
from lidarcfg.report.results import evaluation_dict, to_json
from lidarcfg.report.rig_report import Baseline, Commands, rings_figure
from lidarcfg.report.table import Column, Table, named
from lidarcfg.report.terminal import print_table
from lidarcfg.report.text import HEAD, truncate
from lidarcfg.requirements.verify import OnProgress, silent
from lidarcfg.sensors.rig import Rig, rigs_of
from lidarcfg.study.evaluation import Evaluation, evaluate
from lidarcfg.study.loading import load_study
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


@dataclass(frozen=True)
class Comparison(Shown):
    """Rigs side by side in a study."""

    study: Study
    rigs: tuple[Contender, ...]

    def __repr__(self) -> str:
        return f"<Comparison: {', '.join(f'{rig.letter} {rig.rig.name}' for rig in self.rigs)} in {self.study.name}>"

    @property
    def evaluations(self) -> dict[str, Evaluation]:
        """The evaluation of each rig, by its letter."""
        return {rig.letter: rig.found for rig in self.rigs}

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object: what compare.json holds."""
        return comparison_dict(self.study, self.rigs)


def compare(
    study: Study | Given,
    rigs: Sequence[Rig | Given],
    tolerance: float | None = None,
    on_progress: OnProgress = silent,
) -> Comparison:
    """Evaluate 2 to 10 rigs in a study, side by side.

    Study and rigs are files, dicts with their keys, or loaded. With a relative tolerance max VSR is extrapolated to it,
    too. `on_progress` is told the fraction done, and the rig that is evaluated. Raises ConfigError as `evaluate` does.
    """
    mounted = rigs_of(rigs)
    check_count(len(mounted))
    study = loaded(study, load_study, Study)
    named = []
    for n, (given, rig) in enumerate(zip(rigs, mounted, strict=True)):
        name = str(given) if isinstance(given, str | Path) else rig.name

        def on_evaluated(fraction: float, n: int = n, name: str = name) -> None:
            on_progress((n + fraction) / len(rigs), name)

        on_evaluated(0.0)
        found = evaluate(study, rig, tolerance, on_progress=on_evaluated)
        named.append((name, rig, report_inputs(study, rig, found, cheap_cuboids=0).without_cuboids()))
    return Comparison(study, tuple(contenders(named)))


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
    figures = [key_figures(study, rig.rig, rig.found, rig.details.coverage) for rig in rigs]
    return Table(caption, [Column(""), *(Column(rig.title, ".6f") for rig in rigs)], compared_rows(figures))


def rigs_table(rigs: Sequence[Contender]) -> Table:
    """What is compared."""
    columns = [Column("rig"), Column("name"), Column("what it is"), Column("file")]
    rows = [[rig.letter, named(rig.rig.name), describe_rig(rig.rig), rig.file] for rig in rigs]
    return Table("The rigs", columns, rows)


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
    return page(
        f"Comparison: {study.name}",
        f"{len(rigs)} rigs in the study {study.name}; compared by lidarcfg {__version__} on {date()}",
        [
            PageSection("table", "Side by side", _side_by_side(study, rigs)),
            PageSection("worst", "The worst subspaces", _worst(rigs)),
            PageSection("robust", "If a LiDAR fails", _robust(rigs)),
            PageSection("detection", "Detection", _detection(study, rigs)),
            PageSection("coverage", "Coverage", _coverage(study, rigs)),
            PageSection("rigs", "The rigs", _rigs(study, rigs)),
            repeat_section("comparison", {"The complete study, with defaults": study.file}, commands.typed),
        ],
        _summary(rigs),
    )


def _side_by_side(study: Study, rigs: Sequence[Contender]) -> Iterator[Part]:
    yield rigs_table(rigs)
    yield from comparison_table(study, rigs).parts(COLUMNS_MAX)


def _worst(rigs: Sequence[Contender]) -> Iterator[Part]:
    for first in range(0, len(rigs), COLUMNS_MAX):
        some = [(rig.title, rig.rig, rig.found) for rig in rigs[first : first + COLUMNS_MAX]]
        yield figure(
            drawings.compare_worst(f"worst{first}", some),
            "The five worst subspaces of each rig from top and side, numbered from the worst, which is filled. Dots: "
            "sensors. Grey: excluded. Heights are stretched.",
        )


def _robust(rigs: Sequence[Contender]) -> Iterator[Part]:
    lost = drawings.draw_lost([(rig.title, rig.found) for rig in rigs])
    yield figure(
        lost,
        "Max VSR of each whole rig, and of what is left without each of its LiDARs, in the order of the rig's file.",
    )
    if lost is None:
        yield "Not computed: no rig has two LiDARs, or the region has more than 1,000,000 cuboids."


def _detection(study: Study, rigs: Sequence[Contender]) -> Iterator[Part]:
    if study.detection:
        yield rings_figure(study, [(rig.title, rig.rig, rig.details) for rig in rigs])
        yield facts([(truncate(item.name), describe_object(item)) for item in study.detection])
    else:
        yield "The study names no objects, so detection was not evaluated."


def _coverage(study: Study, rigs: Sequence[Contender]) -> Iterator[Part]:
    limits = "" if study.visibility else " Range, occlusion and the vehicle's body are ignored."
    yield figure(
        drawings.compare_coverage(study.region, [(rig.title, rig.rig, rig.details.coverage) for rig in rigs]),
        f"The number of beams that cross an upright pole, by position, from above; one scale for all.{limits}",
    )


def _rigs(study: Study, rigs: Sequence[Contender]) -> Iterator[Part]:
    yield facts(region_rows(study.region))
    for rig in rigs:
        yield heading(rig.title)
        yield mounts_table(rig.rig)


def _summary(rigs: Sequence[Contender]) -> list[KeyFigure]:
    least_m = min(rig.found.max_vsr_m for rig in rigs)
    misses = [
        KeyFigure(Column(f"misses of {rig.title}"), percent(found.mean), describe_interval(found.interval))
        for rig in rigs
        if (found := rig.found.misses)
    ]
    max_vsr = []
    for rig in rigs:
        more = rig.found.max_vsr_m / least_m - 1
        detail = "the smallest" if more == 0 else f"{more:.1%} above the smallest"
        max_vsr.append(KeyFigure(Column(f"max VSR of {rig.title}", ".6f", "m"), rig.found.max_vsr_m, detail))
    return [*misses, *max_vsr]
