"""Files that come with the package, and outputs that are there whole or not at all."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import lidarcfg
from lidarcfg.capture.ground_truth import TruthFile
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, remove_outdated, remove_temporary, replacing, replacing_folder, shipped

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
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
    with TruthFile(tmp_path / "d/e/truth.npz", ["roof"], ["ground"]) as truth:
        assert truth.save() == 0
    assert [path.name for path in (tmp_path / "d/e").iterdir()] == ["truth.npz"]


def test_a_path_that_is_no_unicode_can_be_named_in_a_text(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff")
    with replacing(path) as file:
        file.write(f"ü {path.name}")
    assert path.read_bytes() == "ü \\udcff".encode()


def test_a_read_only_file_stays(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("mine")
    path.chmod(0o444)
    with pytest.raises(PermissionError, match="read-only") as error, replacing(path) as file:
        file.write("theirs")
    assert error.value.filename == str(path)
    assert path.read_text() == "mine"
    assert [one.name for one in tmp_path.iterdir()] == ["a.txt"]


WRITER = """
import sys, time
from lidarcfg.files import replacing
with replacing(sys.argv[1]) as file:
    file.write("first")
    print("writes", flush=True)
    sys.stdin.read()
"""


def writer(path):
    """Another process that has begun to write, and goes on when its stdin is closed."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "writes\n"
    return process


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("old", [None, "old"])
def test_a_killed_run_leaves_the_old_file(tmp_path, old):
    """And what it wrote, under a hidden name; the next run writes as if nothing had been."""
    path = tmp_path / "a.txt"
    if old:
        path.write_text(old)
    process = writer(path)
    process.kill()
    process.communicate()
    (left,) = tmp_path.glob(".a.txt.*.part")
    assert names(tmp_path) == [left.name, *["a.txt"] * bool(old)]
    assert not old or path.read_text() == old
    with replacing(path) as file:
        file.write("new")
    assert path.read_text() == "new"


def test_a_file_is_on_the_disk_before_it_is_renamed(tmp_path, monkeypatch):
    done = []
    flush = os.fsync
    rename = os.replace
    monkeypatch.setattr(os, "fsync", lambda handle: done.append(os.fstat(handle).st_ino) or flush(handle))
    monkeypatch.setattr(os, "replace", lambda one, other: done.append("renamed") or rename(one, other))
    with replacing(tmp_path / "a.txt") as file:
        file.write("whole")
    assert done == [(tmp_path / "a.txt").stat().st_ino, "renamed"]


def test_two_writers_at_once_both_end_well(tmp_path):
    path = tmp_path / "a.txt"
    process = writer(path)
    with replacing(path) as file:
        file.write("second")
    assert path.read_text() == "second"
    process.communicate("")
    assert process.returncode == 0
    assert path.read_text() == "first"
    assert names(tmp_path) == ["a.txt"]


def test_a_folder_is_replaced_whole(tmp_path):
    """After an error, also in the second of the two renames, the old one stays."""
    for text, error in (("old", False), ("new", True), ("new", False)):
        before = sorted(tmp_path.rglob("*"))
        if error:
            with pytest.raises(ZeroDivisionError), replacing_folder(tmp_path / "bag", "*.yaml") as folder:
                folder.mkdir()
                1 / 0  # noqa: B018
            with pytest.raises(OSError, match="bag"), replacing_folder(tmp_path / "bag", "*.yaml"):
                pass
            assert sorted(tmp_path.rglob("*")) == before
            continue
        with replacing_folder(tmp_path / "bag", "*.yaml") as folder:
            folder.mkdir()
            (folder / f"{text}.yaml").touch()
        assert sorted(tmp_path.rglob("*")) == [tmp_path / "bag", tmp_path / f"bag/{text}.yaml"]


def test_a_folder_with_a_read_only_file_stays(tmp_path):
    deep = tmp_path / "a/sequences/00/poses.txt"
    deep.parent.mkdir(parents=True)
    deep.write_text("old")
    deep.chmod(0o444)
    with (
        pytest.raises(OSError, match=r"poses\.txt"),
        replacing_folder(tmp_path / "a", "sequences") as folder,
    ):
        folder.mkdir()
    assert (names(tmp_path), deep.read_text()) == (["a"], "old")


def test_files_of_an_earlier_run_are_removed(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).touch()
    remove_outdated([tmp_path / "a", tmp_path / "none"])
    assert names(tmp_path) == ["b"]
    (tmp_path / "b").chmod(0o444)
    with pytest.raises(PermissionError, match="read-only"):
        remove_outdated([tmp_path / "b"])
    assert names(tmp_path) == ["b"]


def test_what_an_interrupt_leaves_is_removed_as_the_command_ends(tmp_path):
    """It may come when a file has been made and the `with` that removes it has not begun."""
    (tmp_path / "b").mkdir()
    unfinished = replacing(tmp_path / "a"), replacing_folder(tmp_path / "b")
    for one in unfinished:
        one.__enter__()
    assert len(names(tmp_path)) == 3
    remove_temporary()
    assert names(tmp_path) == ["b"]


def test_nothing_is_written_by_what_a_full_disk_does_not_stop():
    """numpy's tofile loses what the system refuses as the file is closed: it says nothing."""
    package = Path(lidarcfg.__file__).parent
    assert [path.name for path in package.rglob("*.py") if ".tofile(" in path.read_text()] == []
