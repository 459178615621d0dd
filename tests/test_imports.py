"""Imports run one way, and only packets/ knows what stands below a family."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "lidarcfg"
GROUND = {
    "errors",
    "inputs",
    "units",
    "files",
    "futures",
    "aside",
    "geometry",
    "config",
    "yaml_document",
    "kinds",
    "compiling",
    "jit",
    "linking",
    "loop_cache",
    "realism",
    "shortcuts",
}
# What each part may import besides itself and the ground: docs and commands stand on all of it.
BELOW = {
    "sensor": set(),
    "rig": {"sensor"},
    "firing": {"rig", "sensor"},
    "world": {"rig", "sensor", "cloud", "cloud_rows", "cloud_las"},
    "packets": {"world", "firing", "rig", "sensor"},
    "cloud": {"cloud_rows"},
    "cloud_rows": set(),
    "cloud_las": set(),
    "placement": {"world", "firing", "rig", "sensor"},
    "simulate": {"capture", "packets", "world", "rig", "sensor", "cloud"},
    "capture": {"packets", "world", "rig", "sensor", "cloud"},
}


def imports():
    """(importing module, imported module) of the whole package, inside functions too; without those for types only."""
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
                node.body = []
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from ((name, one.removeprefix("lidarcfg.")) for one in names if one.startswith("lidarcfg."))


def test_imports_run_one_way():
    found = [
        f"{one} imports {other}"
        for one, other in imports()
        if (top := one.split(".")[0]) in BELOW and other.split(".")[0] not in BELOW[top] | GROUND | {top}
    ]
    assert found == []


def test_the_ground_stands_alone():
    found = [
        f"{one} imports {other}" for one, other in imports() if one in GROUND and other.split(".")[0] not in GROUND
    ]
    assert found == []


def test_only_packets_knows_a_family():
    """Nothing outside a family's folder imports what is in it; within packets/, the registry names it and nobody else."""
    families = {path.name for path in (PACKAGE / "packets").iterdir() if (path / "codec.py").is_file()}
    assert {"robosense", "velodyne"} <= families
    found = [
        f"{one} imports {other}"
        for one, other in imports()
        for family in families
        if other.startswith(f"packets.{family}.") and not one.startswith(f"packets.{family}.")
    ]
    assert found == []


@pytest.mark.parametrize("word", ["1206", "block_flag", "product_id", "sequences_per_block", "EEFF", "pps"])
def test_nobody_else_speaks_of_its_bytes(word):
    allowed = {PACKAGE / "rig.py", PACKAGE / "sensor.py"} if word == "pps" else set()  # which name the renamed key
    files = [p for p in PACKAGE.rglob("*.py") if PACKAGE / "packets" / "velodyne" not in p.parents and p not in allowed]
    assert [str(path) for path in files if word in path.read_text()] == []


def test_the_catalogue_loads_without_packets():
    code = (
        "import sys, lidarcfg; from lidarcfg.sensor import catalogue, load_sensor\n"
        "[load_sensor(name) for name in catalogue()]\n"
        "print([name for name in sys.modules if name.startswith(('lidarcfg.packets', 'numba', 'open3d'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
