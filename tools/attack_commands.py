"""The commands that write files, each for either of two names that tell whose an output is, and what they read."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from attack_run import run

MARKS = "markfirst", "marksecond"  # the name of the rig or study that a file is of
KINDS = "study", "rig"  # of a schema, in place of the names
STUDY = """
region: {{min_m: [-4, -4, 0], max_m: [4, 4, 2], cuboid_m: [0.5, 0.5, 0.25]}}
sensors:
  - {{name: {0}, model: vlp-16, min: {{position_m: [0, 0, 1.8], rpy_deg: [-20, -20, 0]}},
     max: {{position_m: [1, 1, 2], rpy_deg: [20, 20, 0]}}}}
detection:
  - {{name: box, size_m: [0.5, 0.5, 0.5], threshold: 2}}
solver: {{method: abc, bees: 10, cycles: 40, seed: {1}}}
"""
CHOICES = """
region: {{min_m: [-4, -4, 0], max_m: [4, 4, 2], cuboid_m: [1, 1, 1]}}
prices: {{vlp-16: 1, hdl-32e: 2}}
sensors:
  - {{name: {0}, choose: [vlp-16, hdl-32e], min: {{position_m: [0, 0, 1.8], rpy_deg: [-20, -20, 0]}},
     max: {{position_m: [1, 1, 2], rpy_deg: [20, 20, 0]}}}}
solver: {{evaluations: 40, seed: {1}}}
"""
PLAN = """
study:
  region: {{min_m: [-4, -4, 0], max_m: [4, 4, 2], cuboid_m: [1, 1, 1]}}
  sensors:
    - {{name: {0}, model: vlp-16, min: {{position_m: [0, 0, 1.8], rpy_deg: [-20, -20, 0]}},
       max: {{position_m: [1, 1, 2], rpy_deg: [20, 20, 0]}}}}
  solver: {{method: cmaes, evaluations: 40}}
vary: {{solver.seed: [{1}, 7]}}
"""
SCENE = """name: box
ground: {z_m: 0, reflectivity: 12}
boxes: [{name: box, center_m: [5, 0, 1], size_m: [1, 1, 2], reflectivity: 20}]
"""
RIG = "name: {0}\nsensors:\n  - {{name: {0}, model: vlp-16, position_m: [0, 0, {1}]}}\n"
TWO = """name: {0}
sensors:
  - {{name: left, model: vlp-16, position_m: [0, 1, {1}]}}
  - {{name: right, model: vlp-16, position_m: [0, -1, {1}]}}
