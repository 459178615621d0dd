"""Attacks on what is written: kill -9, signals, a full disk, what is read-only, two writers of one output."""

import os
import random
import shutil
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from attack_run import ROOT, Row, run, small_files, start, wait

MARKS = "markfirst", "marksecond"  # the name of the rig or study that a file is of
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
RIG = "name: {0}\nsensors:\n  - {{name: {0}, model: {2}, position_m: [0, 0, {1}]}}\n"
TIMED = "history.csv"  # holds seconds and no name: neither a mark nor the same bytes again
MESSAGE = 400  # bytes that a command must be able to say, on a disk however full
PROGRESS = {"o": {"rig.yaml", "search.npz"}, "f": {"search.npz"}}  # of a search that was killed


@dataclass(frozen=True)
class Command:
    """A command that writes, with {0} for one of the two names in its words."""

    words: str
    outputs: tuple[str, ...]

    @property
    def name(self) -> str:
        """How the table calls it."""
        output = self.outputs[-1]
        return self.words.split()[0] + ("" if "{0}" in output else f" to {Path(output).suffix or 'a folder'}")

    def typed(self, mark: str) -> list[str]:
        """Its words."""
        return self.words.format(mark, STREET).split()


STREET = ROOT / "data/scenes/street.yaml"
EXPORTED = "x.pcap.yaml", "t.npz", "x.pcap"
COMMANDS = (
    Command("optimize {0}.yaml -o o --quiet", ("o",)),
    Command("optimize {0}-choices.yaml -o f --quiet", ("f",)),
    Command("evaluate {0}.yaml {0}-rig.yaml -o e --quiet", ("e",)),
    Command("compare {0}-rig.yaml {0}-rig.yaml --study {0}.yaml -o c --quiet", ("c",)),
    Command("export {0}-rig.yaml --scene {1} --duration 0.1 -o x.pcap --truth t.npz --quiet", EXPORTED),
    Command("decode {0}.pcap -o d.ply --quiet", ("d.ply",)),
    Command("decode {0}.pcap -o d.npz --quiet", ("d.npz",)),
    Command("convert {0}-rig.yaml -o r.urdf --quiet", ("r.urdf",)),
    Command("convert {0}-rig.yaml -o nuscenes --quiet", ("nuscenes",)),
    Command("convert {0}.pcap -o bag --quiet", ("bag",)),
    Command("convert {0}.pcap -o m.mcap --quiet", ("m.mcap",)),
    Command("view {0}-rig.yaml {1} --size 320x200 --png v.png --quiet", ("v.png",)),
    Command("view {0}-rig.yaml --html v.html --quiet", ("v.html",)),
)


def prepare(folder: Path) -> None:
    """The inputs of both names."""
    os.environ["SOURCE_DATE_EPOCH"] = "0"
    folder.chmod(0o755)
    for i, mark in enumerate(MARKS):
        (folder / f"{mark}.yaml").write_text(STUDY.format(mark, i))
        (folder / f"{mark}-choices.yaml").write_text(CHOICES.format(mark, i))
        (folder / f"{mark}-rig.yaml").write_text(RIG.format(mark, 1.8 + i / 10, "vlp-16"))
        ended = run(f"export {mark}-rig.yaml --scene {STREET} --duration 0.2 -o {mark}.pcap --quiet".split(), folder)
        if ended.code:
            raise SystemExit(ended.errors)


Files = dict[str, bytes]


def contents(folder: Path, outputs: Sequence[str]) -> Files:
    """The bytes of the outputs that are there, with those in folders."""
    found: Files = {}
    for output in outputs:
        path = folder / output
        inside = sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []
        found |= {
            one.relative_to(folder).as_posix(): one.read_bytes()
            for one in inside
            if one.is_file() and one.suffix != ".part"
        }
    return found


def whose(name: str, data: bytes, known: Sequence[Files]) -> str:
    """Of which run a file is: by the mark in it, or by its bytes, or "other" if it is of neither."""
    if Path(name).name == TIMED:
        return "either"
    found = []
    for mark, files in zip(MARKS, known, strict=True):
        wide = mark.encode("utf-32-le")
        if data == files.get(name) or mark.encode() in data or wide in data or mark.encode() in unpacked(name, data):
            found.append(mark)
    return found[0] if len(found) == 1 else "either" if found else "other"


def unpacked(name: str, data: bytes) -> bytes:
    """The arrays of a compressed archive, in which no mark is seen."""
    import io
    import zipfile

    if not name.endswith(".npz"):
        return b""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return b"".join(archive.read(member) for member in archive.namelist()).replace(b"\0", b"")


def wrong(folder: Path, command: Command, known: Sequence[Files]) -> str:
    """What is wrong with the outputs: files of two runs, of none, or not all of one's."""
    files = contents(folder, command.outputs)
    of = {name: whose(name, data, known) for name, data in files.items()}
    runs = set(of.values()) - {"either"}
    if len(runs) > 1 or "other" in runs:
        return f"{command.name}: {of}"
    names, progress = {Path(name).name for name in files}, PROGRESS.get(command.outputs[0])
    complete = set(files) in (set(known[0]), set(known[1])) or names == progress
    return "" if complete else f"{command.name}: only {sorted(files)}"


def leftovers(folder: Path) -> str:
    """What is left beside the outputs."""
    return ", ".join(sorted(path.name for path in folder.rglob("*.part")))


