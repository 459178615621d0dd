#!/usr/bin/env python3
"""Write the tables of keys in docs/requirements.md from the kinds of requirements and what their keys say.

.venv/bin/python tools/make_keys.py          # writes them
.venv/bin/python tools/make_keys.py --check  # exits with 1 if they are out of date
"""

import sys
from pathlib import Path

from lidarcfg.requirements.kinds import KINDS

PAGE = Path(__file__).parent.parent / "docs" / "requirements.md"
BEGIN = "<!-- by tools/make_keys.py -->\n"
END = "<!-- end -->\n"


def tables() -> str:
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
    """Write the page, or compare it."""
    text = PAGE.read_text()
    before, _, rest = text.partition(BEGIN)
    made = before + BEGIN + tables() + END + rest.partition(END)[2]
    if words == ["--check"]:
        return int(made != text)
    PAGE.write_text(made)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