"""
SEARCH = {"rig.yaml", "search.npz"}, {"search.npz"}  # the progress of a search and of one with choices


@dataclass(frozen=True)
class Command:
    """A command that writes, with {0} for one of the two names in its words, and {1} for one of the kinds."""

    name: str  # of the table
    words: str
    outputs: tuple[str, ...]
    progress: frozenset[str] = frozenset()  # the files of it that a killed one may leave alone
    once: bool = False  # an output that is there already is refused
    resumes: bool = False  # goes on with what a killed one has left

    @property
    def stops(self) -> bool:
        """Whether an interrupt leaves what it has so far."""
        return bool(self.progress) or self.resumes

    @property
    def fixed(self) -> bool:
        """Whether each name has outputs of its own."""
        return self.once or self.resumes

    def typed(self, mark: str) -> list[str]:
        """Its words."""
        return self.words.format(mark, KINDS[MARKS.index(mark)]).split()


def _search(name: str, words: str, folder: str, progress: set[str]) -> Command:
    return Command(name, f"{words} -o {folder} --quiet", (folder,), frozenset(progress))


def _export(what: str, output: str, options: str = "", rig: str = "rig", more: Sequence[str] = ()) -> Command:
    words = f"export {{0}}-{rig}.yaml --scene scene.yaml --duration 0.1 -o {output} {options} --quiet"
    return Command(f"export {what}", words, (*(more or (f"{output}.yaml", output)),))


def _convert(what: str, source: str, output: str, options: str = "") -> Command:
    return Command(f"convert {what}", f"convert {{0}}{source} -o {output} {options} --quiet", (output,))


SPLIT = "s-left.pcap.yaml", "s-left.pcap", "s-right.pcap.yaml", "s-right.pcap"
COMMANDS = (
    _search("optimize", "optimize {0}.yaml", "o", SEARCH[0]),
    _search("optimize with choices", "optimize {0}-choices.yaml", "f", SEARCH[1]),
    Command("evaluate", "evaluate {0}.yaml {0}-rig.yaml -o e --quiet", ("e",)),
    Command("compare", "compare {0}-rig.yaml {0}-rig.yaml --study {0}.yaml -o c --quiet", ("c",)),
    _export("to .pcap with --truth", "x.pcap", "--truth t.npz", more=("x.pcap.yaml", "t.npz", "x.pcap")),
    _export("to .pcap with --split", "s.pcap", "--split", "two", SPLIT),
    *(_export(f"to {suffix}", f"x{suffix}") for suffix in (".ply", ".pcd", ".npz", ".mcap", ".bag")),
    *(
        _export(f"to a folder of {name}", name, f"--to {name}")
        for name in ("rosbag2", "rosbag2-mcap", "kitti-odometry", "kitti-object", "nuscenes")
    ),
    *(
        Command(f"decode to {suffix}", f"decode {{0}}.pcap -o d{suffix} --quiet", (f"d{suffix}",))
        for suffix in (".ply", ".pcd", ".npz")
    ),
    _convert("a rig to .urdf", "-rig.yaml", "r.urdf"),
    _convert("a rig to .py", "-rig.yaml", "r.launch.py"),
    _convert("a rig to .json", "-rig.yaml", "r.json"),
    _convert("a rig to a folder of nuscenes", "-rig.yaml", "nuscenes-rig"),
    *(_convert(f"a cloud to {suffix}", ".ply", f"c{suffix}") for suffix in (".las", ".laz", ".bin", ".pcd")),
    _convert("a capture to a folder of rosbag2", ".pcap", "bag"),
    _convert("a capture to a folder of rosbag2-mcap", ".pcap", "bag-mcap", "--to rosbag2-mcap"),
    _convert("a capture to .mcap", ".pcap", "m.mcap"),
    _convert("a capture to .bag", ".pcap", "m.bag"),
    _convert("a capture to firings", ".pcap", "firings.npz"),
    _convert("firings to .pcap", "-firings.npz", "again.pcap"),
    Command("view to .png", "view {0}-rig.yaml scene.yaml --size 320x200 --png v.png --quiet", ("v.png",)),
    Command("view to .html", "view {0}-rig.yaml --html v.html --quiet", ("v.html",)),
    Command("init", "init study --vehicle truck -o i/{0}.yaml --quiet", ("i",), once=True),
    Command("schema", "schema {1} -o schema.json", ("schema.json",)),
    Command(
        "sweep", "sweep {0}-plan.yaml -o s-{0} --workers 1 --quiet", tuple(f"s-{mark}" for mark in MARKS), resumes=True
    ),
)


def capture(mark: str) -> list[str]:
    """The command that makes the capture of a name, with its record."""
    return f"export {mark}-rig.yaml --scene scene.yaml --duration 0.2 -o {mark}.pcap --quiet".split()


def prepare(folder: Path) -> None:
    """The inputs of both names."""
    os.environ["SOURCE_DATE_EPOCH"] = "0"
    folder.chmod(0o755)
    (folder / "scene.yaml").write_text(SCENE)
    for i, mark in enumerate(MARKS):
        (folder / f"{mark}.yaml").write_text(STUDY.format(mark, i))
        (folder / f"{mark}-choices.yaml").write_text(CHOICES.format(mark, i))
        (folder / f"{mark}-plan.yaml").write_text(PLAN.format(mark, i))
        (folder / f"{mark}-rig.yaml").write_text(RIG.format(mark, 1.8 + i / 10))
        (folder / f"{mark}-two.yaml").write_text(TWO.format(mark, 1.8 + i / 10))
        for words in (
            capture(mark),
            f"decode {mark}.pcap -o {mark}.ply --quiet".split(),
            f"convert {mark}.pcap -o {mark}-firings.npz --quiet".split(),
        ):
            if (ended := run(words, folder)).code:
                raise SystemExit(ended.errors)
