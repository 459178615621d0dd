"""Attacks from the corners: terminals without Unicode, paths that are no UTF-8, odd arrays, clocks, numbers, sizes."""

import os
import shutil
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from attack_commands import COMMANDS, MARKS, STUDY, capture, prepare
from attack_run import Ended, Row, run, run_in_terminal, warm_up

ENCODINGS = "ascii", "latin-1", "cp1252"
NAME = "Dach-ü→中😀"
FIRST = MARKS[0]
TABLES = (  # what prints tables, progress or lists
    "optimize {0}.yaml -o o",
    "optimize {0}.yaml -o o --resume o",
    "optimize {0}-choices.yaml -o f",
    "evaluate {0}.yaml {0}-rig.yaml",
    "evaluate {0}.yaml {0}-rig.yaml --tolerance 0.1",
    "evaluate {0}.yaml {0}-rig.yaml --baseline {0}-rig.yaml -o e",
    "evaluate {0}.yaml {0}-rig.yaml --json",
    "compare {0}-rig.yaml {0}-rig.yaml --study {0}.yaml -o c",
    "sweep {0}-plan.yaml -o s --dry-run",
    "sweep {0}-plan.yaml -o s --workers 1",
    "export {0}-rig.yaml --scene scene.yaml --duration 0.1 -o x.pcap --stats",
    "export {0}-rig.yaml --scene scene.yaml --duration 0.1 -o x.ply --stats",
    "decode {0}.pcap -o d.ply --stats",
    "decode {0}.pcap -o d.ply --rig {0}-rig.yaml --stats",
    "replay {0}.pcap 127.0.0.1:9 --speed 1000000",
    "convert {0}-rig.yaml -o r.urdf",
    "convert {0}.pcap -o bag",
    "view {0}-rig.yaml --html v.html",
    "validate {0}.yaml {0}-rig.yaml scene.yaml {0}-plan.yaml",
    "sensors list",
    "sensors show vlp-16",
    "init study -o i.yaml",
    "schema study",
    "completion bash",
    "--help",
    "evaluate --help",
    "evaluate none.yaml none.yaml",
)
ODD: dict[str, Any] = {
    "0-d": np.float64(3),
    "2-d": np.ones((2, 2)),
    "3-d": np.ones((2, 3, 4)),
    "complex": np.array([1j, 2]),
    "bool": np.array([True, False]),
    "text": np.array(["a", "b"]),
    "bytes": np.array([b"a", b"b"]),
    "a record": np.zeros(2, [("a", "f8")]),
    "empty": np.empty(0),
    "not finite": np.array([np.nan, np.inf]),
    "huge": np.array([1e308, -1e308]),
    "a date": np.array(["2020-01-01"], "M8[s]"),
    "large integers": np.array([2**63 - 1, -(2**63)], np.int64),
}
DIGITS = (
    "0x" + "f" * 5000,
    "9" * 5000,
    "-" + "9" * 5000,
    "1e" + "9" * 5000,
    "0." + "0" * 5000 + "1",
    "0o" + "7" * 5000,
)
RESOLUTIONS = 0, 1, 6, 9, 19, 20, 63, 127, 128, 129, 191, 192, 255


def attacks(folder: Path, quick: bool) -> Iterator[Row]:
    """All of them, in a folder of what they read."""
    prepare(folder)
    warm_up([words.format(FIRST) for words in TABLES[: 7 if quick else 18]], folder)
    clear(folder)
    for one in (paths, epochs, arrays, numbers, clocks, sizes):
        yield one(folder, quick)
    named(folder)
    yield terminals(folder, quick)


def checked(row: Row, what: str, ended: Ended, may_work: bool = True) -> None:
    """A case that ends well or in one line, in time and memory."""
    works = may_work and ended.code == 0 and not ended.unfit
    row.add("" if works else ended.not_refused and f"{what}: {ended.not_refused}")


def named(folder: Path) -> None:
    """Inputs with names that no small encoding has."""
    (folder / f"{FIRST}.yaml").write_text(STUDY.format(FIRST, 0).replace("name: box", f'name: "{NAME}"'))
    rig = f'name: "{NAME}"\nsensors:\n  - {{name: {FIRST}, model: vlp-16, position_m: [0, 0, 1.8]}}\n'
    (folder / f"{FIRST}-rig.yaml").write_text(rig)
    if (ended := run(capture(FIRST), folder)).code:  # whose record names the rig
        raise SystemExit(ended.errors)


