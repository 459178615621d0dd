#!/usr/bin/env python3
"""Write docs/api.md from the docstrings and signatures of the public names: what the package and its packages export.

.venv/bin/python tools/make_api.py          # writes it
.venv/bin/python tools/make_api.py --check  # exits with 1 if the file is out of date
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "api.md"
HEAD = """# API reference

Made by `tools/make_api.py` from signatures and docstrings; a test keeps it up to date. It has the names that the
package exports with the types that they return, and a line for each name of its packages; `help(name)` says all of
each, its errors too. [From Python](python.md) shows how they work together. Lengths are metres, angles radians and
times integer nanoseconds unless a name says otherwise.
"""
Definition = ast.FunctionDef | ast.ClassDef


class Module:
    """A module's source: what it defines, and what it imports from the package under which name."""

    def __init__(self, name: str) -> None:
        path = ROOT / Path(*name.split("."))
        is_package = path.is_dir()
        path = path / "__init__.py" if is_package else path.with_suffix(".py")
        stub = path.with_suffix(".pyi")
        self.doc = ast.get_docstring(ast.parse(path.read_text())) or ""
        self.lines = (stub if is_package and stub.exists() else path).read_text().splitlines()
        body = ast.parse("\n".join(self.lines)).body
        self.definitions = {node.name: node for node in body if isinstance(node, Definition)}
        self.imports: dict[str, tuple[str, str]] = {}
        for node in body:
            if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith("lidarcfg")):
                parent = name if is_package else name.rpartition(".")[0]
                source = f"{parent}.{node.module}" if node.level else str(node.module)
                self.imports |= {one.asname or one.name: (source, one.name) for one in node.names}


MODULES: dict[str, Module] = {}


def module(name: str) -> Module:
    """A module, read once."""
    return MODULES.setdefault(name, MODULES.get(name) or Module(name))


def found(source: str, name: str) -> tuple[str, Definition] | None:
    """The module that defines a name, and its definition; None for constants and aliases."""
    try:
        there = module(source)
    except FileNotFoundError:
        return None
    if name in there.definitions:
        return source, there.definitions[name]
    return found(*there.imports[name]) if name in there.imports else None


def exported(face: str) -> Iterator[tuple[str, Definition]]:
    """What a package exports, in order of its names, and what its functions return."""
    names = {name: source for name, source in module(face).imports.items() if not name.startswith("_")}
    for name in sorted(names, key=str.lower):
        if one := found(*names[name]):
            yield one
            if isinstance(one[1], ast.FunctionDef) and one[1].returns:
                said = ast.unparse(one[1].returns).strip("'\"").partition(" ")[0]
                if (returned := found(one[0], said)) and isinstance(returned[1], ast.ClassDef):
                    yield returned


def faces() -> list[str]:
    """The package and those of its packages that export something."""
    packages = [path.parent.name for path in sorted((ROOT / "lidarcfg").glob("*/__init__.py"))]
    return ["lidarcfg", *(f"lidarcfg.{name}" for name in packages if name != "core")]


def reference() -> str:
    """The whole page; a name that several packages export is with the first."""
    parts = [HEAD]
    seen = set()
    for face in faces():
        some = []
        for source, node in exported(face):
            if (source, node.name) not in seen:
                seen.add((source, node.name))
                some.append(definition(node, module(source).lines) if face == "lidarcfg" else line(node))
        if some:
            parts += [f"## `{face}`\n", f"{first_paragraph(module(face).doc)}\n", *some]
            parts += [""] * (face != "lidarcfg")
    return "\n".join(parts)


def definition(node: Definition, lines: list[str]) -> str:
    """A class with its fields, comments included, and its public methods; or a function's signature."""
    parts = [f"### `{node.name}`", "", "```py", *lines[node.lineno - 1 : node.body[0].lineno - 1]]
    if isinstance(node, ast.ClassDef):
        for field in node.body:
            if isinstance(field, ast.AnnAssign) and is_public(field):
                parts += lines[field.lineno - 1 : field.end_lineno]
    parts += ["```", "", *first_paragraph(ast.get_docstring(node) or "").splitlines(), ""]
    if isinstance(node, ast.ClassDef):
        methods = [one for one in node.body if isinstance(one, ast.FunctionDef) and not one.name.startswith("_")]
        parts += [line(method) for method in methods]
        parts += [""] * bool(methods)
    return "\n".join(parts)


def is_public(field: ast.AnnAssign) -> bool:
    """Whether it is a field that users read: neither private, nor the class's own."""
    return not ast.unparse(field.target).startswith("_") and not ast.unparse(field.annotation).startswith("ClassVar")


def line(node: Definition) -> str:
    """A name with its arguments and what it returns, and the first sentence of its docstring."""
    call = node.name
    returned = ""
    if isinstance(node, ast.FunctionDef):
        marks = {ast.unparse(mark) for mark in node.decorator_list}
        if not marks & {"property", "cached_property"}:
            call += f"({', '.join(arguments(node.args))})"
        if node.returns:
            returned = f" → `{ast.unparse(node.returns).strip(chr(39))}`"
    text = " ".join(first_paragraph(ast.get_docstring(node) or "").split())
    return f"- `{call}`{returned}: {re.split(r'(?<=[.?]) (?=[A-Z`])', text)[0]}"


def arguments(given: ast.arguments) -> Iterator[str]:
    """Their names; `=…` where one may be left out."""
    positional = [*given.posonlyargs, *given.args]
    required = len(positional) - len(given.defaults)
    for index, one in enumerate(positional):
        if one.arg not in ("self", "cls"):
            yield one.arg + "=…" * (index >= required)
    if given.vararg:
        yield f"*{given.vararg.arg}"
    for one, default in zip(given.kwonlyargs, given.kw_defaults, strict=True):
        yield one.arg + "=…" * (default is not None)


def first_paragraph(text: str) -> str:
    """Of a docstring."""
    return text.partition("\n\n")[0]


def main(words: list[str]) -> int:
    """Write the page, or compare it."""
    text = reference()
    if words == ["--check"]:
        return int(not PAGE.is_file() or PAGE.read_text() != text)
    PAGE.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
