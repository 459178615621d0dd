"""`lidarcfg sweep`: its rows are those of single searches, whoever does the runs and whatever is killed meanwhile."""

import csv
import multiprocessing
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from pathlib import Path

import kubernetes_validate
import pyarrow.parquet
import pytest
import yaml
from distributed import Client

import lidarcfg
from lidarcfg.errors import ConfigError
from lidarcfg.report.sweep import SweepFolder
from lidarcfg.search import workers as workers_module
from lidarcfg.search.cheapest import cheapest
from lidarcfg.search.optimize import optimize
from lidarcfg.search.sweep import sweep
from lidarcfg.search.sweep_plan import load_plan
from lidarcfg.search.workers import Cluster, Processes
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.loading import load_study
from tests.command_line import lidarcfg as command
from tests.search.test_requirements_search import CHOICE

pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent
PLAN = Path(__file__).parents[1] / "search/studies/plan.yaml"


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


def children_of(command):
    """The processes that a command's main thread has started."""
    return [int(pid) for pid in Path(f"/proc/{command.pid}/task/{command.pid}/children").read_text().split()]


def wait_for_end_of(processes):
    until = time.monotonic() + 20
    while any(os.path.exists(f"/proc/{pid}/exe") for pid in processes):
        assert time.monotonic() < until, "its processes outlive it"
        time.sleep(0.05)


@pytest.mark.skipif(sys.platform != "linux", reason="finds the command's processes in /proc")
def test_a_killed_command_costs_nothing_but_time(plan, serial, tmp_path):
    """kill -9 of the command: its processes end with it, and what is missing is done by the next."""
    out = tmp_path / "out"
    words = [BIN / "lidarcfg", "sweep", plan, "-o", out, "--workers", "2"]
    started = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    there = lambda: len(list(out.glob("runs/*/result.json")))  # noqa: E731
    while there() < 2:
        assert started.poll() is None
        time.sleep(0.01)
    children = children_of(started)
    started.kill()
    started.wait()
    assert there() >= 2
    wait_for_end_of(children)
    said = command("sweep", plan, "-o", out, "--workers", 1)
    assert int(said.stdout.split("runs, ")[1].split()[0]) >= 2
    assert rows(out) == rows(serial)
    assert rigs(out) == rigs(serial)


@pytest.mark.skipif(sys.platform != "linux", reason="finds the command's processes in /proc")
def test_ctrl_c_ends_runs_in_progress(plan, tmp_path):
    """Two that would take hours; what is done is kept."""
    text = plan.read_text().replace("[1, 2]", "[1]").replace("[1, 2, 3]", "[1]")
    (tmp_path / "plan.yaml").write_text(f"{text}  solver.evaluations: [30, 100000000, 100000001]\n")
    out = tmp_path / "out"
    interruptible = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731
    started = subprocess.Popen(
        [BIN / "lidarcfg", "sweep", tmp_path / "plan.yaml", "-o", out, "--workers", "2", "--quiet"],
        stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=interruptible,
    )  # fmt: skip
    while not list(out.glob("runs/*/result.json")):
        assert started.poll() is None
        time.sleep(0.01)
    children = children_of(started)
    os.killpg(started.pid, signal.SIGINT)
    _, said = started.communicate(timeout=60)
    assert (started.returncode, said.strip()) == (130, "interrupted")
    assert [row["run"] for row in rows(out)] == ["1"]
    wait_for_end_of(children)


def test_a_worker_that_is_killed_is_replaced(plan, serial):
    loaded = load_plan(plan)
    found = {}
    crew = Processes(2)

    def done(run, outcome):
        found[run.number] = outcome
        if len(found) in (1, 3):
            os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)

    try:
        sweep(loaded, loaded.runs, crew, done)
    finally:
        crew.close()
    assert [str(found[n].figures["cost"]) for n in range(1, 7)] == [row["cost"] for row in rows(serial)]


IDLE = """
import multiprocessing, os, signal
from concurrent.futures import BrokenExecutor
from lidarcfg.search.workers import Processes

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # as commands have it
crew = Processes(1)
first = crew.submit(os.getpid).result()
[process] = multiprocessing.active_children()
process.kill()
process.join()
try:
    second = crew.submit(os.getpid).result()
except BrokenExecutor:  # it had not been noticed yet
    second = crew.submit(os.getpid).result()
print(first == process.pid, second != first)
crew.close()
print(multiprocessing.active_children())
"""


@pytest.mark.skipif(not hasattr(signal, "SIGPIPE"), reason="there is no such signal")
def test_a_worker_that_is_killed_while_it_waits_does_not_end_the_command():
    done = subprocess.run([sys.executable, "-c", IDLE], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "True True\n[]\n"), done.stderr


def test_a_plain_error_is_a_row_of_its_own(plan, tmp_path):
    """A study that is possible, but in which a search that short finds no rig; the others go on."""
    one_tilt = "vary:\n  constraints.max_tilt_deg: [90, 0]"
    (tmp_path / "plan.yaml").write_text(plan.read_text().replace("vary:", one_tilt).replace("[1, 2]", "[1]"))
    said = command("sweep", tmp_path / "plan.yaml", "-o", tmp_path / "out", "--workers", 1)
    found = rows(tmp_path / "out")
    assert said.stderr.endswith("warning: 3 runs have no rig; the column error of the table says why\n")
    assert [row["cost"] == "" for row in found] == [False] * 3 + [True] * 3
    assert all("found no rig that keeps the constraints" in row["error"] for row in found[3:])
    assert command("sweep", tmp_path / "plan.yaml", "-o", tmp_path / "out").stdout.startswith("6 runs, 6 of them done")
    again = load_plan(tmp_path / "plan.yaml")
    folder = SweepFolder(tmp_path / "out", again)
    run = again.runs[0]
    assert folder.row(run)["run"] == 1
    for damaged in ("", "null", "[1]", '{"cost": 1'):
        (tmp_path / "out/runs" / run.digest / "result.json").write_text(damaged)
        assert folder.row(run) is None


