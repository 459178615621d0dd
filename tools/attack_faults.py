#!/usr/bin/env python3
"""Whether the attacks find what they are made for: faults are planted into lidarcfg, and each has to be reported.

    .venv/bin/python tools/attack_faults.py                   each fault, two minutes
    .venv/bin/python tools/attack_faults.py "no handlers"     some of them

Prints a line a fault. Exits with 1 if one was not found. Only this process and its forks have the faults. Linux only.
"""

import json
import multiprocessing
import os
import random
import re
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]

import attack_corners
import attack_inputs
import attack_names
import attack_save
import attack_server
import attack_writes
import numpy as np
from attack_commands import COMMANDS
from attack_run import Row
from attack_warm import Warm, attacked

import lidarcfg.cli as cli
from lidarcfg import aside, files
from lidarcfg.errors import one_line
from lidarcfg.view import page, server

SCHEMA = next(command for command in COMMANDS if command.name == "schema")  # the least that writes
TIMES = 12
Plant = Callable[[], object]
Rows = Callable[[Path, Plant], list[Row]]


def swap(old: Any, new: Any) -> None:
    """Another function in place of one, wherever it was imported."""
    for module in set(sys.modules.values()) - {sys.modules["__main__"]}:
        for name, value in list(getattr(module, "__dict__", {}).items()):
            if value is old:
                setattr(module, name, new)


