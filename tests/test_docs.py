"""The documentation, tried as a reader would: every command, example, file, link and name in it."""

import ast
import csv
import json
import os
import re
import runpy
import shlex
import sys
import time
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import dpkt
import numpy as np
import pytest

import lidarcfg
from lidarcfg.cli.main import cli
from lidarcfg.config.models import Model, load
from lidarcfg.errors import LidarcfgError
from lidarcfg.report.summaries import summary
from lidarcfg.requirements.file import KINDS, RequirementsFile
from lidarcfg.requirements.scenarios.file import ScenarioFile
from lidarcfg.search.sweep_plan import PlanFile
from lidarcfg.sensors.faults import FaultsFile
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import RigFile
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.study.file import StudyFile
from lidarcfg.world.motion import Motion
from lidarcfg.world.scene_file import SceneFile

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
EXAMPLES = sorted((DOCS / "examples").glob("*.py"))
# What others' commands are given in the text.
OTHERS_OPTIONS = {
    *("--help", "--long", "--makers", "--nightly", "--no-compile", "--no-deps", "--objects", "--packets", "--sanitize")
}
COMMANDS = {
    f"{prefix}{name}": command
    for prefix, group in (("", cli), ("sensors ", cli.commands["sensors"]))
    for name, command in group.commands.items()
}

# What takes long takes less of it, and what serves a page until Ctrl-C writes the same page into a file.
SUBSTITUTIONS = [
    (r"--seconds [\d.]+", "--evaluations 8"),
    (r"--evaluations \d{2,}", "--evaluations 8"),
    (r"^sweep \S+", f"sweep {ROOT / 'tests/search/studies/plan.yaml'}"),
    (r"^(optimize (?!.*--evaluations).*)$", r"\1 --evaluations 8"),
    (r"--duration [\d.]+", "--duration 0.1"),
    (r"--tolerance [\d.]+", "--tolerance 0.1"),
    (r"^(replay .*) --emulate --loop$", r"\1"),  # whose ports need a right to them: tests/capture/test_emulation.py
    (r"^(replay .*?)( --speed [\d.]+x?)?( --from .*)?$", r"\1 --speed 100\3"),
    (r"^(live (?!.*--duration).*?)( --emulate)?( --poses \S+)?$", r"\1 --duration 0.1"),  # the same
    (r"^(view (?!.*(--html|--png|--window)).*)$", r"\1 --html out/page.html"),
]
# What the commands write that get a folder; what a folder of another tool holds; how files begin.
RESULTS = {
    "optimize": ["report.html", "rig.yaml", "result.json", "history.csv", "convergence.png", "rig.png", "search.npz"],
    "verify": ["verdict.html", "verdict.json"],
    "evaluate": ["report.html", "result.json", "rig.png"],
    "compare": ["compare.html", "compare.json"],
    "sweep": ["table.csv", "table.parquet", "sweep.png"],
}
FRONT = ["front.html", "front.json", "front.png", "history.csv", "search.npz"]
POINT = [*RESULTS["optimize"], "study.yaml"]
FOLDERS = [["metadata.yaml"], ["sensor.json", "calibrated_sensor.json"]]  # ROS 2, nuScenes
FOLDERS += [
    ["sequences", "poses"],
    ["training"],
    ["v1.0-lidarcfg", "maps", "samples"],
]  # KITTI's two, nuScenes with data
MAGIC = {
    ".usda": b"#usda 1.0",
    ".pcap": b"\xd4\xc3\xb2\xa1",  # little-endian, microseconds
    ".parquet": b"PAR1",
    ".ply": b"ply\nformat binary_little_endian 1.0\n",
    ".pcd": b"# .PCD v0.7",
    ".npz": b"PK\x03\x04",
    ".png": b"\x89PNG\r\n\x1a\n",
    ".html": b"<!doctype html>",
    ".las": b"LASF",
    ".laz": b"LASF",
    ".mcap": b"\x89MCAP0\r\n",
    ".bag": b"#ROSBAG V2.0\n",
}
# Words of a command that is not run, and why.
NOT_RUN = {"--window": "needs a screen", "--scheduler": "needs a cluster"}


def name_of(page):
    return page.relative_to(ROOT).with_suffix("").as_posix()


