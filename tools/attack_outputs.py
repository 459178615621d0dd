"""What is on the disk after an attack: of which run each output is, and whether all of them are of one run.

A file is of a run if it has the bytes of that run's, but for the seconds that it took. Only what a search that was
stopped has left is known by its form and by the name in it.
"""

import io
import json
import re
import shutil
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from attack_commands import MARKS, Command

SECONDS = re.compile(rb'(?<="seconds": )[-+\d.e]+|(?<=seconds</th><td>)[-+\d.e]+')  # of JSON and of reports
OWN = {".out", ".errors", ".opened"}  # what the attacks write beside the outputs
Files = dict[str, bytes]


@dataclass
class Known:
    """What a command writes for each of the names, how long that takes, and when its first file is begun."""

    files: tuple[Files, Files]
    seconds: float
    writes_s: float  # from the start to the first file
    steps: int  # of the writing, from there on
    beside: frozenset[str]  # what was there before: the inputs


def contents(folder: Path, command: Command) -> Files:
    """The bytes of the outputs that are there, with those in folders, without the seconds of the runs."""
    return {
        name: untimed(name, (folder / name).read_bytes())
        for name in _files(folder)
        if _is_output(name, command) and not name.endswith(".part")
    }


def _files(folder: Path) -> list[str]:
    found = sorted(path for path in folder.rglob("*") if path.is_file() and ".part/" not in path.as_posix())
    return [path.relative_to(folder).as_posix() for path in found]


def _is_output(name: str, command: Command) -> bool:
    return any(name == output or name.startswith(f"{output}/") for output in command.outputs)


def untimed(name: str, data: bytes) -> bytes:
    """A file without the seconds that its run took; one that is not whole as it is."""
    with suppress(ValueError, OSError, zipfile.BadZipFile):  # pyarrow's own errors are ValueErrors
        return _without_seconds(Path(name).name, data)
    return data


def _without_seconds(name: str, data: bytes) -> bytes:
    import pyarrow.parquet

    if name == "search.npz":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return b"".join(archive.read(one) for one in archive.namelist() if one != "seconds.npy")
    if name in ("history.csv", "table.csv"):  # where they are the last column
        return b"".join(line.rpartition(b",")[0] + line[-1:] for line in data.splitlines(keepends=True))
    if name == "table.parquet":
        return json.dumps(pyarrow.parquet.read_table(io.BytesIO(data)).drop_columns("seconds").to_pylist()).encode()
    return SECONDS.sub(b"", data) if name.endswith((".json", ".html")) else data


def whose(name: str, data: bytes, command: Command, known: Sequence[Files]) -> str:
    """Of which run a file is, "either", or "other" if it is of neither: it is torn then."""
    found = [mark for mark, files in zip(MARKS, known, strict=True) if data == files.get(name)]
    if not found and command.stops and is_whole(name, data):
        inside = name.encode() + data.replace(b"\0", b"")  # texts of arrays have four bytes a letter
        found = [mark for mark in MARKS if mark.encode() in inside]
        return found[0] if len(found) == 1 else "either"
    return found[0] if len(found) == 1 else "either" if found else "other"


ENDS: dict[str, Callable[[bytes], bool]] = {  # of a file that is whole, as bytes without seconds
    ".png": lambda data: data.endswith(b"IEND\xaeB`\x82"),
    ".html": lambda data: data.rstrip().endswith(b"</html>"),
    ".json": lambda data: data.endswith(b"}\n"),
    ".csv": lambda data: data.endswith(b"\n"),
    ".yaml": lambda data: data.endswith(b"\n") and data.count(b"[") == data.count(b"]"),
    ".npz": lambda data: not data.startswith(b"PK"),  # it was unpacked, with its checksums
    ".parquet": lambda data: data.startswith(b"["),  # it was read
}


def is_whole(name: str, data: bytes) -> bool:
    """Whether a file of a search that was stopped ends as such a file does."""
    return ENDS[Path(name).suffix](data)


def wrong(folder: Path, command: Command, known: Known, mark: str = "") -> str:
    """What is wrong with the outputs: files of two runs, of none, not all of one's.

    With a mark, all that is not as that name's undisturbed run left it.
    """
    files = contents(folder, command)
    expected = known.files[MARKS.index(mark)] if mark else {}
    if mark:
        odd = sorted(name for name in {*files, *expected} if files.get(name) != expected.get(name))
        return f"{command.name}: differ from an undisturbed run's: {odd}" if odd else ""
    of = {name: whose(name, data, command, known.files) for name, data in files.items()}
    runs = set(of.values()) - {"either"}
    if "other" in runs or len(runs) > 1:
        return f"{command.name}: {of}"
    some = command.resumes or not files or {Path(name).name for name in files} == command.progress
    fits = some or any(_names(files, command) == _names(one, command) for one in known.files)
    return "" if fits else f"{command.name}: only {sorted(files)}"


def _names(files: Files, command: Command) -> set[str]:
    """The outputs, without the folders of a front's points: a search that was stopped has other points."""
    return {name for name in files if not (command.stops and "/points/" in name)}


def strangers(folder: Path, command: Command, known: Known) -> str:
    """Files that are neither inputs nor outputs nor written aside, such as another library's temporary ones."""
    names = {name for name in _files(folder) if not name.endswith(".part") and not _is_output(name, command)}
    return ", ".join(sorted(names - known.beside - OWN))


def leftovers(folder: Path) -> str:
    """What is left beside the outputs."""
    return ", ".join(sorted(path.name for path in folder.rglob("*.part")))


def clear(folder: Path, command: Command, parts: bool = True) -> None:
    """Remove its outputs; what is beside them, in a folder of its own, stays without `parts`."""
    for output in command.outputs:
        path = folder / output
        if parts or not path.is_dir():
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
            continue
        for one in path.iterdir():
            if one.suffix != ".part":
                one.unlink()