@dataclass(frozen=True)
class Known:
    """What a command writes for each of the names, and how long that takes."""

    files: tuple[Files, Files]
    seconds: float


def learn(folder: Path, command: Command) -> Known:
    """Run the command for both names; the first one's outputs stay."""
    files, seconds = [], 0.0
    for mark in (*MARKS, MARKS[0]):
        clear(folder, command)
        ended = run(command.typed(mark), folder)
        if ended.code:
            raise SystemExit(f"{command.name}: {ended.errors}")
        files.append(contents(folder, command.outputs))
        seconds = ended.seconds
    return Known((files[0], files[1]), seconds)


def clear(folder: Path, command: Command) -> None:
    """Remove its outputs."""
    for output in command.outputs:
        path = folder / output
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def kills(folder: Path, commands: Sequence[Command], times: int, rng: random.Random) -> Iterator[Row]:
    """Kill -9 at random moments: what is there is all of one run; the next run leaves nothing else behind."""
    for command in commands:
        known, row, ended = learn(folder, command), Row(f"kill -9: {command.name}"), 0
        for _ in range(times):
            pid, began = start(command.typed(rng.choice(MARKS)), folder), time.monotonic()
            time.sleep(rng.uniform(0, 1.1 * known.seconds))
            os.kill(pid, signal.SIGKILL)
            ended += wait(pid, folder, began).code == 0
            row.add(wrong(folder, command, known.files))
        run(command.typed(MARKS[1]), folder)
        row.add(wrong(folder, command, known.files) or leftovers(folder))
        row.seen = f"{times - ended} were killed before they had ended"
        yield row


def signals(folder: Path, commands: Sequence[Command], times: int, rng: random.Random) -> Iterator[Row]:
    """TERM, INT and HUP at random moments: exit 130, or done; nothing is left behind."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        row = Row(f"{number.name} at random moments")
        for command in commands:
            known = learn(folder, command)
            for _ in range(times):
                pid, began = start(command.typed(rng.choice(MARKS)), folder), time.monotonic()
                time.sleep(rng.uniform(0.05, known.seconds))
                os.kill(pid, number)
                code = wait(pid, folder, began).code
                early = code == -number  # before the command had set its handler
                odd = "" if code in (0, 130) or early else f"{command.name}: exit {code}"
                row.add(odd or wrong(folder, command, known.files) or leftovers(folder))
        yield row


def full_disk(folder: Path, commands: Sequence[Command], times: int, rng: random.Random) -> Iterator[Row]:
    """Files that cannot grow beyond a size below what they need: one line, the old files whole."""
    row = Row("a full disk")
    for command in commands:
        known = learn(folder, command)
        largest = max(map(len, known.files[1].values()))
        for _ in range(times if largest > MESSAGE else 0):
            before = contents(folder, command.outputs)
            ended = run(command.typed(MARKS[1]), folder, small_files(rng.randrange(MESSAGE, largest)))
            files = contents(folder, command.outputs)
            searched = command.outputs[0] in PROGRESS and not wrong(folder, command, known.files)
            kept = files == before or searched
            odd = "" if kept else f"{command.name}: the old files are gone"
            row.add((ended.code and ended.not_refused) or odd or leftovers(folder))
    yield row


def read_only(folder: Path, commands: Sequence[Command], times: int, rng: random.Random) -> Iterator[Row]:
    """A folder that may not be written, and outputs that may not: one line, everything as it was."""
    folders, files = Row("a read-only folder"), Row("read-only outputs")
    for command in commands:
        known = learn(folder, command)
        one = folder / rng.choice(sorted(known.files[0]))
        one.chmod(0o444)
        before = contents(folder, command.outputs)
        ended = run(command.typed(MARKS[1]), folder)
        same = contents(folder, command.outputs) == before
        files.add(ended.not_refused or ("" if same else f"{command.name}: replaced some of it") or leftovers(folder))
        one.chmod(0o644)
        if os.getuid():
            folders.add(_in_sealed(folder, command))
    folders.seen = "" if os.getuid() else "not made: to root no folder is read-only"
    yield folders
    yield files


def _in_sealed(folder: Path, command: Command) -> str:
    """What is wrong after the command has written into a folder that it may not write."""
    sealed = folder / "sealed"
    sealed.mkdir(mode=0o555, exist_ok=True)
    words = [f"sealed/{word}" if word in command.outputs else word for word in command.typed(MARKS[1])]
    ended = run(words, folder)
    return ended.not_refused or (f"{command.name}: wrote {os.listdir(sealed)}" if os.listdir(sealed) else "")


def two_writers(folder: Path, commands: Sequence[Command], times: int, rng: random.Random) -> Iterator[Row]:
    """Two runs of one output at once: both end well, and what is there is all of one of them."""
    row = Row("two writers of one output")
    for command in commands:
        known = learn(folder, command)
        for _ in range(times):
            started = []
            for mark in MARKS:
                started.append((start(command.typed(mark), folder), time.monotonic()))
                time.sleep(rng.uniform(0, 0.3 * known.seconds))
            codes = [wait(pid, folder, began).code for pid, began in started]
            odd = "" if codes == [0, 0] else f"{command.name}: exits {codes}: {(folder / '.errors').read_text()[-200:]}"
            row.add(odd or wrong(folder, command, known.files) or leftovers(folder))
    yield row
