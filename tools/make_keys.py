#!/usr/bin/env python3
"""Write the tables of keys: of requirements in docs/requirements.md, of an objective in docs/optimise.md.

They are made from the kinds of requirements and the terms of an objective, and from what their keys say.

.venv/bin/python tools/make_keys.py          # writes them
.venv/bin/python tools/make_keys.py --check  # exits with 1 if they are out of date
"""

import sys
from pathlib import Path

from lidarcfg.placement.terms import TERMS
from lidarcfg.requirements.kinds import KINDS

DOCS = Path(__file__).parent.parent / "docs"
BEGIN = "<!-- by tools/make_keys.py -->\n"
END = "<!-- end -->\n"


def terms() -> str:
    """A row for each term."""
    rows = ["| term of the objective | unit | what it is |", "|---|---|---|"]
    rows += [f"| `{key}` | {term.unit} | {term.field[1].description} |" for key, term in TERMS.items()]
    return "\n".join(rows) + "\n"


def requirements() -> str:
    """A row for each kind, then one for each key; of kinds whose key is the same, once."""
    rows = ["| kind | keys; those before a semicolon must be given | what must hold |", "|---|---|---|"]
    keys: dict[tuple[str, str], list[str]] = {}  # the kinds that have a key, and what it says
    for key, kind in KINDS.items():
        fields = {name: field for name, field in kind.model_fields.items() if name != "name"}
        groups = [
            [f"`{name}`" for name, field in fields.items() if name != key and field.is_required() is required]
            for required in (True, False)
        ]
        says = (kind.__doc__ or "").partition("\n")[0].removesuffix(".")
        rows.append(f"| `{key}` | {'; '.join(', '.join(group) for group in groups if group)} | {says} |")
        for name, field in fields.items():
            keys.setdefault((name, field.description or ""), []).append(key)
    rows += ["", "| key | of | what it says |", "|---|---|---|"]
    for (name, says), kinds in keys.items():
        rows.append(f"| `{name}` | {', '.join(f'`{key}`' for key in kinds)} | {says} |")
    return "\n".join(rows) + "\n"


def main(words: list[str]) -> int:
    """Write the pages, or compare them."""
    outdated = False
    for name, tables in (("requirements.md", requirements()), ("optimise.md", terms())):
        page = DOCS / name
        text = page.read_text()
        before, _, rest = text.partition(BEGIN)
        made = before + BEGIN + tables + END + rest.partition(END)[2]
        outdated |= made != text
        if words != ["--check"]:
            page.write_text(made)
    return int(outdated and words == ["--check"])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
