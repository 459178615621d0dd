#!/usr/bin/env python3
"""Write the tables of keys in docs/ from the kinds of requirements and faults, the terms and the solvers.

.venv/bin/python tools/make_keys.py          # writes them
.venv/bin/python tools/make_keys.py --check  # exits with 1 if they are out of date
"""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from lidarcfg.config.models import Model
from lidarcfg.requirements.file import KINDS
from lidarcfg.sensors.faults import KINDS as FAULTS
from lidarcfg.sensors.faults import Fault
from lidarcfg.solvers import SOLVERS, solver_of
from lidarcfg.solvers.solver import Solver
from lidarcfg.study.terms import TERMS

DOCS = Path(__file__).parent.parent / "docs"
END = "<!-- end -->\n"


def says(model: type[Model]) -> str:
    """What a model is."""
    return (model.__doc__ or "").partition("\n")[0].removesuffix(".")


def key_rows(models: Mapping[str, type[Model]], common: set[str]) -> list[str]:
    """A row for each key that is not common to all models; of those whose key is the same, once."""
    keys: dict[tuple[str, str], list[str]] = {}  # the models that have a key, and what it says
    for name, model in models.items():
        for key, field in model.model_fields.items():
            if key not in common:
                keys.setdefault((key, field.description or ""), []).append(name)
    rows = ["| key | of | what it says |", "|---|---|---|"]
    return rows + [f"| `{key}` | {', '.join(f'`{one}`' for one in of)} | {said} |" for (key, said), of in keys.items()]


def terms() -> list[str]:
    """A row for each term of an objective."""
    rows = ["| term of the objective | unit | what it is |", "|---|---|---|"]
    return rows + [f"| `{key}` | {term.unit} | {term.field[1].description} |" for key, term in TERMS.items()]


def requirements() -> list[str]:
    """A row for each kind, then one for each key."""
    rows = ["| kind | keys; those before a semicolon must be given | what must hold |", "|---|---|---|"]
    for key, kind in KINDS.items():
        fields = {name: field for name, field in kind.model_fields.items() if name not in ("name", key)}
        groups = [
            [f"`{name}`" for name, field in fields.items() if field.is_required() is required]
            for required in (True, False)
        ]
        rows.append(f"| `{key}` | {'; '.join(', '.join(group) for group in groups if group)} | {says(kind)} |")
    return [*rows, "", *key_rows(KINDS, {"name"})]


def solvers() -> list[str]:
    """A row for each solver, then one for each key that not all have."""
    models = {method: solver_of(method) for method in SOLVERS}
    rows = ["| `method` | what it is | without a budget |", "|---|---|---|"]
    for method, model in models.items():
        budget = ", ".join(f"{value:,} {key}" for key, value in model.default_budget.items())
        rows.append(f"| `{method}` | {says(model)} | {budget} |")
    return [*rows, "", *key_rows(models, {*Solver.model_fields})]


def faults() -> list[str]:
    """A row for each kind, then one for each key."""
    rows = ["| fault | keys; those before a semicolon must be given | what goes wrong |", "|---|---|---|"]
    for name, kind in FAULTS.items():
        fields = {key: field for key, field in kind.model_fields.items() if key not in Fault.model_fields}
        groups = [
            [f"`{key}`" for key, field in fields.items() if field.is_required() is required]
            for required in (True, False)
        ]
        given, rest = (", ".join(group) for group in groups)
        rows.append(f"| `{name}` | {'; '.join(filter(None, (given, rest))) or 'none'} | {says(kind)} |")
    return [*rows, "", *key_rows(FAULTS, {*Fault.model_fields})]


TABLES: dict[tuple[str, str], Callable[[], list[str]]] = {
    ("requirements.md", "kinds"): requirements,
    ("faults.md", "faults"): faults,
    ("optimise.md", "terms"): terms,
    ("optimise.md", "solvers"): solvers,
}


def main(words: list[str]) -> int:
    """Write the pages, or compare them."""
    outdated = False
    for (page, name), table in TABLES.items():
        text = (DOCS / page).read_text()
        begin = f"<!-- {name}, by tools/make_keys.py -->\n"
        before, _, rest = text.partition(begin)
        made = before + begin + "\n".join(table()) + "\n" + END + rest.partition(END)[2]
        outdated = outdated or made != text
        if words != ["--check"]:
            (DOCS / page).write_text(made)
    return int(words == ["--check"] and outdated)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