@contextmanager
def in_place(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """A writer that does not write aside."""
    with open(path, mode) as file:
        yield file


REPLACING = files.replacing


@contextmanager
def swallowing(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """One to which errors of the system are nothing."""
    with suppress(OSError), REPLACING(path, mode) as file:
        yield file


@contextmanager
def littering(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """One that leaves a file of a library."""
    Path(path).with_suffix(".tmp").touch()
    with REPLACING(path, mode) as file:
        yield file


@contextmanager
def varying(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """One that writes what no other run does."""
    with REPLACING(path, mode) as file:
        yield file
        file.write(f"{os.getpid()}\n")


@contextmanager
def starting(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """One that starts a process, which goes on."""
    subprocess.Popen(["sleep", "5"])
    with REPLACING(path, mode) as file:
        yield file


def not_cleaning() -> None:
    """What was written aside is never removed."""
    for function in (files._remove, aside.remove_leftovers, aside.remove_own):
        swap(function, lambda *paths: None)


def failing(error: str) -> None:
    """Mistakes of the user's are bugs."""
    raise RuntimeError(error)


def leaving(error: str) -> None:
    """What is refused leaves an output."""
    Path("o.ply").touch()
    print(f"lidarcfg: {error}", file=sys.stderr)
    sys.exit(2)


class Raw(str):
    """A text in which nothing is escaped."""

    def replace(self, *given: Any) -> str:
        """Itself."""
        return self


@cache
def writes(name: str) -> Rows:
    """An attack on what is written."""

    def made(folder: Path, plant: Plant) -> list[Row]:
        (folder / "a").mkdir()
        os.environ["SOURCE_DATE_EPOCH"], attack_writes.ENDS_S = "0", 0.5

        def attack(warm: Warm) -> list[Row]:
            plant()
            return list(getattr(attack_writes, name)(warm, TIMES, random.Random(1)))

        return attacked(folder / "a", SCHEMA, attack)

    return made


def names(folder: Path, plant: Plant) -> list[Row]:
    """Names, in what takes little time."""
    plant()
    few = "a name", "the end of a script", "a terminal escape", "one more line", "the end of a text"
    attack_names.NAMES = {key: attack_names.NAMES[key] for key in few}
    attack_names.COMMANDS = (
        *(f"convert rig.yaml -o r{suffix}" for suffix in (".urdf", ".launch.py", ".json")),
        "sensors show model.yaml",
        "view rig.yaml --html v.html",
    )
    return list(attack_names.attacks(folder))


def pages(folder: Path, plant: Plant) -> list[Row]:
    """Pages from elsewhere, and odd requests."""
    plant()
    server._Handler.timeout = 1.0
    found = attack_server.attacks(True)
    return [next(found), next(found)]


def saving(folder: Path, plant: Plant) -> list[Row]:
    """What the page saves."""
    plant()
    return [next(attack_save.attacks(folder, 1, random.Random(1)))]


def pipes(folder: Path, plant: Plant) -> list[Row]:
    """Pipes that nobody writes to."""
    plant()
    attack_inputs.USES = {".las": attack_inputs.USES[".las"]}
    return [attack_inputs.of_all(folder, "pipes", attack_inputs.pipe)]


def terminals(folder: Path, plant: Plant) -> list[Row]:
    """Terminals that lack letters."""
    plant()
    attack_corners.TABLES = ("sensors show model.yaml",)
    (folder / "model.yaml").write_text(attack_names.MODEL.format(attack_corners.NAME))
    return [attack_corners.terminals(folder, False)]


FAULTS: dict[str, tuple[Rows, Plant]] = {
    "written in place": (writes("kills"), lambda: swap(files.replacing, in_place)),
    "nothing cleaned up": (writes("kills"), not_cleaning),
    "a library's file left": (writes("kills"), lambda: swap(files.replacing, littering)),
    "another result each run": (writes("kills"), lambda: swap(files.replacing, varying)),
    "a process left": (writes("signals"), lambda: swap(files.replacing, starting)),
    "no handlers": (writes("signals"), lambda: setattr(cli.Interrupts, "listen", lambda self: None)),
    "errors swallowed": (writes("full_disk"), lambda: swap(files.replacing, swallowing)),
    "a traceback": (writes("full_disk"), lambda: setattr(cli, "_fail", failing)),
    "read-only files replaced": (writes("read_only"), lambda: swap(files.check_not_read_only, lambda path: None)),
    "one name for two writers": (
        writes("two_writers"),
        lambda: swap(aside.name_beside, lambda path: path.with_name(f".{path.name}.00000000.part")),
    ),
    "names as they are": (names, lambda: swap(one_line, str)),
    "names in scripts": (
        names,
        lambda: setattr(page, "json", SimpleNamespace(dumps=lambda *given, **said: Raw(json.dumps(*given, **said)))),
    ),
    "any Origin": (pages, lambda: setattr(server, "HOST", re.compile(".*"))),
    "bodies of any size": (pages, lambda: setattr(server, "REQUEST_MAX", 1 << 60)),
    "no token": (
        saving,
        lambda: setattr(
            server,
            "secrets",
            SimpleNamespace(token_urlsafe=secrets.token_urlsafe, compare_digest=lambda one, other: True),
        ),
    ),
    "a bug for a mistake": (pipes, lambda: setattr(cli, "_fail", failing)),
    "an output of what is refused": (pipes, lambda: setattr(cli, "_fail", leaving)),
    "too much memory": (pipes, lambda: setattr(cli, "_check_environment", lambda: np.ones(150_000_000).any())),
    "letters that the terminal lacks": (terminals, lambda: setattr(cli, "io", SimpleNamespace(TextIOWrapper=bytes))),
}


def found(make: Rows, plant: Plant) -> list[str]:
    """What an attack says of a fault, which only a fork has."""
    fork = multiprocessing.get_context("fork")
    reader, writer = fork.Pipe(duplex=False)

    def attack() -> None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
        with tempfile.TemporaryDirectory() as folder:
            writer.send([wrong for row in make(Path(folder), plant) for wrong in row.failures])

    process = fork.Process(target=attack)
    process.start()
    writer.close()
    try:
        return list(reader.recv())
    except EOFError:  # it ended without saying so
        return []
    finally:
        process.join()


def main() -> int:
    """Plant each fault, and print what was found."""
    missed, plain = 0, dict[Rows, list[str]]()
    for name in sys.argv[1:] or FAULTS:
        make, plant = FAULTS[name]
        if make not in plain:
            plain[make] = found(make, lambda: None)
        nothing, said = plain[make], found(make, plant)
        missed += bool(nothing) or not said
        print(f"{name}: {f'{len(said)} failures, as {said[0][:150]!r}' if said else 'NOT FOUND'}", flush=True)
        for line in nothing:
            print(f"  without it: {line}", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
