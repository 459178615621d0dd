"""Attacks by names: HTML, terminal escapes, newlines and bidirectional controls in whatever can be called something."""

import ast
import json
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from attack_run import Row, run, warm_up

NAMES = {
    "a name": "name",
    "a script": "<script>alert(1)</script>",
    "an attribute": "\"' onmouseover=alert(1) x='\"",
    "an image": '"><img src=x onerror=alert(1)>',
    "the end of a script": "</script><svg onload=alert(1)>",
    "a terminal escape": "\x1b[31;1mred\x1b]0;title\x07\x1b[2J",
    "the same in one byte": "\x9b31mred",
    "lines": "one\r\ntwo\x0b\x0c\u2028three",
    "one more line": "one\nlidarcfg: two",
    "the end of a text": "\\",
    "bidirectional controls": "\u202egnp.exe\u2066\u200f",
    "markup of tables": "[bold]b[/bold] $x^2$ {{ 7*7 }} %(a)s",
}
CONTROLS = {chr(i) for i in (*range(9), *range(11, 32), *range(127, 160))} | set("\u2028\u2029\u200e\u200f\u061c")
CONTROLS |= {chr(i) for i in (*range(0x202A, 0x202F), *range(0x2066, 0x206A))}
STUDY = """
region: {{min_m: [-4, -4, 0], max_m: [4, 4, 2], cuboid_m: [0.5, 0.5, 0.25]}}
sensors:
  - {{name: roof, model: model.yaml, min: {{position_m: [0, 0, 1.8], rpy_deg: [0, 0, 0]}},
     max: {{position_m: [1, 1, 2], rpy_deg: [0, 0, 0]}}}}
detection:
  - {{name: {0}, size_m: [0.5, 0.5, 0.5], threshold: 2}}
vehicle:
  boxes: [{{name: {0}, center_m: [2, 0, 0.5], size_m: [1, 1, 1]}}]
solver: {{method: abc, bees: 4, cycles: 2}}
"""
RIG = "name: {0}\nsensors:\n  - {{name: roof, model: {1}, position_m: [0, 0, 1.9]}}\n"
MODEL = "name: {0}\nbeams: {{elevation_deg: [-5, 5]}}\n"
SCENE = "name: {0}\nboxes: [{{name: {0}, center_m: [5, 0, 1], size_m: [1, 1, 2], reflectivity: 20}}]\n"
COMMANDS = (
    "optimize study.yaml -o o",
    "evaluate study.yaml rig.yaml -o e --json",
    "evaluate {file} rig.yaml -o f",
    "compare rig.yaml rig.yaml --study study.yaml -o c",
    "export rig.yaml --scene scene.yaml --duration 0.1 -o x.pcap --stats",
    "decode x.pcap --rig rig.yaml -o x.ply --stats",
    "decode x.pcap --sensor {name} -o y.ply",
    "view x.ply rig.yaml study.yaml scene.yaml --html v.html",
    "view cloud.npz rig.yaml --html w.html",
    "convert cloud.npz -o z.las",
    "convert rig.yaml -o r.urdf",
    "convert rig.yaml -o r.launch.py",
    "convert rig.yaml -o r.json",
    "sensors show model.yaml",
    "evaluate study.yaml model-rig.yaml",
    "evaluate {name} rig.yaml",
    "view {name}",
)


FORMS: dict[str, Callable[[str], list[Any]]] = {  # what stays of a file whatever names are in it
    "r.urdf": lambda text: [(one.tag, sorted(one.attrib)) for one in ElementTree.fromstring(text).iter()],
    "r.launch.py": lambda text: [type(node) for node in ast.walk(ast.parse(text))],
    "r.json": lambda text: sorted(json.loads(text)),
}


def form(path: Path) -> list[Any]:
    """What a file for another tool has, apart from names; nothing if that tool cannot read it."""
    try:
        return FORMS[path.name](path.read_text())
    except (SyntaxError, ElementTree.ParseError, ValueError):
        return []


def cloud(name: str) -> dict[str, np.ndarray]:
    """A cloud of two points of a sensor that is called so, as a file that another wrote may have it."""
    columns = {key: np.zeros(2, np.int64) for key in ("intensity", "ring", "time_ns", "sensor", "return_type")}
    return columns | {"xyz": np.eye(3)[:2], "sensor_names": np.array([name])}


class Page(HTMLParser):
    """What a page has that can act: its scripts, and the attributes that run one."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.acts: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """An image without data of its own, or an attribute of events."""
        self.acts += [f"{tag} {key}" for key, _ in attrs if key.startswith("on")]
        self.acts += [f"{tag} {value}" for key, value in attrs if key == "src" and value == "x"]

    def handle_data(self, data: str) -> None:
        """A script of its own that is a payload's."""
        if self.lasttag == "script" and data.strip() == "alert(1)":
            self.acts.append("script")


def attacks(folder: Path) -> Iterator[Row]:
    """Each name everywhere at once, through every command that shows names."""
    tools, pages, terminal = (
        Row("names in files for other tools: URDF, Python, JSON"),
        Row("HTML in names: reports and pages"),
        Row("escapes, lines, controls in names: what is printed"),
    )
    for what, name in NAMES.items():
        place = folder / what.replace(" ", "-")
        place.mkdir()
        quoted = json.dumps(name)
        for file, text in (("study.yaml", STUDY), ("scene.yaml", SCENE), ("model.yaml", MODEL)):
            (place / file).write_text(text.format(quoted))
        (place / "rig.yaml").write_text(RIG.format(quoted, "vlp-16"))
        (place / "model-rig.yaml").write_text(RIG.format(quoted, "model.yaml"))
        called = place / f"{name.replace('/', '_')}.yaml"  # a study is called as its file
        called.write_text((place / "study.yaml").read_text())
        np.savez(place / "cloud.npz", **cloud(name))
        if what == "a name":
            warm_up([words for words in COMMANDS if "{" not in words], place)
        for words in COMMANDS:
            typed = [name if word == "{name}" else called.name if word == "{file}" else word for word in words.split()]
            ended = run(typed, place)
            odd = "" if ended.code == 0 else ended.not_refused
            printed = (place / ".out").read_bytes().decode() + ended.errors
            found = sorted(set(printed) & CONTROLS) or ([name] if "\n" in name and name in printed else [])
            terminal.add((odd and f"{what}, {words}: {odd}") or (f"{what}, {words}: prints {found}" if found else ""))
        for page in place.rglob("*.html"):
            parser = Page()
            parser.feed(page.read_text())
            pages.add(f"{what}: {page.name} has {parser.acts}" if parser.acts else "")
        for file in FORMS:
            same = form(place / file) == form(folder / "a-name" / file) != []
            tools.add("" if same else f"{what}: {file} has another form")
    yield pages
    yield terminal
    yield tools
