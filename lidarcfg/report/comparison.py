"""Rigs side by side in one study: a table of what differs, and one page."""

import string
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lidarcfg import __version__
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.placement.coverage import Coverage, coverage
from lidarcfg.placement.metric import inscribed_radii_m
from lidarcfg.placement.study import Evaluation, Study
from lidarcfg.report import drawings
from lidarcfg.report.document import (
    Commands,
    as_yaml,
    beams,
    counted,
    date,
    mounts_table,
    object_in_words,
    rig_in_words,
    rings_by_object,
    vector,
    versions,
)
from lidarcfg.report.markup import (
    Cell,
    Html,
    Section,
    code,
    facts,
    figure,
    folded,
    heading,
    joined,
    page,
    paragraph,
    summary,
    table,
)
from lidarcfg.report.results import evaluation_dict, to_json
from lidarcfg.rig import Rig

RIGS_MAX = 10
COLUMNS_MAX = 4  # rigs beside each other in a table, so that it fits a printed page


@dataclass(frozen=True)
class Contender:
    """A rig that is compared."""

    letter: str  # names it apart, even if it stands twice
    rig: Rig
    file: str
    found: Evaluation
    coverage: Coverage
    sphere_m: float  # the radius of the largest sphere in any subspace

    @property
    def title(self) -> str:
        """Its letter and name."""
        return f"{self.letter} {self.rig.name}"


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    what: str
    values: list[str]
    best: list[bool]  # none where all are alike, or where more is neither better nor worse


def check_count(rigs: int) -> None:
    """Raise ConfigError unless so many rigs can stand side by side."""
    if not 2 <= rigs <= RIGS_MAX:
        raise ConfigError(f"{counted(rigs, 'rig')} to compare; allowed: 2 to {RIGS_MAX}")


def contenders(named: Sequence[tuple[str, Rig, Evaluation]]) -> list[Contender]:
    """The rigs as (file, rig, evaluation), lettered in their order. Raises ConfigError unless there are 2 to 10."""
    check_count(len(named))
    return [
        Contender(letter, rig, file, found, coverage(found.subspaces), float(inscribed_radii_m(found.subspaces).max()))
        for letter, (file, rig, found) in zip(string.ascii_uppercase, named, strict=False)
    ]


def rows(study: Study, rigs: Sequence[Contender]) -> list[Row]:
    """What is compared, rig by rig."""

    def row(what: str, form: str, value: Callable[[Contender], float], sign: int = 0) -> Row:
        texts = [format(value(rig), form) for rig in rigs]
        values = [sign * float(text.rstrip("%").replace(",", "")) for text in texts]  # as they are read
        best = [sign != 0 and min(values) < max(values) and v == max(values) for v in values]
        return Row(what, texts, best)

    out = [
        row("sensors", ",", lambda rig: len(rig.rig.mounts)),
        row("beams", ",", lambda rig: beams(rig.rig)),
        row("max VSR (m)", ".6f", lambda rig: rig.found.max_vsr_m, -1),
    ]
    bars = [rig.found.analytic for rig in rigs]
    if all(bars):
        values = [bar.max_vsr_m for bar in bars if bar]
        least = min((bar.max_vsr_m + bar.error_m for bar in bars if bar), default=0.0)
        alike = [bar.max_vsr_m - bar.error_m <= least for bar in bars if bar]
        texts = [f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f}" for bar in bars if bar]
        marked = [v == min(values) or a for v, a in zip(values, alike, strict=True)]
        out.append(Row("analytic max VSR (m)", texts, [m and not all(marked) for m in marked]))
    out += [
        row("subspaces", ",", lambda rig: len(rig.found.subspaces)),
        row("volume of the worst (m³)", ".2f", lambda rig: rig.found.worst[0].volume_m3, -1),
        row("inner radius of the worst (m)", ".3f", lambda rig: rig.found.worst[0].inscribed_radius_m, -1),
        row("largest inner radius of any (m)", ".3f", lambda rig: rig.sphere_m, -1),
    ]
    for item in study.detection:
        out.append(row(f"detection of {item.name}", ".4f", partial(_rate, item.name), 1))
    out += [
        row("beams across a pole, median", "g", lambda rig: rig.coverage.median_beams, 1),
        row("places with no beam", ".2%", lambda rig: rig.coverage.by_none, -1),
        row("places with one sensor's beams", ".2%", lambda rig: rig.coverage.by_one_sensor, -1),
    ]
    return out


def _rate(name: str, rig: Contender) -> float:
    return rig.found.detection[name].rate


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
                "inscribed_radius_m": rig.sphere_m,
                "median_beams": rig.coverage.median_beams,
                "places_without_beam": rig.coverage.by_none,
                "places_with_one_sensor": rig.coverage.by_one_sensor,
            }
            | {k: v for k, v in evaluation_dict(study, rig.rig, rig.found).items() if k not in ("study", "version")}
            for rig in rigs
        ],
    }


