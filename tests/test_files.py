"""Files that come with the package."""

from pathlib import Path

import pytest

import lidarcfg
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, shipped

ROOT = Path(__file__).parents[1]


def test_examples_are_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert example("data/studies/sedan.yaml") == ROOT / "data/studies/sedan.yaml"
    assert lidarcfg.load_study("data/studies/sedan.yaml").name == "sedan"
    assert len(lidarcfg.load_rig("data/rigs/roof.yaml").mounts) > 0
    assert "tree_1" in lidarcfg.load_scene("data/scenes/street.yaml").names  # with the mesh beside it


def test_a_file_of_ones_own_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mine = tmp_path / "data/studies/sedan.yaml"
    mine.parent.mkdir(parents=True)
    mine.write_text("region: 3\n")
    with pytest.raises(ConfigError, match=r"^data/studies/sedan\.yaml:1:1: region: "):
        lidarcfg.load_study("data/studies/sedan.yaml")


def test_what_is_no_example_is_named_as_it_was_typed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("data/studies/none.yaml", "data", "studies/sedan.yaml", "data/../README.md"):
        with pytest.raises(ConfigError) as error:
            lidarcfg.load_study(name)
        assert str(error.value).startswith(f"{name}: ")


def test_the_package_finds_its_own(tmp_path, monkeypatch):
    """In the repository beside it; installed, inside it."""
    assert shipped("sensors") == ROOT / "sensors"
    (tmp_path / "_sensors").mkdir()
    monkeypatch.setattr("lidarcfg.files.__file__", str(tmp_path / "files.py"))
    assert shipped("sensors") == tmp_path / "_sensors"
