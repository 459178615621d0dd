#!/usr/bin/env python3
"""Write docs/api.md from the docstrings and signatures of the public modules.

.venv/bin/python tools/make_api.py          # writes it
.venv/bin/python tools/make_api.py --check  # exits with 1 if the file is out of date
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "api.md"
MODULES = {
    "The ground": ("errors", "geometry", "units"),
    "Sensors and rigs": ("sensor", "rig", "realism"),
    "World": ("world.scene", "world.vehicle", "world.motion"),
    "Placement": (
        "placement.region",
        "placement.study_file",
        "placement.study",
        "placement.slots",
        "placement.surfaces",
        "placement.evaluation",
        "placement.visibility",
        "placement.optimize",
        "placement.subspace",
        "placement.metric",
        "studies",
    ),
    "Simulation": ("simulate.export", "simulate.ground_truth"),
    "Packets and captures": ("packets.codec", "packets.families", "capture.pcap", "capture.decode", "capture.replay"),
    "Clouds, reports, pictures": ("cloud", "report", "view.stage", "view.still", "view.page"),
    "Other tools' formats": (
        "formats.export",
        "formats.urdf",
        "formats.launch",
        "formats.carla",
        "formats.nuscenes",
        "formats.las",
    ),
}
HEAD = """# API reference

Made from the docstrings by `tools/make_api.py`; a test keeps it up to date. [From Python](python.md) shows how the
names work together. Lengths are metres, angles radians and times integer nanoseconds unless a name says otherwise.
"""


def reference() -> str:
    """The whole page."""
    parts = [HEAD]
    for title, names in MODULES.items():
        parts.append(f"## {title}\n")
        parts += [module(name) for name in names]
    return "\n".join(parts)


def module(name: str) -> str:
    """A section for one module: its docstring, then its public classes and functions in the order of the file."""
    path = ROOT / "lidarcfg" / Path(*name.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    source = path.read_text()
    tree = ast.parse(source)
    parts = [f"### `lidarcfg.{name}`\n", f"{ast.get_docstring(tree)}\n"]
    public = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_")]
    return "\n".join(parts + [definition(node, source.splitlines()) for node in public])


def definition(node: ast.FunctionDef | ast.ClassDef, lines: list[str]) -> str:
    """A class with its fields, comments included, and its public methods; or a function's signature; docstrings."""
    parts = [f"#### `{node.name}`", "", "```py", *header(node, lines)]
    if isinstance(node, ast.ClassDef):
        for field in node.body:
            if isinstance(field, ast.AnnAssign):
                parts += lines[field.lineno - 1 : field.end_lineno]
    parts += ["```", "", *(ast.get_docstring(node) or "").splitlines(), ""]
    if isinstance(node, ast.ClassDef):
        for method in node.body:
            if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                marks = {ast.unparse(mark) for mark in method.decorator_list}
                kind = "property" if marks & {"property", "cached_property"} else "method"
                text = " ".join((ast.get_docstring(method) or "").split())
                name = method.name if kind == "property" else f"{method.name}({ast.unparse(method.args)})"
                parts.append(f"- `{name}`{returns(method)}: {text}")
        parts.append("")
    return "\n".join(parts)


def header(node: ast.FunctionDef | ast.ClassDef, lines: list[str]) -> list[str]:
    """The lines of the definition, from `class` or `def` to its colon."""
    return lines[node.lineno - 1 : node.body[0].lineno - 1]


def returns(method: ast.FunctionDef) -> str:
    """What a method returns, as it is annotated."""
    return f" → `{ast.unparse(method.returns).strip(chr(39))}`" if method.returns else ""


def main(arguments: list[str]) -> int:
    """Write the page, or compare it."""
    text = reference()
    if arguments == ["--check"]:
        return int(not PAGE.is_file() or PAGE.read_text() != text)
    PAGE.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