def terminals(folder: Path, quick: bool) -> Row:
    """Every command that prints, where it is read as ASCII or Latin-1: it ends as ever, and a ? stands for the rest."""
    row = Row(f"terminals and pipes in {', '.join(ENCODINGS)}: every table")
    for words in TABLES[3:4] if quick else TABLES:
        ways = [(encoding, run) for encoding in ENCODINGS]
        for encoding, through in (*ways, (ENCODINGS[row.cases // 4 % 3], run_in_terminal)):
            clear(folder, keep="o" if "--resume" in words else "")
            ended = through(words.format(FIRST).split(), folder, encoding=encoding)
            said = (folder / ".out").read_bytes() + (folder / ".errors").read_bytes()
            odd = ended.code != 2 * ("none.yaml" in words) and f"exit {ended.code}: {said[-200:]!r}"
            fits = said and decodes(said, encoding) and b"Traceback" not in said
            row.add(odd or ("" if fits else f"{words}, {encoding}, {through.__name__}: {said[-200:]!r}"))
    return row


def decodes(said: bytes, encoding: str) -> bool:
    """Whether it is text in that encoding, and not that of another: these have no control characters above 127."""
    try:
        text = said.decode("utf-8" if encoding == "ascii" else encoding)  # click takes ASCII for a mistake
    except UnicodeDecodeError:
        return False
    return not any(0x80 <= ord(letter) < 0xA0 for letter in text)


def clear(folder: Path, keep: str = "") -> None:
    """Remove what the table commands write."""
    for name in {"o", "f", "e", "c", "s", "bag", "x.pcap", "x.pcap.yaml", "x.ply", "x.ply.yaml", "i.yaml"} - {keep}:
        path = folder / name
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def paths(folder: Path, quick: bool) -> Row:
    """Inputs, outputs and folders whose names are no UTF-8: they work, or one line says so."""
    row, odd = Row("paths with bytes that are no UTF-8"), os.fsdecode(b"\xff\xfe-\xe4")
    place = folder / odd
    place.mkdir()
    for path in folder.glob(f"{FIRST}*"):
        shutil.copy(path, place)
    for command in COMMANDS[:: 12 if quick else 1]:
        words = command.typed(FIRST)
        read = [os.path.join(odd, word) if word.startswith(FIRST) else word for word in words]
        names = {output.split("/")[0].split("-")[0] for output in command.outputs} | set(command.outputs)
        written = [os.path.join(odd, odd + word) if word.split("/")[0] in names else word for word in words]
        checked(row, f"{command.name}, read", run(read, folder))
        checked(row, f"{command.name}, written", run(written, folder))
    shutil.rmtree(place)
    return row


def epochs(folder: Path, quick: bool) -> Row:
    """A SOURCE_DATE_EPOCH that is no time."""
    row = Row("SOURCE_DATE_EPOCH that is none")
    for command in COMMANDS[:: 12 if quick else 1]:
        for epoch in ("abc", "-1", "1e9", "9" * 30, ""):
            ended = run(command.typed(FIRST), folder, partial(os.environ.__setitem__, "SOURCE_DATE_EPOCH", epoch))
            checked(row, f"{command.name}, {epoch!r}", ended, may_work=False)
    return row


def arrays(folder: Path, quick: bool) -> Row:
    """Each array of each .npz that we read as one of another shape or kind, or omitted; an .npy under that name."""
    row = Row(".npz with arrays of other shapes and kinds, or none")
    for words in ("optimize {0}.yaml -o o", "optimize {0}-choices.yaml -o f", "decode {0}.pcap -o d.npz"):
        run(words.format(FIRST).split(), folder)
    run(f"export {FIRST}-rig.yaml --scene scene.yaml --duration 0.1 -o x.pcap --truth t.npz".split(), folder)
    for source, words in (
        ("o/search.npz", "optimize {0}.yaml --resume o -o o2"),
        ("f/search.npz", "optimize {0}-choices.yaml --resume f -o f2"),
        ("d.npz", "convert d.npz -o d.las"),
        ("t.npz", "view x.pcap t.npz --html v.html"),
        (f"{FIRST}-firings.npz", "convert {0}-firings.npz -o again.pcap"),
    ):
        path = folder / source
        whole = path.read_bytes()
        with np.load(path) as archive:
            good = dict(archive)
        for number, key in enumerate(list(good)[:: 5 if quick else 1]):
            log = "search" in source  # which has no array that is not used
            step = 1 if log else 3  # of other files every third kind, in turns
            for what, odd in list(ODD.items())[number % step :: step]:
                np.savez(path, **good | {key: odd})
                alike = (odd.dtype.kind, odd.ndim) == (good[key].dtype.kind, good[key].ndim)
                ended = run(words.format(FIRST).split(), folder)
                checked(row, f"{source}, {key}: {what}", ended, may_work=alike or not log)
            np.savez(path, **{name: array for name, array in good.items() if name != key})
            checked(row, f"{source} without {key}", run(words.format(FIRST).split(), folder), may_work=not log)
        for odd in (np.ones(3), np.array([{}], object)):
            with open(path, "wb") as file:
                np.save(file, odd, allow_pickle=True)
            checked(row, f"{source}, an .npy", run(words.format(FIRST).split(), folder), may_work=False)
        path.write_bytes(whole)
    return row


def numbers(folder: Path, quick: bool) -> Row:
    """Numbers of thousands of digits in each kind of file."""
    row, path = Row("numbers of 5,000 digits"), folder / "digits.yaml"
    for text, words in (
        ("region: {{min_m: [{0}, -4, 0], max_m: [4, 4, 2], cuboid_m: [1, 1, 1]}}\nsensors: []\n", "optimize {1}"),
        ("name: r\nsensors: [{{name: a, model: vlp-16, position_m: [0, 0, {0}]}}]\n", "view {1} --html v.html"),
        ("name: m\nbeams: {{elevation_deg: [{0}, 5]}}\n", "sensors show {1}"),
        ("name: s\nground: {{z_m: {0}, reflectivity: 10}}\n", "validate {1}"),
        ("arc: {{speed_m_s: {0}, yaw_rate_deg_s: 1}}\n", "validate {1}"),
    ):
        for digits in DIGITS[:: 5 if quick else 1]:
            path.write_text(text.format(digits))
            small = digits.startswith("0.0")  # is a number
            checked(row, f"{digits[:4]}: {words}", run(words.format("", path).split(), folder), may_work=small)
    return row


def clocks(folder: Path, quick: bool) -> Row:
    """The units of time that a pcapng may name, to the least and the largest."""
    row, path = Row("pcapng with any unit of time"), folder / "a.pcapng"
    frames = (folder / f"{FIRST}.pcap").read_bytes()[24:]
    size = struct.unpack("<I", frames[8:12])[0]
    frame = frames[16 : 16 + size]

    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        length = struct.pack("<I", len(body) + 12)
        return struct.pack("<I", kind) + length + body + length

    for resolution in RESOLUTIONS:
        for ticks in (0, 1, 2**63, 2**64 - 1):
            option = struct.pack("<HHB3xHH", 9, 1, resolution, 0, 0)
            packet = struct.pack("<IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, size, size) + frame
            section = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
            path.write_bytes(
                block(0x0A0D0D0A, section) + block(1, struct.pack("<HHI", 1, 0, 0) + option) + block(6, packet)
            )
            for words in ("decode {0} -o d.ply --quiet", "convert {0} -o m.mcap --quiet")[: 1 if quick else 2]:
                checked(row, f"{resolution}, {ticks}: {words}", run(words.format(path).split(), folder))
    return row


def sizes(folder: Path, quick: bool) -> Row:
    """Rigs, sensors, pictures and poses beyond what anybody has: refused, or done within the same time and memory."""
    row = Row("beams, sensors, pixels, poses by the thousand and million")
    made: dict[str, tuple[Callable[[Path], object], Sequence[str]]] = {
        "beams-10000.yaml": (_beams(10_000), ("sensors show {0}", "view {1} --html v.html", "evaluate {2} {1}")),
        "beams-100000.yaml": (_beams(100_000), ("sensors show {0}", "view {1} --html v.html", "evaluate {2} {1}")),
        "sensors-1000.yaml": (_sensors(1000), ("validate {0}", "convert {0} -o r.urdf", "evaluate {2} {0}")),
        "sensors-20000.yaml": (_sensors(20_000), ("validate {0}", "convert {0} -o r.urdf", "evaluate {2} {0}")),
        "poses.tum": (_poses, ("export {3} --scene scene.yaml --duration 0.1 -o x.pcap --trajectory {0}",)),
        "none.yaml": (Path.touch, ("view {3} --png p.png --size 16384x16384", "view {3} --png p.png --size 7680x4320")),
    }
    study, rig = folder / f"{FIRST}.yaml", folder / f"{FIRST}-rig.yaml"
    for name, (make, commands) in list(made.items())[:: 5 if quick else 1]:
        make(path := folder / name)
        of = folder / f"of-{name}"
        of.write_text(f"name: r\nsensors:\n  - {{name: a, model: {name}, position_m: [0, 0, 1.8]}}\n")
        for words in commands:
            checked(row, f"{name}: {words.split()[0]}", run(words.format(path, of, study, rig).split(), folder))
        path.unlink()
    return row


def _beams(count: int) -> Callable[[Path], object]:
    angles = ", ".join(f"{angle:.6f}" for angle in np.linspace(-60, 60, count))
    return lambda path: path.write_text(f"name: m\nbeams: {{elevation_deg: [{angles}]}}\n")


def _sensors(count: int) -> Callable[[Path], object]:
    lines = [f"  - {{name: s{i}, model: vlp-16, position_m: [0, 0, 1.8]}}" for i in range(count)]
    return lambda path: path.write_text("name: r\nsensors:\n" + "\n".join(lines) + "\n")


def _poses(path: Path) -> None:
    path.write_text("".join(f"{i / 100} {i / 1000} 0 0 0 0 0 1\n" for i in range(1_000_000)))
