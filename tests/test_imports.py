"""Imports run one way, and only packets/ knows what stands below a family."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "lidarcfg"
GROUND = {
    "errors",
    "inputs",
    "maths",
    "units",
    "files",
    "futures",
    "geometry",
    "config",
    "core",
    "yaml_document",
    "kinds",
    "jit",
    "realism",
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


def modules():
    """Each module of the package: its name, without `lidarcfg.` and `.__init__`, and its text."""
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        yield name.removesuffix("__init__").rstrip("."), path.read_text()


def imports():
    """(importing module, imported module) of the whole package, inside functions too; without those for types only."""
    for name, text in modules():
        tree = ast.parse(text)
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


def loaded_by_name():
    """(loading module, loaded module) of those that are named in strings: alone, or `module:member` in a registry."""
    for name, text in modules():
        for one in re.findall(r'import_module\("lidarcfg\.([\w.]+)"\)|"lidarcfg\.([\w.]+):\w+"', text):
            yield name, "".join(one)


def test_no_modules_import_each_other():
    """Nor by way of others."""
    names = {name for name, _ in modules()}
    below = defaultdict(set)
    for one, other in [*imports(), *loaded_by_name()]:
        while other not in names:  # a member of a module
            other = other.rpartition(".")[0]
        below[one] |= {other} - {one}  # the core has its modules of compiled loops
    assert "packets.velodyne" in below["packets.families"]
    assert "placement.solvers.auto" in below["placement.solvers"]
    TopologicalSorter(below).prepare()  # raises an error that lists the modules of a cycle


def test_the_ground_stands_alone():
    found = [
        f"{one} imports {other}" for one, other in imports() if one in GROUND and other.split(".")[0] not in GROUND
    ]
    assert found == []


def test_only_packets_knows_a_family():
    """Nothing outside a family's folder imports what is in it; within packets/, the registry names it and nobody else."""
    families = {path.name for path in (PACKAGE / "packets").iterdir() if (path / "layout.py").is_file()}
    assert {"robosense", "velodyne"} <= families
    found = [
        f"{one} imports {other}"
        for one, other in imports()
        for family in families
        if other.startswith(f"packets.{family}.") and not f"{one}.".startswith(f"packets.{family}.")
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
        "print([name for name in sys.modules if name.startswith(('lidarcfg.packets', 'open3d'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def foreign_names(tree):
    """The names that a module has of other libraries' modules and of what these hold."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (
                (one.asname or one.name.split(".")[0]) for one in node.names if not one.name.startswith("lidarcfg")
            )
        if isinstance(node, ast.ImportFrom) and not node.level and not node.module.startswith("lidarcfg"):
            yield from (one.asname or one.name for one in node.names)


def is_private(name):
    return name.startswith("_") and not name.startswith("__") and name != "_exit"  # which the manual of os has


def intrusions(text):
    """What a module does to other libraries by another door than the front one."""
    tree = ast.parse(text)
    foreign = set(foreign_names(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.level and not node.module.startswith("lidarcfg"):
            private = [one.name for one in node.names if is_private(one.name)]
            private += [part for part in node.module.split(".") if is_private(part)]
            yield from (f"imports {node.module}.{name}" for name in private)
        if isinstance(node, ast.Attribute):
            path = ast.unparse(node)
            root = path.split(".")[0]
            if root in foreign and is_private(node.attr):
                yield f"reads {path}"
            if path == "sys.modules":
                yield "reads sys.modules"
            if (
                root in foreign
                and isinstance(node.ctx, ast.Store | ast.Del)
                and path not in ("sys.stdout", "sys.stderr")
            ):
                yield f"assigns {path}"
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "setattr" and ast.unparse(node.args[0]) in foreign:
            yield f"assigns to {ast.unparse(node.args[0])}"


@pytest.mark.parametrize(
    "text",
    [
        "import numpy as np\nnp._globals",
        "from numpy import _core",
        "from scipy._lib import doccer",
        "import json\njson.loads = None",
        "import sys\nsys.modules['json'] = None",
        "from numpy import linalg\nsetattr(linalg, 'norm', None)",
    ],
)
def test_intrusions_are_found(text):
    assert list(intrusions(text))


def test_no_library_is_entered_by_another_door():
    assert [f"{name}: {found}" for name, text in modules() for found in intrusions(text)] == []
