#!/usr/bin/env python3
"""Draw the packages by what they import, and list them: a picture and a table of docs/architecture.md.

.venv/bin/python tools/make_architecture.py          # writes both
.venv/bin/python tools/make_architecture.py --check  # exits with 1 if they are out of date
"""

import ast
import re
import sys
import textwrap
from collections.abc import Iterator, Mapping
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "lidarcfg"
PAGE = ROOT / "docs/architecture.md"
PICTURE = ROOT / "docs/pictures/architecture.svg"
BEGIN, END = "<!-- packages, by tools/make_architecture.py -->\n", "<!-- end -->\n"

# Where a package stands, in boxes from the middle, and the wing that it is of.
PLACES = {
    "cli": (0.0, "shared"),
    "viewer": (-0.55, "shared"),
    "io": (1.1, "captures"),
    "report": (-0.55, "placement"),
    "search": (-1.1, "placement"),
    "capture": (1.1, "captures"),
    "study": (-1.1, "placement"),
    "solvers": (-2.2, "placement"),
    "vsr": (-1.1, "placement"),
    "requirements": (0.0, "placement"),
    "returns": (-0.55, "placement"),
    "simulate": (1.1, "captures"),
    "packets": (0.0, "shared"),
    "world": (0.0, "shared"),
    "sensors": (0.0, "shared"),
    "config": (-1.1, "shared"),
    "core": (0.0, "C++"),
    "clouds": (1.1, "shared"),
}
WINGS = {  # fill and outline
    "placement": ("#e4eefa", "#2c6fbb"),
    "captures": ("#e2f3e9", "#1f8a5b"),
    "shared": ("#f1f1f1", "#6b6b6b"),
    "C++": ("#ffeccc", "#c27a00"),
}
BOX = 212, 62
STEP = 222, 100  # from one column, and from one row, to the next
MARGIN = 24
CHARACTERS = 33  # in a line of a box
FONT = "font-family='DejaVu Sans, Verdana, sans-serif'"


