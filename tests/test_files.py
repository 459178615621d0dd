"""Files that come with the package, and outputs that are there whole or not at all."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest

import lidarcfg
from lidarcfg import files
from lidarcfg.aside import remove_own
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, replacing, shipped, together
from lidarcfg.formats.folder import replacing_folder
from lidarcfg.simulate.ground_truth import TruthFile

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


def test_what_a_killed_run_has_left_is_removed_by_the_next_of_the_same_output(tmp_path):
    for path in (tmp_path / "a.txt", tmp_path / "b.txt"):
        process = writer(path)
        process.kill()
        process.communicate()
    keep = [".a.txt.0123456.part", ".a.txt.0123456g.part", ".xa.txt.01234567.part", "a.txt.01234567.part"]
    for name in keep:
        (tmp_path / name).touch()
    os.mkfifo(tmp_path / ".a.txt.01234567.part")  # is not waited for
    (left,) = tmp_path.glob(".b.txt.*.part")
    with replacing(tmp_path / "a.txt") as file:
        file.write("new")
    assert names(tmp_path) == sorted([*keep, left.name, "a.txt"])


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


def test_a_folder_of_a_killed_run_is_removed_and_one_that_it_was_replacing_comes_back(tmp_path):
    left = tmp_path / ".bag.01234567.part"
    (left / "bag.old").mkdir(parents=True)
    (left / "bag.old/metadata.yaml").write_text("old")
    with pytest.raises(ZeroDivisionError), replacing_folder(tmp_path / "bag", "*.yaml"):
        assert (tmp_path / "bag/metadata.yaml").read_text() == "old"
        1 / 0  # noqa: B018
    assert names(tmp_path) == ["bag"]


@pytest.mark.parametrize("swaps", [True, False])
def test_a_folder_is_replaced_whole(tmp_path, monkeypatch, swaps):
    """In one step, or in two where the system has no such step."""
    if not swaps:
        monkeypatch.setattr("lidarcfg.files.exchange", lambda one, other: False)
    for text in ("old", "new"):
        with replacing_folder(tmp_path / "bag", "*.yaml") as folder:
            folder.mkdir()
            (folder / f"{text}.yaml").touch()
        assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == [
            "bag",
            f"bag/{text}.yaml",
        ]


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


def test_files_that_belong_together_take_their_places_together(tmp_path):
    for name in ("a", "b", "gone"):
        (tmp_path / name).write_text("old")
    with pytest.raises(ZeroDivisionError), together(gone=[tmp_path / "gone"]):
        for name in ("a", "b"):
            with replacing(tmp_path / name) as file:
                file.write("new")
        1 / 0  # noqa: B018
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "old", "b": "old", "gone": "old"}
    with together(gone=[tmp_path / "gone"]):
        for name in ("a", "b"):
            with replacing(tmp_path / name) as file:
                file.write("new")
        assert (tmp_path / "a").read_text() == (tmp_path / "b").read_text() == "old"
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_what_belongs_together_within_what_does(tmp_path):
    """All of it at the end of the outer one, removals too; an error in the outer one undoes the inner."""
    for name in ("a", "b", "gone"):
        (tmp_path / name).write_text("old")
    for error in (True, False):
        with suppress(ZeroDivisionError), together():
            with together(gone=[tmp_path / "gone"]), replacing(tmp_path / "a") as file:
                file.write("new")
            with replacing(tmp_path / "b") as file:
                file.write("new")
            assert {path.name: path.read_text() for path in tmp_path.glob("[!.]*")} == dict.fromkeys(
                ("a", "b", "gone"), "old"
            )
            assert 1 / (not error)
        left = {path.name: path.read_text() for path in tmp_path.iterdir()}
        assert left == (dict.fromkeys(("a", "b", "gone"), "old") if error else {"a": "new", "b": "new"})


@pytest.mark.parametrize("swaps", [True, False])
def test_a_folder_and_a_file_take_their_places_together(tmp_path, monkeypatch, swaps):
    """A drive in a folder and the record beside it: on an error neither; an interrupt between the two waits."""
    if not swaps:
        monkeypatch.setattr("lidarcfg.files.exchange", lambda one, other: False)

    def write(text, error):
        with together():
            with replacing_folder(tmp_path / "bag", "data") as folder:
                folder.mkdir()
                with replacing(folder / "data") as file:
                    file.write(text)
                assert names(folder) == ["data"]
            with replacing(tmp_path / "bag.yaml") as file:
                file.write(text)
            assert 1 / (not error)

    for text, error in (("old", False), ("new", True), ("new", False)):
        before = [path.read_text() for path in (tmp_path / "bag/data", tmp_path / "bag.yaml") if path.exists()]
        with suppress(ZeroDivisionError):
            write(text, error)
        assert [path.read_text() for path in (tmp_path / "bag/data", tmp_path / "bag.yaml")] == (
            before if error else [text] * 2
        )
        assert names(tmp_path) == ["bag", "bag.yaml"]

    def interrupted(one, other):
        if other.name == "bag.yaml":
            monkeypatch.setattr("lidarcfg.files.exchange", swap)
            raise KeyboardInterrupt
        return swap(one, other)

    swap = files.exchange
    monkeypatch.setattr("lidarcfg.files.exchange", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write("newest", False)
    assert (tmp_path / "bag/data").read_text() == (tmp_path / "bag.yaml").read_text() == "newest"
    assert names(tmp_path) == ["bag", "bag.yaml"]


def test_an_interrupt_between_two_files_waits_for_the_second(tmp_path, monkeypatch):
    rename = os.replace

    def interrupted(one, other):
        monkeypatch.setattr(os, "replace", rename)
        rename(one, other)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), together():
        for name in ("a", "b"):
            with replacing(tmp_path / name) as file:
                file.write("new")
        monkeypatch.setattr(os, "replace", interrupted)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a": "new", "b": "new"}


def test_what_an_interrupt_leaves_is_removed_as_the_command_ends(tmp_path):
    """It may come when a file has been made and the `with` that removes it has not begun."""
    (tmp_path / "b").mkdir()
    unfinished = replacing(tmp_path / "a"), replacing_folder(tmp_path / "b")
    for one in unfinished:
        one.__enter__()
    assert len(names(tmp_path)) == 3
    remove_own()
    assert names(tmp_path) == ["b"]


def test_a_run_does_not_wait_for_itself(tmp_path, monkeypatch):
    """A folder by two names, here and by its whole path and through a link, is locked once."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("lidarcfg.aside.AGAIN_S", "no wait is expected")
    (tmp_path / "link").symlink_to(tmp_path)
    with together():
        for path in ("a", tmp_path / "b", "link/c"):
            with replacing(path) as file:
                file.write("new")
    assert names(tmp_path) == ["a", "b", "c", "link"]


def test_of_two_runs_with_several_files_one_waits(tmp_path):
    """So that what is there in the end is all of one of them: four threads, twenty times each."""

    def one(text):
        for _ in range(20):
            with together():
                for name in "abc":
                    with replacing(tmp_path / name) as file:
                        file.write(text)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(one, "abcd"))
    assert len({(tmp_path / name).read_text() for name in "abc"}) == 1
    assert names(tmp_path) == ["a", "b", "c"]


def test_nothing_is_written_by_what_a_full_disk_does_not_stop():
    """numpy's tofile loses what the system refuses as the file is closed: it says nothing."""
    package = Path(lidarcfg.__file__).parent
    assert [path.name for path in package.rglob("*.py") if ".tofile(" in path.read_text()] == []
