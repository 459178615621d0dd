"""A few of each of the attacks of tools/attack.py that take little time, and what the names of things may not do."""

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from lidarcfg.report import to_json
from tests.command_line import lidarcfg

ROOT = Path(__file__).parents[1]
MODEL = "name: {0}\nbeams: {{elevation_deg: [-5, 5]}}\n"


@pytest.mark.skipif(sys.platform != "linux", reason="forks, kills and limits as Linux has them")
def test_attacks(tmp_path):
    """Exit 0 means that no attack had an effect."""
    groups = ("kills", "signals", "full_disk", "read_only", "two_writers", "server", "save")
    words = [sys.executable, str(ROOT / "tools/attack.py"), *groups, "--quick"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line for line in done.stdout.splitlines() if ": " in line]
    assert len(rows) == 30
    assert all(" 0 failures; " in row for row in rows)


@pytest.mark.skipif(sys.platform != "linux", reason="forks, kills and limits as Linux has them")
def test_attacks_find_planted_faults():
    """Each fault is reported, and nothing without it."""
    faults = ("written in place", "nothing cleaned up", "any Origin")
    words = [sys.executable, str(ROOT / "tools/attack_faults.py"), *faults]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_rows_of_a_group_that_was_stopped_are_kept(tmp_path, monkeypatch):
    """The second of three attacks is interrupted; then the group is done again, and after that no more."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    attack = importlib.import_module("attack")
    rows, made = tmp_path / "rows.jsonl", []

    def attacks(name, folder, given):
        for number in range(3):
            made.append(number)
            if made == [0, 1]:
                raise KeyboardInterrupt
            yield attack.Row(f"attack {number}", cases=len(made))

    monkeypatch.setattr(attack, "rows", attacks)
    words = ["names", "--rows", str(rows)]

    def kept():
        return [(row["what"], row["cases"], row["group"]) for row in map(json.loads, rows.read_text().splitlines())]

    with pytest.raises(KeyboardInterrupt):
        attack.main(words)
    assert kept() == [("attack 0", 1, "names")]
    for _ in range(2):
        assert attack.main(words) == 0
        assert made == [0, 1, 0, 1, 2]
        assert kept() == [("attack 0", 3, "names"), ("attack 1", 4, "names"), ("attack 2", 5, "names")]


@pytest.mark.parametrize(
    "name", ["\x1b[31mred\x07", "\x9b31m", "\u202egnp.exe\u2066", "a\u2028b", "a\rb", "a\nlidarcfg: b"]
)
def test_names_do_not_control_the_terminal(tmp_path, name):
    (tmp_path / "model.yaml").write_text(MODEL.format(json.dumps(name)))
    shown = lidarcfg("sensors", "show", tmp_path / "model.yaml").stdout
    assert "".join(c if c.isprintable() else repr(c)[1:-1] for c in name) in shown
    assert all(letter.isprintable() for letter in shown.replace("\n", ""))
    text = to_json({"name": name})
    assert json.loads(text) == {"name": name}
    assert all(letter.isprintable() for letter in text.replace("\n", ""))
