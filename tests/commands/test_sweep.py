"""`lidarcfg sweep`: its rows are those of single searches, whoever does the runs and whatever is killed meanwhile."""

import csv
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet
import pytest

import lidarcfg
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.plan import load_plan
from lidarcfg.placement.sweep import sweep
from lidarcfg.placement.workers import Processes
from tests.command_line import lidarcfg as command

BIN = Path(sys.executable).parent
PLAN = Path(__file__).parents[1] / "placement/studies/plan.yaml"


def rows(folder):
    """The table, without the one column that differs between sweeps."""
    with open(folder / "table.csv", newline="") as file:
        return [{key: value for key, value in row.items() if key != "seconds"} for row in csv.DictReader(file)]


def rigs(folder):
    """The rigs' files by name."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.glob("runs/*/rig.yaml")}


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return Path(shutil.copy(PLAN, tmp_path_factory.mktemp("sweep")))


@pytest.fixture(scope="module")
def serial(plan):
    """What a sweep with one worker writes."""
    said = command("sweep", plan, "-o", plan.parent / "serial", "--workers", 1)
    assert said.stdout.splitlines()[0] == "6 runs, 0 of them done"
    return plan.parent / "serial"


def test_a_row_is_what_a_search_by_itself_finds(plan, serial):
    found = rows(serial)
    loaded = load_plan(plan)
    assert [(row["run"], row["sensors[0].count"], row["solver.seed"]) for row in found] == [
        ("1", "1", "1"), ("2", "1", "2"), ("3", "1", "3"), ("4", "2", "1"), ("5", "2", "2"), ("6", "2", "3"),
    ]  # fmt: skip
    for row, run in zip(found, loaded.runs, strict=True):
        alone = optimize(loaded.studies.of(run.file), threads=2)
        assert float(row["cost"]) == alone.objective
        assert float(row["max_vsr_m"]) == alone.evaluation.max_vsr_m
        assert float(row["detection.box"]) == alone.evaluation.detection["box"].rate
        assert int(row["evaluations"]) == alone.evaluations == 60
        assert float(row[f"seen_by.{row['sensors[0].count']}"]) == 1.0  # nothing limits the sight
        assert row["error"] == ""
        assert row["version"] == lidarcfg.__version__
        assert lidarcfg.load_rig(serial / row["rig"]).mounts == alone.rig.mounts


def test_both_tables_say_the_same(serial):
    table = pyarrow.parquet.read_table(serial / "table.parquet").to_pylist()
    with open(serial / "table.csv", newline="") as file:
        said = list(csv.DictReader(file))
    assert [{key: "" if value is None else str(value) for key, value in row.items()} for row in table] == said
    assert {type(row["sensors[0].count"]) for row in table} == {int}


def test_killed_workers_and_commands_cost_nothing_but_time(plan, serial, tmp_path):
    """kill -9 of a worker while it works, then of the command itself; then what is missing is done."""
    out = tmp_path / "out"
    words = [BIN / "lidarcfg", "sweep", plan, "-o", out, "--workers", "2"]
    started = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    there = lambda: len(list(out.glob("runs/*/result.json")))  # noqa: E731
    while there() < 2:
        assert started.poll() is None
        time.sleep(0.01)
    children = [int(pid) for pid in Path(f"/proc/{started.pid}/task/{started.pid}/children").read_text().split()]
    started.kill()
    started.wait()
    assert 2 <= there() < 6
    until = time.monotonic() + 20
    while any(Path(f"/proc/{pid}/fd").exists() and os.path.exists(f"/proc/{pid}/exe") for pid in children):
        assert time.monotonic() < until, "its processes outlive it"
        time.sleep(0.05)
    said = command("sweep", plan, "-o", out)
    assert int(said.stdout.split("runs, ")[1].split()[0]) >= 2
    assert rows(out) == rows(serial)
    assert rigs(out) == rigs(serial)


def test_a_worker_that_is_killed_is_replaced(plan, serial):
    loaded, found = load_plan(plan), {}
    crew = Processes(2)

    def done(run, outcome):
        found[run.number] = outcome
        if len(found) in (1, 3):
            os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

    try:
        sweep(loaded, loaded.runs, crew, done)
    finally:
        crew.close()
    assert [str(found[n].found["cost"]) for n in range(1, 7)] == [row["cost"] for row in rows(serial)]
