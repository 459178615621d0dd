"""How to repeat a result: the last section of each page."""

from collections.abc import Iterator, Mapping
from typing import Any

from lidarcfg.config.document import yaml_text
from lidarcfg.report.describe import date, versions
from lidarcfg.report.page import Part, Section, code, facts, folded


def repeat_section(
    what: str,
    files: Mapping[str, Mapping[str, Any] | None],
    typed: str | None,
    again: str | None = None,
    seed: int | None = None,
    seconds: float | None = None,
) -> Section:
    """The commands that give a result (`what`), what it may depend on, and its files; None: made without a file.

    `typed`: the command; None: it was made from Python. `again`: one that gives the same on any machine.
    Raises ConfigError if SOURCE_DATE_EPOCH is not a time.
    """
    return Section("repeat", "How to repeat it", _parts(what, files, typed, again, seed, seconds))


def _parts(
    what: str,
    files: Mapping[str, Mapping[str, Any] | None],
    typed: str | None,
    again: str | None,
    seed: int | None,
    seconds: float | None,
) -> Iterator[Part]:
    if typed is None:
        yield "This page was written from Python; the files below are its complete input."
    else:
        yield "The command was:"
        yield code(typed)
    if again and again != typed:
        yield f"This one gives the same {what} on any machine and any number of threads:"
        yield code(again)
    yield facts(
        [
            ("seed", "not needed" if seed is None else seed),
            ("versions", versions()),
            *([] if seconds is None else [("seconds", f"{seconds:.2f}")]),
            ("date", date()),
        ]
    )
    yield from (folded(title, code(yaml_text(file))) for title, file in files.items() if file)