def blocks(page, *kinds):
    """The texts of the fenced blocks of these kinds on a page, in order, each with its kind."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    return [(kind, text) for kind, text in found if kind in kinds]


def commands(text):
    """The words of each of our command lines in a block, joined over backslashes, as a shell reads them."""
    lines = text.replace("\\\n", " ").splitlines()
    return [shlex.split(line, comments=True) for line in lines if line.split()[:1] == ["lidarcfg"]]


def help_examples():
    """The command lines of the first page of --help, and then of each command's."""
    texts = [cli.epilog, *(command.epilog or "" for command in COMMANDS.values())]
    return [words for text in texts for words in commands(text)]


def quick(words):
    """The command without its name, in less time."""
    line = shlex.join(words[1:])
    for pattern, less in SUBSTITUTIONS:
        line = re.sub(pattern, less, line)
    return shlex.split(line)


def named_files(page):
    """The YAML blocks that begin with a comment naming a file: name and text."""
    return {m[1]: text for _, text in blocks(page, "yaml") if (m := re.match(r"# (\S+\.yaml)\n", text))}


def run(words):
    """Run a command; the files that it names as output are new, whole and of their kind."""
    before = time.time_ns()
    allowed = (None, 0, 3) if words[0] in ("verify", "optimize") else (None, 0)  # 3: a requirement is not met
    try:
        code = cli.main(words, prog_name="lidarcfg", standalone_mode=False)
    except SystemExit as ended:
        code = ended.code
    assert code in allowed, words
    for path in outputs(words):
        assert path.stat().st_mtime_ns >= before - 20_000_000, f"{path} was not written by {words}"  # a clock's tick
        check_kind(path)


def outputs(words):
    """The files that a command should write."""
    if "--dry-run" in words:
        return []
    options = dict(pairwise(words))
    written = ("-o", "--output", "--html", "--png", *(["--truth"] if words[0] == "export" else []))
    named = [Path(options[name]) for name in written if name in options]
    if words[0] == "optimize":
        folder = Path(options.get("-o") or options.get("--resume") or f"out/{Path(words[1]).stem}")
        if lidarcfg.load_study(words[1]).to_choose:
            points = [folder / point["folder"] for point in json.loads((folder / "front.json").read_text())["points"]]
            assert points
            return [*(folder / name for name in FRONT), *(p / name for p in points for name in POINT)]
        return [folder / name for name in RESULTS["optimize"]]
    if words[0] in RESULTS:
        return [folder / name for folder in named for name in RESULTS[words[0]]]
    if "--split" in words:
        path = Path(options["-o"])
        return [path.with_name(f"{path.stem}-{mount.name}.pcap") for mount in lidarcfg.load_rig(words[1]).mounts]
    return named


