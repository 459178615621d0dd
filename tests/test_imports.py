"""Imports run one way, and only packets/ knows what stands below a family."""

import ast
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

from lidarcfg import core

PACKAGE = Path(__file__).parents[1] / "lidarcfg"
# The folder listing of the package, from the ground up: each line imports only what stands above it, and itself.
LISTING = (
    ["errors", "units", "core", "maths", "geometry", "futures", "files", "inputs", "notebook"],  # the ground
    ["config"],  # our YAML files
    ["clouds"],  # point clouds and their files
    ["sensors"],  # sensors, rigs and mounts
    ["world"],  # scenes, vehicles, trajectories; the tracer
    ["packets"],  # a maker a folder: bytes, and when lasers fire
    ["simulate"],  # a drive: firings, echoes, points
    ["returns"],  # what sensors get from an object at places
    ["vsr"],  # the paper
    ["requirements"],  # what a rig must see, and the verdict
    ["solvers"],  # they minimise over the unit cube
    ["study"],  # what may sit where, what is minimised, how well a rig does
    ["search"],  # for the best rig, for the cheapest, for many
    ["capture"],  # pcap, export, decode, replay
    ["io"],  # from and to other tools
    ["report"],
    ["viewer"],
    ["cli"],
)
LEVEL = {name: level for level, names in enumerate(LISTING) for name in names}


@cache
def modules():
    """Each module of the package, the core's by its stub: its name, without `lidarcfg.` and `.__init__`, and its text."""
    paths = [*sorted(PACKAGE.rglob("*.py")), *sorted((PACKAGE / "core").glob("[!_]*.pyi"))]
    names = [".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in paths]
    texts = [path.read_text() for path in paths]
    return [(name.removesuffix("__init__").rstrip("."), text) for name, text in zip(names, texts, strict=True)]


@cache
def imports():
    """(importing module, imported module) of the whole package, inside functions too, and for types only."""
    found = []
    for name, text in modules():
        for node in ast.walk(ast.parse(text)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            found += [(name, one.removeprefix("lidarcfg.")) for one in names if one.startswith("lidarcfg.")]
    return found


def test_the_listing_names_what_is_there():
    there = {path.stem for path in PACKAGE.glob("*.py")} | {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert there - {"__init__", "__main__"} == set(LEVEL)


def test_the_core_is_divided_as_the_package():
    """A submodule, and a folder of kernels, is named as the package that it serves; `maths` is of a module."""
    compiled = {name for name, value in vars(core.compiled).items() if isinstance(value, ModuleType)}
    packages = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert compiled - packages == {"maths"}
    assert {path.parent.name for path in (PACKAGE / "core").glob("*/*.cpp")} - {"bind"} == compiled - {"maths"}
    assert {path.stem for path in (PACKAGE / "core").glob("*.pyi")} - {"__init__"} == compiled
    assert compiled <= vars(core).keys()


def test_imports_run_one_way():
    found = [
        f"{one} imports {other}"
        for one, other in imports()
        if (top := one.split(".")[0]) in LEVEL and LEVEL.get(other.split(".")[0], 0) > LEVEL[top]
    ]
    assert found == []


def test_no_class_name_serves_two_things():
    found = defaultdict(list)
    for name, text in modules():
        if not name.startswith("core"):
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.ClassDef):
                    found[node.name].append(name)
    assert {name: there for name, there in found.items() if len(there) > 1} == {}


@pytest.mark.parametrize("name", sorted(LEVEL))
def test_each_package_has_a_face(name):
    """A sentence on what it does, and in what order its modules are read; the core's is a page, the command line's help."""
    path = PACKAGE / name / "__init__.py"
    if path.exists():
        said = ast.get_docstring(ast.parse(path.read_text())) or ""
        assert len(said) > 40
        named = set(re.findall(r"`(\w+)`", said))
        there = {one.stem for one in path.parent.glob("*.py")} - {"__init__"}
        assert name in ("core", "cli") or there <= named


def test_decode_needs_no_scenes():
    code = "import sys, lidarcfg.capture.decode; print([name for name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stdout))
    world = {name for name in loaded if name.startswith("lidarcfg.world.")}
    assert world <= {"lidarcfg.world.motion"}
    tops = {name.split(".")[1] for name in loaded if name.startswith("lidarcfg.")}
    assert not tops & {"simulate", "vsr", "study", "search", "io", "report", "viewer", "cli"}
    assert not loaded & {"open3d", "trimesh", "scipy", "matplotlib"}


def loaded_by_name():
    """(loading module, loaded module) of those that are named in strings: alone, or `module:member` in a registry."""
    for name, text in modules():
        for one in re.findall(r'import_module\("lidarcfg\.([\w.]+)"\)|"lidarcfg\.([\w.]+):\w+"', text):
            yield name, "".join(one)


def test_no_modules_import_each_other():
    """Nor by way of others; but for what a notebook shows, which is drawn further up, and loaded when it is shown."""
    names = {name for name, _ in modules()}
    below = defaultdict(set)
    for one, other in [*imports(), *loaded_by_name()]:
        if one == "notebook":
            continue
        while other not in names:  # a member of a module
            other = other.rpartition(".")[0]
        below[one] |= {other} - {one}  # the core has its modules of compiled loops
    assert "core.world" in below["core.vsr"]
    assert "packets.velodyne" in below["packets.families"]
    assert "solvers.auto" in below["solvers"]
    TopologicalSorter(below).prepare()  # raises an error that lists the modules of a cycle


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
    allowed = {
        "pps": {PACKAGE / "sensors/rig.py", PACKAGE / "sensors/sensor.py"},  # which name the renamed key
        "EEFF": {PACKAGE / "packets/hesai/telemetry.py"},  # as a QT128's firing time file begins
        "1206": {PACKAGE / "io/ros_messages.py"},  # which has ROS's own definition of velodyne_msgs
    }.get(word, set())
    files = [p for p in PACKAGE.rglob("*.py") if PACKAGE / "packets" / "velodyne" not in p.parents and p not in allowed]
    assert [str(path) for path in files if word in path.read_text()] == []


def test_the_catalogue_loads_without_packets():
    code = (
        "import sys, lidarcfg; from lidarcfg.sensors.sensor import catalogue, load_sensor\n"
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
