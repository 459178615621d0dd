"""Pages in HTML, readable offline and in print, and key figures. Every text is escaped unless it is Markup."""

from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from lidarcfg.report.text import printable


@dataclass(frozen=True)
class KeyFigure:
    """A key figure of the summary: what it is, its value, and one more detail."""

    what: str
    value: str
    detail: str


def render(template: str, **values: Any) -> str:
    """The document that a template makes of the values."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("lidarcfg.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=lambda value: value if isinstance(value, Markup) else printable(value),
    )


def with_baseline_figures(figures: list[KeyFigure], baseline: list[KeyFigure]) -> list[KeyFigure]:
    """The figures of a summary, each with the baseline's."""
    known = {figure.what: figure.value for figure in baseline}
    return [
        KeyFigure(figure.what, figure.value, f"{figure.detail}; the baseline: {known[figure.what]}")
        if figure.what in known
        else figure
        for figure in figures
    ]