class Dead:
    """Workers that are killed in every run."""

    count = capacity = 2

    def submit(self, function, *arguments):
        future = Future()
        future.set_exception(BrokenExecutor())
        return future


def test_a_run_that_kills_every_worker_ends(plan):
    loaded = load_plan(plan)
    found = {}
    sweep(loaded, loaded.runs, Dead(), lambda run, outcome: found.update({run.number: outcome}))
    assert found.keys() == set(range(1, 7))
    assert all("its worker ended 5 times" in one.error and not one.lasting for one in found.values())


def one_line(*words):
    (line,) = command(*words, "--quiet", code=2).stderr.splitlines()
    return line


def test_folders_and_addresses_that_are_wrong(plan, serial, tmp_path):
    (tmp_path / "other.yaml").write_text(plan.read_text().replace("solver.seed", "solver.limit"))
    assert "plan.json: of another plan, with another study or other keys" in one_line(
        "sweep", tmp_path / "other.yaml", "-o", serial
    )
    (tmp_path / "plan.yaml").write_text(plan.read_text().replace("[1, 2]", "[1]").replace("[1, 2, 3]", "[1, 3]"))
    assert command("sweep", tmp_path / "plan.yaml", "-o", serial, "--dry-run").stdout.startswith(
        "2 runs, 2 of them done"
    )
    assert "scheduler 'here': is not an address such as tcp://" in one_line(
        "sweep", plan, "--scheduler", "here", "--quiet"
    )
    with pytest.raises(ConfigError, match=r"scheduler tls://127.0.0.1:9: Dask's configuration names no certificates"):
        Cluster("tls://127.0.0.1:9")
    words = "sweep", plan, "--scheduler", "tcp://127.0.0.1:9", "--workers", "2", "--quiet"
    assert "--workers are local" in one_line(*words)


@pytest.fixture(scope="module")
def cluster():
    """The address of a scheduler with two workers, each a program of its own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = [sys.executable, "-m", "dask"]
    scheduler = [*dask, "scheduler", "--host", address, "--no-dashboard"]
    worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    parts = [
        subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for words in (scheduler, worker, worker)
    ]
    until = time.monotonic() + 60
    while time.monotonic() < until:
        with suppress(OSError), socket.create_connection(address.removeprefix("tcp://").split(":")):
            break
        time.sleep(0.1)
    yield address
    for part in parts:
        part.kill()
        part.wait()


def test_a_cluster_finds_the_same(plan, serial, cluster, tmp_path, monkeypatch):
    command("sweep", plan, "-o", tmp_path / "out", "--scheduler", cluster)
    assert rows(tmp_path / "out") == rows(serial)
    assert rigs(tmp_path / "out") == rigs(serial)
    monkeypatch.setattr(workers_module, "version", lambda name: "9.9")
    line = one_line("sweep", plan, "-o", tmp_path / "none", "--scheduler", cluster)
    assert re.search(r"worker tcp://\S+ has numpy \S+, and this program 9.9; both must be the same", line)
    assert not list((tmp_path / "none").glob("runs/*"))
    with Client(cluster, set_as_default=False) as ours:  # the command's own is closed
        assert ours.run_on_scheduler(_clients) == {ours.id, "fire-and-forget"}


def test_a_cluster_finds_the_cheapest_rig(cluster, tmp_path):
    study = tmp_path / "study.yaml"
    study.write_text(CHOICE.replace("RETURNS", "60").replace("within_m: [2, 3]", "within_m: [2, 2.4]"))
    command("optimize", study, "-o", tmp_path / "out", "--scheduler", cluster)
    alone = cheapest(load_study(study))
    assert [one.position_m for one in load_rig(tmp_path / "out/rig.yaml").mounts] == [
        one.position_m for one in alone.placement.rig.mounts
    ]
    with open(tmp_path / "out/combinations.csv", newline="") as file:
        assert [row["name"] for row in csv.DictReader(file)] == [one.name for one in alone.tried]


def _clients(dask_scheduler):
    return set(dask_scheduler.clients)


def test_the_manifest_is_what_kubernetes_takes():
    text = (Path(__file__).parents[2] / "docs/examples/cluster.yaml").read_text()
    parts = list(yaml.safe_load_all(text))
    assert [part["kind"] for part in parts] == ["Service", "Deployment", "Deployment", "Job"]
    for part in parts:
        kubernetes_validate.validate(part, kubernetes_validate.latest_version(), strict=True)
    service, scheduler, worker, job = parts
    assert service["spec"]["selector"] == scheduler["spec"]["template"]["metadata"]["labels"]
    images = {part["spec"]["template"]["spec"]["containers"][0]["image"] for part in (scheduler, worker, job)}
    assert len(images) == 1
    assert next(iter(images)).endswith(f":{lidarcfg.__version__}")
    assert text.count(f"tcp://{service['metadata']['name']}:8786") == 2