def packages() -> dict[str, str]:
    """What each package is for, in import order from the ground up; the modules beside them are no packages."""
    said = ast.get_docstring(ast.parse((PACKAGE / "__init__.py").read_text())) or ""
    found = {"core": "the hot loops, in C++"}
    found |= dict(re.findall(r"^    (\w+) +(.*)$", said, re.MULTILINE))
    assert found.keys() == {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    return found


def ground() -> list[str]:
    """The modules beside the packages, which all may import."""
    return [path.stem for path in sorted(PACKAGE.glob("*.py")) if not path.stem.startswith("__")]


def imports(names: Mapping[str, str]) -> dict[str, set[str]]:
    """The packages that each package imports, inside functions and for types too."""
    found = {}
    for name in names:
        imported = {other for path in (PACKAGE / name).rglob("*.py") for other in _imported(path)}
        found[name] = imported & {*names} - {name}
    return found


def _imported(path: Path) -> Iterator[str]:
    """The packages and modules of ours that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{one.name}" for one in node.names]
        yield from (name.split(".")[1] for name in names if name.startswith("lidarcfg."))


def reduced(below: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The imports that do not follow from others."""
    reach: dict[str, set[str]] = {}
    for name in TopologicalSorter(below).static_order():
        reach[name] = below[name].union(*(reach[other] for other in below[name]))
    return {
        name: {one for one in others if not any(one in reach[other] for other in others)}
        for name, others in below.items()
    }


def rows(below: Mapping[str, set[str]]) -> dict[str, int]:
    """How many imports, at most, lead from the top to each package."""
    row = dict.fromkeys(below, 0)
    for name in reversed([*TopologicalSorter(below).static_order()]):
        for other in below[name]:
            row[other] = max(row[other], row[name] + 1)
    return row


def picture(said: Mapping[str, str], below: Mapping[str, set[str]]) -> str:
    """The drawing as SVG: an arrow from each package to those that it imports, unless others lead there, too."""
    assert PLACES.keys() == said.keys(), f"PLACES: {', '.join(sorted(PLACES.keys() ^ said.keys()))}"
    row = rows(below)
    middle = {name: (column * STEP[0], row[name] * STEP[1]) for name, (column, _) in PLACES.items()}
    left, right = (side(x for x, _ in middle.values()) for side in (min, max))
    under = max(y for _, y in middle.values()) + BOX[1]
    x, y = left - BOX[0] / 2 - MARGIN, -BOX[1] / 2 - MARGIN
    width, height = right + BOX[0] / 2 + MARGIN - x, under + MARGIN - y
    parts = [
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='{x:g} {y:g} {width:g} {height:g}' width='{width:g}' {FONT}>",
        "<title>The packages of lidarcfg; an arrow leads from a package to one that it imports</title>",
        "<defs><marker id='head' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='8' markerHeight='8' orient='auto'>"
        "<path d='M0 0.8 L8 4 L0 7.2 z' fill='#7a7a7a'/></marker></defs>",
        f"<rect x='{x:g}' y='{y:g}' width='{width:g}' height='{height:g}' rx='12' fill='#ffffff'/>",
    ]
    for name, others in reduced(below).items():
        parts += [_arrow(middle[name], middle[other]) for other in sorted(others)]
    parts += [_box(*at, name, said[name], *WINGS[PLACES[name][1]]) for name, at in middle.items()]
    for number, (wing, colours) in enumerate(WINGS.items()):
        parts.append(_key(left - BOX[0] / 2, -12 + 24 * number, wing, *colours))
    beside = f"all may import the modules beside them: {', '.join(ground())}"
    parts.append(_text((left + right) / 2, under, 13, "#555555", beside))
    return "\n".join([*parts, "</svg>", ""])


def _text(x: float, y: float, size: float, colour: str, what: str, more: str = "text-anchor='middle'") -> str:
    return f"<text x='{x:g}' y='{y:g}' font-size='{size:g}' fill='{colour}' {more}>{what}</text>"


def _key(x: float, y: float, wing: str, fill: str, outline: str) -> str:
    """What a colour means."""
    box = f"<rect x='{x:g}' y='{y - 12:g}' width='24' height='15' rx='4' fill='{fill}' stroke='{outline}'/>"
    return box + _text(x + 34, y, 13, "#333333", wing, "")


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    """From the lower edge of a box to the upper edge of another, towards its middle."""
    (x, y), (to_x, to_y) = start, end
    lean = max(-0.3, min(0.3, (to_x - x) / STEP[0])) * BOX[0]
    x, to_x = x + lean, to_x - lean
    y, to_y = y + BOX[1] / 2, to_y - BOX[1] / 2 - 2
    bend = (to_y - y) / 2
    curve = f"M{x:g} {y:g} C{x:g} {y + bend:g} {to_x:g} {to_y - bend:g} {to_x:g} {to_y:g}"
    return f"<path d='{curve}' fill='none' stroke='#7a7a7a' stroke-width='1.4' marker-end='url(#head)'/>"


def _box(x: float, y: float, name: str, what: str, fill: str, outline: str) -> str:
    """A package: its name, and what it is for in a few words."""
    short = re.split(r"[:;]|, (?=strictly|a folder)", what)[0].replace("->", "→")
    count = len(textwrap.wrap(short, CHARACTERS))
    lines = next(found for width in range(CHARACTERS) if len(found := textwrap.wrap(short, width + 1)) <= count)
    first = y - 3 - 7 * len(lines)
    corner = f"x='{x - BOX[0] / 2:g}' y='{y - BOX[1] / 2:g}' width='{BOX[0]}' height='{BOX[1]}'"
    parts = [f"<rect {corner} rx='8' fill='{fill}' stroke='{outline}' stroke-width='1.4'/>"]
    parts.append(_text(x, first + 6, 15, "#000000", name, "text-anchor='middle' font-weight='bold'"))
    parts += [_text(x, first + 23 + 14 * n, 11.5, "#444444", one) for n, one in enumerate(lines)]
    return "\n".join(parts)


def listed(said: Mapping[str, str]) -> str:
    """The table of packages, from the ground up."""
    lines = [f"| `lidarcfg/{name}/` | {what.replace('->', '→')} |" for name, what in said.items()]
    return "\n".join(["| package | what it is for |", "|---|---|", *lines, ""])


def main(words: list[str]) -> int:
    """Write drawing and table, or compare them."""
    said = packages()
    page = PAGE.read_text()
    before, _, rest = page.partition(BEGIN)
    made = {PICTURE: picture(said, imports(said)), PAGE: before + BEGIN + listed(said) + END + rest.partition(END)[2]}
    if words == ["--check"]:
        return int(any(not path.is_file() or path.read_text() != text for path, text in made.items()))
    for path, text in made.items():
        path.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