def check_kind(path):
    """By the magic bytes of its format, or by reading it."""
    if path.is_dir():
        (names,) = (names for names in FOLDERS if all((path / name).exists() for name in names))
        assert all((path / name).stat().st_size for name in names)
        return
    content = path.read_bytes()
    if path.suffix in MAGIC:
        assert content.startswith(MAGIC[path.suffix]), path
        assert len(content) > 200, path
    elif path.suffix == ".json":
        assert json.loads(content), path
    elif path.suffix == ".urdf":
        assert ElementTree.fromstring(content).tag == "robot"
    elif path.suffix == ".csv":
        header, *rows = csv.reader(content.decode().splitlines())
        assert rows
        assert {len(row) for row in rows} == {len(header)}
    elif path.suffix == ".py":
        assert "static_transform" in ast.unparse(ast.parse(content))
    elif path.suffix == ".bin":
        assert content
        assert len(content) % 16 == 0  # four float32 a point
    elif path.suffix == ".mat3x4f":
        assert content
        assert len(content) % 48 == 0  # twelve float32 a ray
    elif b"ros__parameters" in content:
        assert content.startswith(b"/**:")
    else:
        assert path.suffix == ".yaml", f"{path} is of a kind that no test knows"
        assert summary(path).text


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A folder like the project's own after tools/demo, in which the test is run."""
    for name in ("data", "sensors", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_of_a_page_runs(page, project, request):
    """In order, with Python in between; files that the page shows are there from the start."""
    if page.stem != "reading-a-report":
        request.getfixturevalue("blank_pictures")
    for name, text in named_files(page).items():
        Path(name).write_text(text)
    names = {}
    for kind, text in blocks(page, "", "sh", "bash", "python"):
        if kind == "python":
            exec(compile(text, str(page), "exec"), names)
        for words in commands(text) if kind != "python" else ():
            if not NOT_RUN.keys() & set(words):
                run(quick(words))
    for _, text in blocks(page, "json"):
        shown = json.loads(text)
        (path,) = (path for path in Path("out").glob("*.json") if json.loads(path.read_text()).keys() == shown.keys())
        assert_shown(shown, json.loads(path.read_text()))


def assert_shown(shown, made):
    """What a page shows is what was made; "…" stands for anything, and numbers are rounded as the page has them."""
    if isinstance(shown, dict):
        assert shown.keys() == made.keys()
        for key in shown:
            assert_shown(shown[key], made[key])
    elif isinstance(shown, list):
        for one, other in zip(shown, made, strict=False):
            assert_shown(one, other)
    elif shown != "…":
        assert made == (pytest.approx(shown, rel=1e-3, abs=1e-9) if isinstance(shown, int | float) else shown)


@pytest.mark.slow
def test_every_example_of_help_runs(project, blank_pictures, capsys):
    """In the order of the first page: later ones use what earlier ones wrote."""
    examples = help_examples()
    assert {words[1] for words in examples} == set(cli.commands)
    for words in dict.fromkeys(tuple(words[: words.index(">")] if ">" in words else words) for words in examples):
        run(quick(words))


@pytest.mark.slow
def test_the_demo(project, blank_pictures, capsys):
    """Its commands, in less time, and the Python that sums them up: it counts what other readers count."""
    script = (ROOT / "tools/demo-commands.sh").read_text()
    variables = dict(re.findall(r"^(\w+)=([\w/.-]+)$", script, re.MULTILINE)) | {"out": "out/demo"}
    for name, value in variables.items():
        script = script.replace(f"${name}", value)
    lines = [line.replace('"$bin/lidarcfg"', "lidarcfg") for line in script.splitlines()]
    called = [
        words[: words.index(">")] if ">" in words else words for words in commands("\n".join(lines).replace(">", " > "))
    ]
    assert [words[1] for words in called] == ["optimize", "export", "decode", "view", "view"]
    for words in called:
        run(quick(words))
    code = re.search(r"<<'PYTHON'\n(.*?)^PYTHON$", script, re.DOTALL | re.MULTILINE)[1]
    capsys.readouterr()
    argv = sys.argv
    sys.argv = ["-", "out/demo"]
    try:
        exec(compile(code, "demo-commands.sh", "exec"), {})
    finally:
        sys.argv = argv
    out = capsys.readouterr().out
    rows = dict(re.findall(r"^ *(\w[^ ].*?)  +(\S.*?) *$", out, re.MULTILINE))
    result = json.loads(Path("out/demo/result.json").read_text())
    told = result["believed"]
    means = [one["share"] for one in (result["misses"], told["best_plain"]["misses"], told["midpoint"]["misses"])]
    assert rows["mean"].split() == [f"{100 * share:.2f}%" for share in means]
    with open("out/demo/capture.pcap", "rb") as file:
        assert rows["packets"] == f"{sum(1 for _ in dpkt.pcap.Reader(file)):,}"
    vertices = re.search(rb"element vertex (\d+)", Path("out/demo/cloud.ply").read_bytes())[1]
    assert rows["points"] == f"{int(vertices):,}"
    assert all(
        Path(name).stat().st_size
        for key in ("report", "result, convergence", "picture, page")
        for name in rows[key].split()
    )


@pytest.mark.slow
@pytest.mark.parametrize("script", EXAMPLES, ids=lambda script: script.stem)
def test_every_example_runs(script, project, blank_pictures, capsys):
    runpy.run_path(str(script), run_name="__main__")
    assert len(capsys.readouterr().out.splitlines()) >= 3
    assert script.read_text().count("\n# %%") >= 3


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_yaml_on_a_page_is_what_it_looks_like(page, tmp_path):
    """By its keys a study, a rig, a scene, a sensor, or a motion; a list is a sensor of a rig."""
    for _, text in blocks(page, "yaml"):
        if text.lstrip().startswith("- "):
            text = f"name: rig\nsensors:\n{text}"
        keys = set(re.findall(r"^(\w+):", text, re.MULTILINE))
        kinds = {
            "vary": PlanFile,
            "region": StudyFile,
            "requirements": RequirementsFile,
            "beams": Sensor,
            "scan_pattern": Sensor,
            "target": ScenarioFile,
            "sensors": RigFile,
            "faults": FaultsFile,
            "ground": SceneFile,
            "boxes": SceneFile,
            "height_fields": SceneFile,
            "models": SceneFile,
            "surfels": SceneFile,
        }
        (tmp_path / "it.yaml").write_text(text)
        kind = next((kinds[key] for key in kinds if key in keys), Motion)
        assert isinstance(load(tmp_path / "it.yaml", kind), kind)


def anchors(page):
    """As GitHub makes them of headings."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.M), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_and_paths_lead_somewhere(page):
    text = re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        there = page.parent / path if path else page
        assert "://" in target or there.exists(), target
        assert not anchor or anchor in anchors(there), target
    for path in re.findall(r"`((?:data|docs|lidarcfg|sensors|tests|tools)/[\w./-]*)`", text):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"^(?:python )?(?:\./)?(tools/\S+)", "\n".join(t for _, t in blocks(page, "", "sh")), re.M):
        assert os.access(ROOT / path, os.X_OK) or path.endswith(".py"), path


def defined(path):
    """The names that a file defines: of Python also methods, as Class.method; of C++ every word."""
    text = path.read_text()
    if path.suffix != ".py":
        return set(re.findall(r"\w+", text))
    found = set()
    for node in ast.parse(text).body:
        names = [node.name] if hasattr(node, "name") else []
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        names += [one.id for one in targets if isinstance(one, ast.Name)]
        found |= {
            *names,
            *(f"{names[0]}.{one.name}" for one in getattr(node, "body", []) if names and hasattr(one, "name")),
        }
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_code_that_a_page_names_is_there(page):
    """`path/file.py: name`, by the file's own syntax tree."""
    text = " ".join(page.read_text().split())
    for path, name in re.findall(r"`((?:lidarcfg|tests|tools)/[\w./-]+): ([\w.]+)`", text):
        assert (ROOT / path).is_file(), path
        assert name in defined(ROOT / path), f"{path}: {name}"
    if page.stem == "architecture":
        assert text.count(".py: ") > 30


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_pictures_are_small_and_described(page):
    """One can see them without waiting, and their text says what is in them."""
    for text, path in re.findall(r"^!\[(.*)\]\((\S+\.png)\)$", page.read_text(), re.MULTILINE):
        assert len(text.split()) > 1, path
        assert (page.parent / path).stat().st_size <= 200_000, path


def documentation():
    return "\n".join(page.read_text() for page in PAGES)


def test_every_command_is_shown():
    for name in COMMANDS:
        assert re.search(rf"\blidarcfg {name}\b", documentation()), name


def test_every_option_that_is_named_is_there():
    there = {option for command in (cli, *COMMANDS.values()) for param in command.params for option in param.opts}
    there |= OTHERS_OPTIONS
    for page in PAGES:
        for code in re.findall(r"`([^`\n]+)`", page.read_text()):
            if code.startswith("--") or code.split()[0] in ("lidarcfg", *COMMANDS):
                assert set(re.findall(r"(?<!\S)--[a-z][a-z-]*", code)) - there == set(), page


def test_every_public_name_is_explained():
    text = (DOCS / "python.md").read_text()
    for name in lidarcfg.__all__:
        assert f"`{name}" in text, name


def keys(model):
    """Every key that a file of this kind may have."""
    for name, field in model.model_fields.items():
        yield name
        for part in parts(field.annotation):
            yield from keys(part)


def parts(annotation):
    if isinstance(annotation, type) and issubclass(annotation, Model):
        yield annotation
    for argument in getattr(annotation, "__args__", ()):
        yield from parts(argument)


FILES = [StudyFile, ScenarioFile, PlanFile, RigFile, SceneFile, Sensor, Motion, Realism]


@pytest.mark.slow
@pytest.mark.parametrize("model", [*FILES, *KINDS.values()])
def test_every_key_of_a_file_is_documented(model):
    text = documentation()
    assert [key for key in keys(model) if not re.search(rf"\b{key}\b", text)] == []


def test_the_figures_of_the_scene(project):
    """What its page says of the small scene: how often each object is hit, and how mistakes are reported."""
    page = (DOCS / "scene.md").read_text()
    Path("corner.yaml").write_text(named_files(DOCS / "scene.md")["corner.yaml"])
    words = next(w for _, text in blocks(DOCS / "scene.md", "") for w in commands(text) if "--truth" in w)
    run(words[1:])
    with np.load("out/corner.npz") as truth:
        counts = dict(zip(truth["object_names"].tolist(), np.bincount(truth["object"]).tolist(), strict=True))
    sentence = next(part for part in page.split("\n\n") if part.startswith("The two sensors get"))
    stated = [int(figure.replace(",", "")) for figure in re.findall(r"\b\d[\d,]*\b", sentence)]
    found = [sum(counts.values()), *sorted(counts.values(), reverse=True)]
    np.testing.assert_allclose(found, stated, rtol=0.01, atol=1)  # a ray on an edge may fall to either side elsewhere
    mistakes = {
        "reflectivity: 45": "reflectivity: 450",
        "yaw_deg: 15": "yaw: 15",
        "name: ball": "name: house",
        "tree.ply": "shrub.ply",
    }
    whole = Path("corner.yaml").read_text()
    for right, wrong in mistakes.items():
        Path("corner.yaml").write_text(whole.replace(right, wrong))
        with pytest.raises(LidarcfgError) as caught:
            lidarcfg.load_scene("corner.yaml")
        assert f"\n{caught.value}\n" in page
    assert page.split("```console\n")[1].split("```")[0].count("\n") == len(mistakes)


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".off", ".gltf"])
def test_mesh_files_that_the_page_names(suffix, project):
    """Written by Open3D, read in place of the page's tree."""
    import open3d as o3d

    assert f"`{suffix}`" in (DOCS / "scene.md").read_text()
    mesh = o3d.io.read_triangle_mesh("data/scenes/meshes/tree.ply").compute_triangle_normals()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        assert o3d.io.write_triangle_mesh(f"tree{suffix}", mesh)
    text = named_files(DOCS / "scene.md")["corner.yaml"]
    for name in ("data/scenes/meshes/tree.ply", f"tree{suffix}"):
        Path(f"with{Path(name).suffix}.yaml").write_text(text.replace("data/scenes/meshes/tree.ply", name))
    ours, named = (lidarcfg.load_scene(f"with{s}.yaml") for s in (suffix, ".ply"))
    corners = [scene.vertices_m[scene.triangles][scene.triangle_object == 6] for scene in (ours, named)]
    np.testing.assert_allclose(corners[0], corners[1], atol=1e-5)


