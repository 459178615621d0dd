"""Names with HTML, terminal escapes, line breaks and bidirectional controls in whatever can be called something."""

import ast
import json
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.reliability.commands import run

pytestmark = pytest.mark.slow

NAMES = {
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
FILES = {
    "study.yaml": """
region: {{min_m: [-4, -4, 0], max_m: [4, 4, 2], cuboid_m: [0.5, 0.5, 0.25]}}
sensors:
  - {{name: roof, model: model.yaml, min: {{position_m: [0, 0, 1.8], rpy_deg: [0, 0, 0]}},
     max: {{position_m: [1, 1, 2], rpy_deg: [0, 0, 0]}}}}
detection: [{{name: {0}, size_m: [0.5, 0.5, 0.5], threshold: 2}}]
vehicle:
  boxes: [{{name: {0}, center_m: [2, 0, 0.5], size_m: [1, 1, 1]}}]
solver: {{method: abc, bees: 4, cycles: 2}}
""",
    "rig.yaml": "name: {0}\nsensors:\n  - {{name: roof, model: vlp-16, position_m: [0, 0, 1.9]}}\n",
    "model.yaml": "name: {0}\nbeams: {{elevation_deg: [-5, 5]}}\n",
    "scene.yaml": "name: {0}\nboxes: [{{name: {0}, center_m: [5, 0, 1], size_m: [1, 1, 2], reflectivity: 20}}]\n",
}
COMMANDS = (
    "convert rig.yaml -o r.urdf",
    "convert rig.yaml -o r.launch.py",
    "sensors show model.yaml",
    "evaluate {name} rig.yaml",
    "evaluate study.yaml rig.yaml -o e --json",
    "compare rig.yaml rig.yaml --study study.yaml -o c",
    "export rig.yaml --scene scene.yaml --duration 0.1 -o x.pcap --stats",
    "decode x.pcap --rig rig.yaml -o x.ply --stats",
    "decode x.pcap --sensor {name} -o y.ply",
    "view x.ply rig.yaml study.yaml scene.yaml --html v.html",
    "view cloud.npz rig.yaml --html w.html",
    "optimize study.yaml -o o",
)
FORMS = {  # what a file for another tool has, apart from names
    "r.urdf": lambda text: [(one.tag, sorted(one.attrib)) for one in ElementTree.fromstring(text).iter()],
    "r.launch.py": lambda text: [type(node) for node in ast.walk(ast.parse(text))],
}


class Page(HTMLParser):
    """What a page has that can act: a script of a name's, and attributes that run one."""

    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.acts = []

    def handle_starttag(self, tag, attrs):
        self.acts += [f"{tag} {key}" for key, _ in attrs if key.startswith("on")]
        self.acts += [f"{tag} {value}" for key, value in attrs if key == "src" and value == "x"]

    def handle_data(self, data):
        if self.lasttag == "script" and data.strip() == "alert(1)":
            self.acts.append("script")


def made(place, name, commands):
    """Run commands on files in which everything is called so; what each printed."""
    place.mkdir()
    for file, text in FILES.items():
        (place / file).write_text(text.format(json.dumps(name)))
    columns = {key: np.zeros(2, np.int64) for key in ("intensity", "ring", "time_ns", "sensor", "return_type")}
    np.savez(place / "cloud.npz", xyz=np.eye(3)[:2], sensor_names=np.array([name]), **columns)
    for words in commands:
        done = run([name if word == "{name}" else word for word in words.split()], place)
        assert done.code == 0 or done.refused, (words, done)
        yield words, (place / ".out").read_bytes().decode() + (place / ".errors").read_text()


@pytest.mark.parametrize("what", NAMES)
def test_names_are_text_wherever_they_are_shown(tmp_path, what, times):
    """On the terminal, in reports and pages, and in files for other tools."""
    commands = COMMANDS if times > 2 else COMMANDS[:5]
    list(made(tmp_path / "plain", "name", commands[:2]))
    for words, printed in made(tmp_path / "odd", NAMES[what], commands):
        assert not set(printed) & CONTROLS, words
        assert "\n" not in NAMES[what] or NAMES[what] not in printed, words
    for path in (tmp_path / "odd").rglob("*.html"):
        page = Page()
        page.feed(path.read_text())
        assert page.acts == [], path
    for file, form in FORMS.items():
        assert form((tmp_path / "odd" / file).read_text()) == form((tmp_path / "plain" / file).read_text())
