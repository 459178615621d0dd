#!/usr/bin/env python3
"""Write the core's stubs, lidarcfg/core/*.pyi, from the signatures of what is compiled, by nanobind's stubgen.

.venv/bin/python tools/make_stubs.py          # writes them
.venv/bin/python tools/make_stubs.py --check  # exits with 1 if one is out of date
"""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

from nanobind.stubgen import StubGen

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
from lidarcfg import core

FOLDER = ROOT / "lidarcfg" / "core"


def stub(part: ModuleType) -> str:
    """A submodule's stub, of the names by which Python imports it, whichever of the core's modules it is of."""
    generator = StubGen(part)
    generator.put(part)
    text = generator.get().replace(core.compiled.__name__, core.__name__)
    for command in (["check", "--select", "I", "--fix-only", "--quiet"], ["format", "--quiet"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, "--stdin-filename", f"{FOLDER / part.__name__}.pyi", "-"],
            input=text, capture_output=True, text=True, check=True, cwd=ROOT,
        )  # fmt: skip
        text = done.stdout
    return text


def stubs() -> dict[Path, str]:
    """All of them, by their files."""
    parts = {name: part for name, part in vars(core.compiled).items() if isinstance(part, ModuleType)}
    return {FOLDER / f"{name}.pyi": stub(part) for name, part in parts.items()}


def main() -> None:
    outdated = {path: text for path, text in stubs().items() if not path.exists() or path.read_text() != text}
    if "--check" in sys.argv[1:]:
        sys.exit(f"run tools/make_stubs.py: {', '.join(path.name for path in outdated)}" if outdated else 0)
    for path, text in outdated.items():
        path.write_text(text)


if __name__ == "__main__":
    main()
