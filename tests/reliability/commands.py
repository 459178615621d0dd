"""Commands that write files, and how one is run: in a fork of a process that has loaded the libraries."""

import contextlib
import multiprocessing
import os
import re
import resource
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SECONDS = 10.0
MEGABYTES = 1000.0  # of a processor and of memory: a bad input is refused, or used, within both
HANGS_S = 300
MARKS = "first", "second"  # the rig or study that a file is of
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    ["lidarcfg.cli.main", "lidarcfg.report", "lidarcfg.viewer.page", "matplotlib.figure", "open3d"]
)
TIMES = re.compile(rb'(?<="seconds": )[-+\d.e]+|(?<=seconds</th><td>)[-+\d.e]+')  # that a run took

STUDY = """
region: {{min_m: [-4, -4, 0], max_m: [4, 4, 2], cuboid_m: [0.5, 0.5, 0.25]}}
sensors:
  - {{name: {0}, model: vlp-16, min: {{position_m: [0, 0, 1.8], rpy_deg: [-20, -20, 0]}},
     max: {{position_m: [1, 1, 2], rpy_deg: [20, 20, 0]}}}}
detection:
  - {{name: box, size_m: [0.5, 0.5, 0.5], threshold: 2}}
solver: {{method: abc, bees: 10, cycles: 40, seed: {1}}}
"""
SCENE = """name: box
ground: {z_m: 0, reflectivity: 12}
boxes: [{name: box, center_m: [5, 0, 1], size_m: [1, 1, 2], reflectivity: 20}]
"""
RIG = "name: {0}\nsensors:\n  - {{name: {0}, model: vlp-16, position_m: [0, 0, {1}]}}\n"


@dataclass(frozen=True)
class Command:
    """A command that writes, with {0} for one of the two marks in its words, and what it writes."""

    words: str
    outputs: tuple[str, ...]


def _export(output, more=()):
    words = "export {0}-rig.yaml --scene scene.yaml --duration 0.1 -o " + output
    return Command(words, (output.split()[0], f"{output.split()[0]}.yaml", *more))


BRIEF = {
    "export to .pcap": _export("x.pcap --truth t.npz", ("t.npz",)),
    "convert a rig": Command("convert {0}-rig.yaml -o r.urdf", ("r.urdf",)),
}
COMMANDS = BRIEF | {
    "evaluate": Command("evaluate {0}.yaml {0}-rig.yaml -o e", ("e",)),
    "compare": Command("compare {0}-rig.yaml {0}-rig.yaml --study {0}.yaml -o c", ("c",)),
    "export to .ply": _export("x.ply"),
    "export to .mcap": _export("x.mcap"),
    "export to KITTI": _export("kitti --to kitti-odometry"),
    "export to nuScenes": _export("nuscenes --to nuscenes"),
    "decode to .ply": Command("decode {0}.pcap -o d.ply", ("d.ply",)),
    "decode to .npz": Command("decode {0}.pcap -o d.npz", ("d.npz",)),
    "convert a cloud": Command("convert {0}.ply -o c.las", ("c.las",)),
    "convert a capture": Command("convert {0}.pcap -o bag", ("bag",)),
    "view to .png": Command("view {0}-rig.yaml scene.yaml --size 320x200 --png v.png", ("v.png",)),
    "view to .html": Command("view {0}-rig.yaml --html v.html", ("v.html",)),
}


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int  # negative: by this signal
    said: str  # on stderr, warnings aside
    busy_s: float
    megabytes: float

    @property
    def refused(self) -> bool:
        """Exit 2 and one line, in time and memory."""
        return self.code == 2 and self.said.startswith("lidarcfg: ") and "\n" not in self.said and self.in_bounds

    @property
    def in_bounds(self) -> bool:
        return self.busy_s <= SECONDS and self.megabytes <= MEGABYTES


def typed(command, mark):
    """The words of a command for one of the marks."""
    return [*command.words.format(mark).split(), "--quiet"]


