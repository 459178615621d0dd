"""Attacks by what is read: files without an end or that unpack to gigabytes, and those of another kind."""

import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from attack_run import ROOT, Row, run

STUDY = ROOT / "data/studies/liu2018-2x16.yaml"
RIG, STREET = ROOT / "data/rigs/roof.yaml", ROOT / "data/scenes/street.yaml"
EXPORT = f"export {RIG} --scene {STREET} --duration 0.1 -o o.pcap --quiet"
USES = {  # by suffix, the commands that read such a file
    ".yaml": (
        f"evaluate {{0}} {RIG}",
        f"evaluate {STUDY} {{0}}",
        f"export {RIG} --scene {{0}} --duration 0.1 -o o.pcap",
        f"{EXPORT} --trajectory {{0}}",
        "sensors show {0}",
        "optimize {0} -o o.d",
        "sweep {0} -o o.d --quiet",
        "validate {0}",
        "view {0} --png o.png",
    ),
    ".json": ("convert {0} -o o.urdf",),
    ".npz": ("view {0} --png o.png", "convert {0} -o o.las"),
    ".pcap": ("decode {0} -o o.ply", "decode {0} --from 1 -o o.ply", "replay {0} 127.0.0.1:9"),
    ".pcapng": ("decode {0} -o o.ply", "convert {0} -o o.mcap"),
    ".ply": ("view {0} --png o.png", f"{EXPORT} --vehicle {{0}}"),
    ".pcd": ("view {0} --png o.png",),
    ".las": ("convert {0} -o o.ply",),
    ".laz": ("convert {0} -o o.ply",),
    ".bin": ("convert {0} -o o.ply",),
    ".tum": (f"{EXPORT} --trajectory {{0}}",),
    ".stl": (f"{EXPORT} --vehicle {{0}}",),
    ".obj": (f"{EXPORT} --vehicle {{0}}",),
    ".glb": (f"{EXPORT} --vehicle {{0}}",),
}
SPARSE = 10**10
HEADS = {  # what a file begins with that says it goes on for gigabytes
    ".ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 800000000\nproperty float x\nproperty float y\n"
    b"property float z\nend_header\n",
    ".pcd": b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 800000000\nHEIGHT 1\n"
    b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 800000000\nDATA binary\n",
    ".pcap": bytes.fromhex("d4c3b2a1020004000000000000000000ffff000001000000"),
    ".yaml": b"name: a\nsensors: [",
    ".npz": b"PK\x03\x04",
}


def pipe(path: Path) -> None:
    """A pipe that nobody writes to."""
    os.mkfifo(path)


def device(path: Path) -> None:
    """A device without an end."""
    path.symlink_to("/dev/zero")


def sparse(path: Path) -> None:
    """Ten gigabytes that take no room."""
    with open(path, "wb") as file:
        file.truncate(SPARSE)


def headed(path: Path) -> None:
    """The same behind the first bytes of such a file."""
    with open(path, "wb") as file:
        file.write(HEADS.get(path.suffix, b""))
        file.truncate(SPARSE)


def of_all(folder: Path, what: str, make: Callable[[Path], None]) -> Row:
    """Every command of every suffix, with a file made so."""
    row = Row(what)
    for suffix, commands in USES.items():
        path = folder / f"a{suffix}"
        path.unlink(missing_ok=True)
        make(path)
        for words in commands:
            ended = run(words.format(path).split(), folder)
            row.add(ended.not_refused and f"{suffix}, {words.split()[0]}: {ended.not_refused}")
            check_nothing(row, folder)
        path.unlink()
    return row


def check_nothing(row: Row, folder: Path) -> None:
    """A refused command leaves no output."""
    for path in folder.glob("[.]?*.part"):
        row.failures.append(f"{path.name} is left")
    for path in folder.glob("o.*"):
        row.failures.append(f"{path.name} is there")
        path.unlink()


def bombs(folder: Path, quick: bool) -> Iterator[Row]:
    """Files without an end, and files that unpack to gigabytes."""
    yield of_all(folder, "a pipe that nobody writes to, under each suffix", pipe)
    yield of_all(folder, "/dev/zero under each suffix", device)
    yield of_all(folder, "a sparse file of 10 GB under each suffix", sparse)
    if not quick:
        yield of_all(folder, "the same behind the beginning of such a file", headed)
    row = Row("archives and texts that become gigabytes")
    for name, make in MADE.items():
        path = folder / name
        make(path)
        for words in USES[path.suffix]:
            ended = run(words.format(path).split(), folder)
            row.add(ended.not_refused and f"{name}, {words.split()[0]}: {ended.not_refused}")
            check_nothing(row, folder)
        path.unlink()
    yield row


def _archive(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for key in ("xyz", "object_names"):
            with archive.open(f"{key}.npy", "w", force_zip64=True) as file:
                head = {"descr": "<f8", "fortran_order": False, "shape": (10**8, 3)}
                np.lib.format.write_array_header_1_0(file, head)
                for _ in range(600):
                    file.write(bytes(4 * 10**6))


def _announced(path: Path) -> None:
    """An array of petabytes, of which nothing is there."""
    with zipfile.ZipFile(path, "w") as archive, archive.open("xyz.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**14, 3)})


def _text(line: str, size: int) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        path.write_text(line * (size // len(line)))

    return make


def _aliases(path: Path) -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    path.write_text("\n".join(lines))


MADE: dict[str, Callable[[Path], None]] = {
    "large.yaml": _text("- {a: 1, b: [1, 2, 3]}\n", 10**8),
    "many.yaml": _text("- {a: 1, b: [1, 2, 3]}\n", 6 * 10**7),
    "deep.yaml": _text("[", 10**7),
    "dashes.yaml": _text("- ", 10**6),
    "aliases.yaml": _aliases,
    "digits.yaml": _text("9", 10**7),
    "unpacks.npz": _archive,
    "announced.npz": _announced,
    "lines.tum": _text("0 0 0 0 0 0 0 1\n", 10**8),
    "long.obj": _text("v 0 0 0\n", 6 * 10**8),
}


def liars(folder: Path, quick: bool) -> Iterator[Row]:
    """The content of one kind under the suffix of another."""
    row, sources = Row("the content of one kind under the suffix of another"), folder / "sources"
    sources.mkdir()
    made = [EXPORT.replace("o.pcap", "sources/a.pcap")]
    made += [f"decode sources/a.pcap -o sources/a{suffix} --quiet" for suffix in (".ply", ".pcd", ".npz")]
    for words in made:
        if (ended := run(words.split(), folder)).code:
            raise SystemExit(ended.errors)
    shutil.copy(RIG, sources / "a.yaml")
    (sources / "a.tum").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    (sources / "a.png").write_bytes((ROOT / "docs/view.png").read_bytes())
    (sources / "a.bin").write_bytes(os.urandom(16_001))
    for source in sorted(sources.iterdir()):
        for suffix, commands in USES.items():
            if suffix[:5] == source.suffix:
                continue
            path = folder / f"a{suffix}"
            shutil.copy(source, path)
            for words in commands[: 1 if quick else None]:
                ended = run(words.format(path).split(), folder)
                fits = ended.code == 0 and not ended.unfit  # a capture is known by its first bytes, JSON is YAML
                row.add("" if fits else ended.not_refused and f"{source.suffix} as {suffix}: {ended.not_refused}")
                for made in folder.glob("o.*"):
                    made.unlink()
            path.unlink()
    yield row