def save_comparison(study: Study, rigs: Sequence[Contender], folder: Path, commands: Commands) -> None:
    """Write compare.json and compare.html into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {
        "compare.json": to_json(comparison_dict(study, rigs)) + "\n",
        "compare.html": comparison(study, rigs, commands),
    }
    for name, text in files.items():
        with replacing(folder / name) as file:
            file.write(text)


def comparison(study: Study, rigs: Sequence[Contender], commands: Commands) -> str:
    """The page. Raises ConfigError where SOURCE_DATE_EPOCH is no time."""
    sections = [
        Section("table", "Side by side", _table(study, rigs)),
        Section("worst", "The worst subspaces", _worst(rigs)),
        Section("sizes", "How large the subspaces are", _sizes(rigs)),
        Section("detection", "What is detected", _detection(study, rigs)),
        Section("coverage", "Coverage", _coverage(rigs)),
        Section("rigs", "The rigs", _rigs(study, rigs)),
        Section("repeat", "How to repeat it", _repeat(study, commands)),
    ]
    about = f"{len(rigs)} rigs in the study {study.name}, compared by lidarcfg {__version__} on {date()}"
    return page(f"Rigs compared: {study.name}", about, _summary(rigs), sections)


def _summary(rigs: Sequence[Contender]) -> Html:
    least = min(rig.found.max_vsr_m for rig in rigs)
    items: list[tuple[object, object, object]] = []
    for rig in rigs:
        more = rig.found.max_vsr_m / least - 1
        word = "the least" if more == 0 else f"{more:.1%} more than the least"
        items.append((f"Max VSR of {rig.title}", f"{rig.found.max_vsr_m:.6f} m", word))
    return summary(items)


def _table(study: Study, rigs: Sequence[Contender]) -> Html:
    files = [[rig.title, rig_in_words(rig.rig), rig.file] for rig in rigs]
    lines = rows(study, rigs)
    parts = [table("What was compared", ("rig", "what it is", "file"), files, texts=(1, 2))]
    for first in range(0, len(rigs), COLUMNS_MAX):
        part = slice(first, first + COLUMNS_MAX)
        body = [
            [
                row.what,
                *(Cell(text) if best else text for text, best in zip(row.values[part], row.best[part], strict=True)),
            ]
            for row in lines
        ]
        parts.append(
            table(
                "The best of each row is marked, unless all are alike. Analytic values are marked if their error bar "
                "reaches the best one's.",
                ("", *(rig.title for rig in rigs[part])),
                body,
            )
        )
    if not study.detection:
        parts.append(paragraph("The study names no objects, so nothing is said of detection."))
    return joined(*parts)


def _worst(rigs: Sequence[Contender]) -> Html:
    caption = (
        "The five worst subspaces of each rig in place, from top and side, numbered from the worst, which is filled. "
        "Dots are the sensors, grey is left out. Heights are stretched."
    )
    parts = [rigs[first : first + COLUMNS_MAX] for first in range(0, len(rigs), COLUMNS_MAX)]
    return joined(
        *(
            figure(drawings.compare_worst(f"worst{n}", [(rig.title, rig.rig, rig.found) for rig in part]), caption)
            for n, part in enumerate(parts)
        )
    )


def _sizes(rigs: Sequence[Contender]) -> Html:
    caption = (
        "Above, how many subspaces have which VSR; below, what share of the region's volume they hold. Ticks at the "
        "foot mark the worst ones of each rig."
    )
    return figure(drawings.draw_distribution([(rig.title, rig.found) for rig in rigs]), caption)


def _detection(study: Study, rigs: Sequence[Contender]) -> Html:
    if not study.detection:
        return paragraph("The study names no objects, so nothing is said of what is detected.")
    rings = [(rig.title, rings_by_object(study, rig.found)) for rig in rigs]
    panels = [(item.name, [(name, by_object[item.name]) for name, by_object in rings]) for item in study.detection]
    return joined(
        figure(
            drawings.draw_rings(panels),
            "Detection rate of each object by its distance from the vehicle, which is in the middle of the sensors' "
            "bounds; a line for each rig.",
        ),
        facts([(item.name, object_in_words(item)) for item in study.detection]),
    )


def _coverage(rigs: Sequence[Contender]) -> Html:
    caption = (
        "How many beams cross an upright pole, by place, from above; one scale for all. Range, occlusion and the "
        "vehicle's body are ignored."
    )
    return figure(drawings.compare_coverage([(rig.title, rig.rig, rig.found) for rig in rigs]), caption)


def _rigs(study: Study, rigs: Sequence[Contender]) -> Html:
    region = study.region
    where = facts(
        [
            ("region", f"from {vector(region.min_m)} to {vector(region.max_m)} m"),
            ("cuboids", f"{' × '.join(map(str, region.shape))} of {' × '.join(f'{e:g}' for e in region.cuboid_m)} m"),
        ]
    )
    return joined(where, *(part for rig in rigs for part in (heading(rig.title), mounts_table(rig.rig))))


def _repeat(study: Study, commands: Commands) -> Html:
    parts = [paragraph("This was typed:"), code(commands.typed)]
    parts.append(facts([("seed", "none is needed"), ("versions", versions()), ("date", date())]))
    if study.file:
        parts.append(folded("The study in full, with its defaults filled in", code(as_yaml(study.file))))
    return joined(*parts)
