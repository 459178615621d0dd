"""Files that come with the package."""

from pathlib import Path

import pytest

import lidarcfg
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, replacing, shipped

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


def test_a_link_stays_and_its_target_is_replaced(tmp_path):
    """Whether the target is there yet or not; also through two links in other folders."""
    (tmp_path / "real").mkdir()
    (tmp_path / "links").mkdir()
    (tmp_path / "links/one").symlink_to("../real/file")
    (tmp_path / "two").symlink_to("links/one")
    for text in ("new", "newer"):
        with replacing(tmp_path / "two") as file:
            file.write(text)
        assert (tmp_path / "real/file").read_text() == text
    assert (tmp_path / "two").is_symlink()
    assert (tmp_path / "links/one").is_symlink()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "links", "one", "real", "two"]


def test_links_in_a_circle_are_refused(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OSError, match="symbolic links") as error, replacing(tmp_path / "a") as file:
        file.write("x")
    assert error.value.filename == str(tmp_path / "a")
    assert (tmp_path / "a").is_symlink()


def test_folders_that_are_missing_are_made(tmp_path):
    with replacing(tmp_path / "a/b/c.txt") as file:
        file.write("whole")
    assert (tmp_path / "a/b/c.txt").read_text() == "whole"
    assert [path.name for path in (tmp_path / "a/b").iterdir()] == ["c.txt"]