def start(words, folder, *, file_bytes=None, kill_at=None, environment=None, encoding=None):
    """Start a command in a folder. `file_bytes`: no file may become larger. `kill_at`: kill -9 at this step of writing."""
    given = (list(map(str, words)), str(folder), file_bytes, kill_at, environment or {}, encoding)
    process = FORKS.Process(target=_child, args=given)
    process.start()
    return process


def ended(process, folder):
    """How it ends."""
    process.join(HANGS_S)
    if process.exitcode is None:
        process.kill()
        process.join()
    lines = (Path(folder) / ".errors").read_text(errors="replace").splitlines()
    said = "\n".join(line for line in lines if not line.startswith("lidarcfg: warning: "))
    usage = (Path(folder) / ".usage").read_text().split() if (Path(folder) / ".usage").exists() else ("0", "0")
    return Ended(process.exitcode, said, *map(float, usage))


def run(words, folder, **limits):
    """A command to its end."""
    return ended(start(words, folder, **limits), folder)


def _child(words, folder, file_bytes, kill_at, environment, encoding):
    os.chdir(folder)
    for name in (".steps", ".usage"):
        Path(name).unlink(missing_ok=True)
    for number, name in enumerate((os.devnull, ".out", ".errors")):
        os.dup2(os.open(name, os.O_RDWR | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False, encoding=encoding) for number in (1, 2))
    os.environ.update({"SOURCE_DATE_EPOCH": "0"} | environment)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler)
    if file_bytes is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
    if kill_at is not None:
        _watch(Path(folder).resolve(), kill_at)
    from lidarcfg.cli.main import main

    before = resource.getrusage(resource.RUSAGE_SELF)
    sys.argv = ["lidarcfg", *words]
    try:
        main()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        used = resource.getrusage(resource.RUSAGE_SELF)
        busy_s = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
        with contextlib.suppress(OSError):
            own = Path(f".usage-{os.getpid()}")  # two may end at once
            own.write_text(f"{busy_s} {used.ru_maxrss / 1024}")
            own.replace(".usage")


def _watch(folder, kill_at):
    """Count the steps of writing in a folder, in the file .steps; at the given one, kill this process."""
    log = os.open(".steps", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    steps = 0

    def hook(event, given):
        nonlocal steps
        if event not in ("open", "os.rename", "os.remove", "os.mkdir") or not isinstance(given[0], str | bytes | Path):
            return
        writes = event != "open" or (isinstance(given[2], int) and given[2] & (os.O_WRONLY | os.O_RDWR))
        if writes and Path(os.path.abspath(os.fsdecode(given[0]))).is_relative_to(folder):
            steps += 1
            os.write(log, b".")
            if steps == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)


def prepare(folder):
    """The inputs of both marks."""
    (folder / "scene.yaml").write_text(SCENE)
    for i, mark in enumerate(MARKS):
        (folder / f"{mark}.yaml").write_text(STUDY.format(mark, i))
        (folder / f"{mark}-rig.yaml").write_text(RIG.format(mark, 1.8 + i / 10))
        for words in (
            f"export {mark}-rig.yaml --scene scene.yaml --duration 0.2 -o {mark}.pcap --quiet",
            f"decode {mark}.pcap -o {mark}.ply --quiet",
        ):
            done = run(words.split(), folder)
            assert done.code == 0, done.said


def contents(folder, command):
    """The bytes of the outputs that are there, without the seconds of the run."""
    found = {}
    for output in command.outputs:
        path = folder / output
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file() and ".part" not in file.name:
                found[str(file.relative_to(folder))] = TIMES.sub(b"", file.read_bytes())
    return found


def leftovers(folder):
    """What is left beside the outputs."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.part"))


def clear(folder, command):
    """Remove the outputs."""
    for output in command.outputs:
        path = folder / output
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def seconds_of(words, folder, **limits):
    """How long a run takes, by the clock."""
    began = time.monotonic()
    done = run(words, folder, **limits)
    assert done.code == 0, done.said
    return time.monotonic() - began
