"""What a notebook shows of studies, rigs and results: tables and maps of the report."""

from collections.abc import Iterator, Sequence
from functools import singledispatch

from markupsafe import Markup

from lidarcfg.report.comparison import Comparison, comparison_table
from lidarcfg.report.evaluation import bounds_table, mounts_table
from lidarcfg.report.misses import PLAIN, THIS, SeenBy, draw_misses, misses_table
from lidarcfg.report.page import Part, fragment
from lidarcfg.report.verdict import speeds_tables
from lidarcfg.report.verification import verdict_of
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.returns.misses import MissesFound
from lidarcfg.search.cheapest import Cheapest
from lidarcfg.search.run import Placement
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.evaluation import Evaluation
from lidarcfg.study.study import Study
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.vehicle import rig_vehicle

NOBODY = Rig("", ())


@singledispatch
def html(shown: object) -> str:
    """The HTML of a study, a rig or a result. Raises TypeError for what is none."""
    raise TypeError(f"a {type(shown).__name__} is not shown")


@html.register
def _(shown: Study) -> str:
    return fragment([bounds_table(shown)])


@html.register
def _(shown: Rig) -> str:
    return fragment([mounts_table(shown)])


@html.register
def _(shown: Verdict) -> str:
    return fragment([verdict_of(shown), *speeds_tables(shown)])


@html.register
def _(shown: MissesFound) -> str:
    return fragment(_misses([SeenBy(THIS, NOBODY, shown)], None))


@html.register
def _(shown: Evaluation) -> str:
    return fragment(_evaluation(shown, NOBODY))


@html.register
def _(shown: Placement) -> str:
    plain = shown.believed.plain if shown.believed else None
    beside = [SeenBy(PLAIN, plain.rig, plain.misses)] if plain else []
    return fragment([*_evaluation(shown.evaluation, shown.rig, beside), mounts_table(shown.rig)])


@html.register
def _(shown: Cheapest) -> str:
    return fragment([f"{shown.combination.name}, for {shown.combination.price:,.15g}", Markup(html(shown.placement))])


@html.register
def _(shown: Comparison) -> str:
    return fragment([comparison_table(shown.study, shown.rigs)])


def _evaluation(found: Evaluation, rig: Rig, beside: Sequence[SeenBy] = ()) -> Iterator[Part]:
    if found.verdict:
        yield verdict_of(found.verdict)
        yield from speeds_tables(found.verdict)
    if found.misses:
        vehicle = rig_vehicle(rig)
        yield from _misses([SeenBy(THIS, rig, found.misses), *beside], vehicle.footprint if vehicle else None)
    elif not found.verdict:
        yield f"max VSR {found.max_vsr_m:.4f} m"


def _misses(rigs: Sequence[SeenBy], body: Footprint | None) -> Iterator[Part]:
    yield misses_table(rigs)
    yield draw_misses(body, rigs)
