"""Pages in HTML, readable offline and in print: sections of texts, tables and drawings.

Every text is escaped unless it is Markup.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from lidarcfg.report.key_figures import KeyFigure
from lidarcfg.report.table import Table
from lidarcfg.report.text import printable

Part = Table | str | None  # a table, a paragraph or what the functions below make; None: nothing
FactRows = Sequence[tuple[str, object]]


@dataclass(frozen=True)
class PageSection:
    """A part of a page under a heading; `key` is its address."""

    key: str
    title: str
    parts: Iterable[Part]


def page(
    title: str,
    about: str,
    sections: Sequence[PageSection],
    summary: Sequence[KeyFigure] = (),
    notes: Sequence[Part] = (),
    verdict: Markup | None = None,
    is_head_a_page: bool = False,
) -> str:
    """The page: the verdict, the summary with notes below it, then the sections, in print on a new page if asked."""
    values = {"title": title, "about": about, "sections": sections, "summary": summary, "notes": notes}
    return _environment().get_template("page.html").render(values, verdict=verdict, is_head_a_page=is_head_a_page)


def fragment(parts: Iterable[Part]) -> Markup:
    """Parts without a page around them."""
    return _part("parts", parts)


def facts(rows: FactRows) -> Markup:
    """What each of some things is."""
    return _part("facts", rows)


def figure(drawing: Markup | None, caption: str) -> Markup | None:
    """A drawing with its caption; None without a drawing."""
    return None if drawing is None else _part("figure", drawing, caption)


def beside(table: Table | None, drawn: Markup | None) -> Markup:
    """A table with a figure to its right; without a table the figure alone."""
    return _part("beside", table, drawn)


def code(text: str) -> Markup:
    """A text as a file has it."""
    return _part("code", text)


def folded(title: str, *parts: Part) -> Markup:
    """Parts that are shown on a click."""
    return _part("folded", title, parts)


def bullets(lines: Sequence[str]) -> Markup | None:
    """A list; None if it is empty."""
    return _part("bullets", lines) if lines else None


def heading(text: str) -> Markup:
    """A heading inside a section."""
    return _part("heading", text)


def verdict_box(passed: bool, conclusion: str, table: Table, remarks: Sequence[str]) -> Markup:
    """A verdict at the top of a page."""
    return _part("verdict", passed, conclusion, (table, bullets(remarks)))


def _part(name: str, *values: Any) -> Markup:
    """What a macro of parts.html makes of the values."""
    return Markup(getattr(_environment().get_template("parts.html").module, name)(*values))


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