def test_the_sensor_of_the_page_decodes_as_it_fired(project):
    """Its capture decodes to the ground truth of each return."""
    from lidarcfg.clouds.cloud import load_cloud

    for name, text in named_files(DOCS / "sensors.md").items():
        Path(name).write_text(text)
    mount = "{name: one, model: mine.yaml, position_m: [0, 0, 1.9], rpy_deg: [5, 0, 30]}"
    Path("rig.yaml").write_text(f"name: rig\nsensors:\n  - {mount}\n")
    scene = "data/scenes/street.yaml"
    run(["export", "rig.yaml", "--scene", scene, "--duration", "0.1", "-o", "out/it.pcap", "--truth", "out/it.npz"])
    run(
        ["decode", "out/it.pcap", "--rig", "none", "--model", "mine.yaml", "-o", "out/cloud.npz"]
    )  # in the sensor's own frame
    cloud = load_cloud("out/cloud.npz", print)
    sensor = lidarcfg.load_sensor("mine.yaml")
    with np.load("out/it.npz") as truth:
        order = np.lexsort((truth["laser"], truth["time_ns"]))
        range_m, laser, time_ns = (truth[key][order] for key in ("range_m", "laser", "time_ns"))
    again = np.argsort(cloud.time_ns, kind="stable")
    assert np.abs(cloud.time_ns[again] - time_ns).max() <= 1000
    assert (cloud.ring[again] == sensor.ring[laser]).all()
    start_m = np.array([0, 0, 1]) * sensor.vertical_offset_m[laser][:, None]
    assert np.abs(np.linalg.norm(cloud.xyz[again] - start_m, axis=1) - range_m).max() <= 0.001 + 1e-9
