"""What is on the disk after an attack: whose each output is, and whether all of them are of one run."""

import io
import json
import shutil
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from attack_commands import MARKS, Command

TIMED = "history.csv"  # holds seconds and no name: neither a mark nor the same bytes again
Files = dict[str, bytes]


@dataclass
class Known:
    """What a command writes for each of the names, how long that takes, and when its first file is begun."""

    files: tuple[Files, Files]
    seconds: float
    writes_s: float = 0.0


def contents(folder: Path, command: Command) -> Files:
    """The bytes of the outputs that are there, with those in folders."""
    found: Files = {}
    for output in command.outputs:
        path = folder / output
        inside = sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []
        for one in inside:
            if one.is_file() and one.suffix != ".part":
                data = one.read_bytes()
                found[one.relative_to(folder).as_posix()] = _untimed(one.name, data) if command.resumes else data
    return found


def _untimed(name: str, data: bytes) -> bytes:
    """A sweep's file without the seconds that its runs took; one that is not whole as it is."""
    with suppress(ValueError, OSError):  # pyarrow's own errors are ValueErrors
        return _without_seconds(name, data)
    return data


def _without_seconds(name: str, data: bytes) -> bytes:
    import pyarrow.parquet

    if name == "result.json":
        return json.dumps(json.loads(data) | {"seconds": 0}).encode()
    if name == "table.csv":
        return b"\n".join(line.rpartition(b",")[0] for line in data.splitlines())
    if name == "table.parquet":
        return json.dumps(pyarrow.parquet.read_table(io.BytesIO(data)).drop_columns("seconds").to_pylist()).encode()
    return data


def whose(name: str, data: bytes, known: Sequence[Files]) -> str:
    """Of which run a file is: by its bytes, or by the mark in it, or "other" if it is of neither."""
    if Path(name).name == TIMED:
        return "either"
    found = [mark for mark, files in zip(MARKS, known, strict=True) if data == files.get(name)]
    if not found:
        inside = data + unpacked(name, data)
        found = [mark for mark in MARKS if mark.encode() in inside]
    return found[0] if len(found) == 1 else "either" if found else "other"


def unpacked(name: str, data: bytes) -> bytes:
    """The arrays of a compressed archive, in which no mark is seen."""
    if not name.endswith(".npz"):
        return b""
    with suppress(zipfile.BadZipFile), zipfile.ZipFile(io.BytesIO(data)) as archive:
        return b"".join(archive.read(member) for member in archive.namelist()).replace(b"\0", b"")
    return b""


def wrong(folder: Path, command: Command, known: Known, mark: str = "") -> str:
    """What is wrong with the outputs: files of two runs, of none, not all of one's; or any but this name's."""
    files = contents(folder, command)
    of = {name: whose(name, data, known.files) for name, data in files.items()}
    runs = set(of.values()) - {"either"}
    if "other" in runs or (len(runs) > 1 and not command.resumes) or (mark and runs - {mark}):
        return f"{command.name}: {of}"
    sets = [set(expected) for expected in known.files]
    if mark:
        return "" if set(files) == sets[MARKS.index(mark)] else f"{command.name}: has only {sorted(files)}"
    some = command.resumes or not files or {Path(name).name for name in files} == command.progress
    return "" if some or set(files) in sets else f"{command.name}: only {sorted(files)}"


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
