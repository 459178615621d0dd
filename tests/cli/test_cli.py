"""The commands as a user types them: results, one-line errors, exit codes, and what starting up loads."""

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lidarcfg import __version__
from lidarcfg.cli import progress as module
from lidarcfg.cli.progress import Interrupts, progress
from lidarcfg.sensors.sensor import catalogue, load_sensor
from tests.command_line import lidarcfg, started

ROOT = Path(__file__).parents[2]
STUDY = str(ROOT / "data/studies/liu2018-2x16.yaml")
SEDAN = str(ROOT / "data/studies/sedan.yaml")
ROOF = str(ROOT / "data/rigs/roof.yaml")
STREET = str(ROOT / "data/scenes/street.yaml")
HEAVY = {"scipy", "open3d", "matplotlib"}


def run(*words, code=0, cwd=ROOT):
    return lidarcfg(*words, code=code, cwd=cwd)


def one_line(*words):
    done = run(*words, code=2)
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert done.stdout == ""
    return lines[0]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("out")
    run("optimize", STUDY, "-o", folder / "two", "--evaluations", 450, "--seed", 5, cwd=folder)
    run(
        "export",
        folder / "two/rig.yaml",
        "--scene",
        STREET,
        "--at=-30,-10,0",
        "--duration",
        0.1,
        "-o",
        folder / "two.pcap",
    )
    run("decode", folder / "two.pcap", "--rig", folder / "two/rig.yaml", "-o", folder / "two.ply")
    return folder


@pytest.mark.parametrize(
    "what", ["import lidarcfg", "from lidarcfg.cli.main import cli; cli(['--help'], standalone_mode=False)"]
)
def test_starting_up_loads_nothing_heavy(what):
    code = f"{what}\nimport sys; print(sorted({HEAVY!r} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.slow
def test_every_public_name_is_there():
    code = "import lidarcfg; print([getattr(lidarcfg, name) for name in lidarcfg.__all__] and 'all')"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "all\n"


@pytest.mark.slow
def test_the_results_of_a_search(out):
    result = json.loads((out / "two/result.json").read_text())
    assert {p.name for p in (out / "two").iterdir()} == {
        "rig.yaml",
        "result.json",
        "history.csv",
        "convergence.png",
        "rig.png",
        "search.npz",
        "report.html",
    }
    assert (result["evaluations"], result["seed"], result["solver"]) == (450, 5, "abc")
    assert result["study"]["solver"] == {"method": "abc", "bees": 200, "evaluations": 450, "seed": 5}
    assert set(result["detection"]) == {"pedestrian", "car", "box"}
    assert {"full_evaluations", "cuboids"} <= set(result["skipped"])
    rows = (out / "two/history.csv").read_text().splitlines()
    assert rows[0] == "cycle,evaluations,best,mean,seconds"
    assert float(rows[-1].split(",")[2]) == result["max_vsr_m"]
    for name in ("convergence.png", "rig.png"):
        assert (out / "two" / name).read_bytes().startswith(b"\x89PNG")


def test_an_evaluation_says_the_same(out, blank_pictures):
    found = run("evaluate", STUDY, out / "two/rig.yaml", "--json", "-o", out / "evaluated")
    result = json.loads(found.stdout)
    asked = json.loads((out / "two/result.json").read_text())
    for key in ("max_vsr_m", "subspaces", "detection", "worst", "rig", "version"):
        assert result[key] == asked[key]
    assert json.loads((out / "evaluated/result.json").read_text())["max_vsr_m"] == result["max_vsr_m"]
    table = run("evaluate", STUDY, out / "two/rig.yaml").stdout
    said = " ".join(table.split())
    assert f"max VSR (m) {result['max_vsr_m']:.6f} the paper's measure: the largest of {result['subspaces']:,}" in said


def test_export_repeats_byte_for_byte_and_splits(out, tmp_path):
    words = ("export", out / "two/rig.yaml", "--scene", STREET, "--at=-30,-10,0", "--duration", 0.1)
    run(*words, "-o", tmp_path / "again.pcap", "--quiet")
    assert (tmp_path / "again.pcap").read_bytes() == (out / "two.pcap").read_bytes()
    run(*words, "-o", tmp_path / "each.pcap", "--split")
    sizes = [(tmp_path / f"each-lidar_{i}.pcap").stat().st_size - 24 for i in range(2)]
    assert sum(sizes) == (out / "two.pcap").stat().st_size - 24
    run(*words, "-o", tmp_path / "later.pcap", "--start", "2026-06-01T12:00:00+02:00")
    assert (tmp_path / "later.pcap").read_bytes() != (out / "two.pcap").read_bytes()


def test_a_picture_of_a_capture_and_of_a_cloud(out):
    shutil.copy(out / "two.pcap", out / "alone.pcap")  # without the manifest, by which the scene would be shown too
    for source, name in ((out / "alone.pcap", "a.png"), (out / "two.ply", "b.png")):
        run("view", source, "--rig", out / "two/rig.yaml", "--png", out / name)
    assert (out / "a.png").read_bytes() == (out / "b.png").read_bytes()


@pytest.mark.skipif(bool(os.environ.get("DISPLAY")), reason="there is a screen, and a window would open on it")
def test_no_window_without_a_screen(out):
    assert "there is no screen for a window; --png" in one_line("view", out / "two.ply", "--window")


def test_quiet_commands_print_nothing(out, tmp_path):
    for words in (
        ("evaluate", STUDY, out / "two/rig.yaml", "--quiet"),
        ("decode", out / "two.pcap", "-o", tmp_path / "c.npz", "--quiet"),
        ("view", out / "two.ply", "--png", tmp_path / "p.png", "--quiet"),
        ("sensors", "list", "--quiet"),
    ):
        done = run(*words)
        assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.slow
def test_the_catalogue():
    assert "vlp-16" in run("sensors").stdout
    assert run("sensors", "list").stdout == run("sensors").stdout
    rows = run("sensors", "list").stdout.splitlines()[3:-1]  # between the head and an empty line
    assert [row.split()[0] for row in rows] == list(catalogue())  # each model in one line, whole
    assert all(row.rstrip().endswith(load_sensor(row.split()[0]).description) for row in rows)
    shown = run("sensors", "show", "vlp-16").stdout
    assert "34560" in shown
    assert "63-9243" in shown


def test_version():
    assert run("--version").stdout == f"lidarcfg, version {__version__}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["place"], "lidarcfg: No such command 'place'."),
        (["optimize"], "Missing argument 'STUDY'."),
        (["optimize", "none.yaml"], "lidarcfg: none.yaml: no such file or directory"),
        (["optimize", ROOF], "roof.yaml:2:1: this is a rig; a study belongs here"),
        (["optimize", STUDY, "--seed", "-1"], "Invalid value for '--seed': -1 is not in the range"),
        (["optimize", STUDY, "--solver", "pso"], "Invalid value for '--solver': 'pso' is not"),
        (["optimize", STUDY, "-o", ROOF], "roof.yaml: file exists"),
        (["evaluate", STUDY, STUDY], "liu2018-2x16.yaml:2:1: this is a study; a rig belongs here"),
        (["export", ROOF, "--scene", STREET, "--duration", "0", "-o", "x.pcap"], "Invalid value for '--duration'"),
        (["export", ROOF, "--scene", STREET, "--duration", "nan", "-o", "x.pcap"], "Invalid value for '--duration'"),
        (["export", ROOF, "--scene", STREET, "--duration", "0.0001", "-o", "x.pcap"], "holds no packet of left"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", "x.txt"], "an export is not written as 'x.txt'; allowed: .pcap"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", f"{ROOF}/x.pcap"], "x.pcap: not a directory"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", "x.pcap", "--at", "1,2"], "'1,2' is not three numbers"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", "x.pcap", "--at", "1,2,nan"], "not three numbers"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", "x.pcap", "--start", "noon"], "'noon' is not a time"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", "x.pcap", "--start", "1960-01-01"], "outside a pcap's"),
        (["export", ROOF, "--scene", ROOF, "--duration", "1", "-o", "x.pcap"], "roof.yaml:2:1: this is a rig; a scene belongs here"),
        (["decode", STREET, "-o", "x.ply"], "street.yaml: not a capture; allowed: pcap and pcapng"),
        (["decode", "none.pcap", "-o", "x.ply"], "none.pcap: no such file or directory"),
        (["view", "none.ply", "--png", "x.png"], "none.ply: no such file or directory"),
        (["optimize", STUDY, "--seed", "9" * 25], "Invalid value for '--seed'"),
        (["export", ROOF, "--scene", STREET, "--duration", "1", "-o", "."], "'.' names neither a file nor a folder to write"),
        (["evaluate", STUDY, "a\nb.yaml"], "a\\nb.yaml: no such file or directory"),
        (["sensors", "show", "vlp16"], "no sensor is called 'vlp16'; did you mean vlp-16? allowed: "),
    ],
)  # fmt: skip
def test_mistakes_get_one_line(words, message, tmp_path):
    done = run(*words, code=2, cwd=tmp_path)
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert message in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []  # nothing half-written


def wait_for(folder, pattern=None):
    """Until the file is there, or a file like the pattern in the folder."""
    deadline = time.monotonic() + 180
    while not (any(folder.glob(pattern)) if pattern else folder.exists()):
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.slow
def test_ctrl_c_keeps_the_best_so_far(tmp_path):
    often = "from lidarcfg.cli import main, optimize; optimize.SAVE_EVERY_S = 0; main.main()"
    words = [
        sys.executable,
        "-c",
        often,
        "optimize",
        STUDY,
        "-o",
        str(tmp_path / "run"),
        "--cycles",
        "100000",
    ]
    process = started(words)
    wait_for(tmp_path / "run/search.npz")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=180)
    assert process.returncode == 130
    assert "the best rig found is kept" in errors
    result = json.loads((tmp_path / "run/result.json").read_text())
    assert result["interrupted"]
    run("evaluate", STUDY, tmp_path / "run/rig.yaml", "--quiet")


@pytest.mark.parametrize("quiet", [False, True])
def test_an_interrupt_that_a_callback_lost_comes_with_the_next_progress(quiet):
    interrupts = Interrupts()
    with progress(quiet, interrupts) as on_progress:
        on_progress(0.1, "")
        with suppress(KeyboardInterrupt):  # as a callback in C does
            interrupts.handle(signal.SIGTERM, None)
        with pytest.raises(KeyboardInterrupt):
            on_progress(0.2, "")


def test_an_interrupt_that_was_raised_by_a_progress_does_not_come_again():
    """A search goes on to write what it has."""
    interrupts = Interrupts()
    with suppress(KeyboardInterrupt):
        interrupts.handle(signal.SIGTERM, None)
    with pytest.raises(KeyboardInterrupt):
        interrupts.check("")
    interrupts.take()
    interrupts.check("")


BROKEN = """
import os, signal, sys, time
from lidarcfg.cli import main as cli
from lidarcfg.errors import LidarcfgError

def work(*_, obj, **__):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(60)
    except KeyboardInterrupt:
        {}

cli.cli.main = work
signal.signal(signal.SIGINT, signal.default_int_handler)  # where the caller ignores it, as nohup does, so would we
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "then",
    [
        "raise RuntimeError('release unlocked lock')",
        "raise OSError(9, 'Bad file descriptor')",
        "raise LidarcfgError('not all of it could be written')",
        "os.kill(os.getpid(), signal.SIGINT); time.sleep(60)",
        "raise",
    ],
)
def test_what_an_interrupt_breaks_is_not_said_to_be_an_error(then):
    """Libraries make another error of it; or a second one comes while the first cleans up."""
    done = subprocess.run([sys.executable, "-c", BROKEN.format(then)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


@pytest.fixture
def log(monkeypatch, capsys):
    """What a log says of updates: seconds of work, and the fraction done."""

    def lines(updates, **options):
        now = [0.0]
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
        with progress(False, Interrupts(), **options) as on_progress:
            for now[0], fraction in updates:
                on_progress(fraction, "runs")
        return capsys.readouterr().err.splitlines()

    return lines


def test_a_log_says_how_much_time_is_left(log):
    """Two fifths were done before; a fifth more takes 100 s, so the last two take 200 s more."""
    updates = [(0, 0.4), (5, 0.4), (50, 0.4), (100, 0.6), (101, 0.7), (300, 1.0)]
    assert log(updates, mean_over_s=math.inf) == [" 40%  runs", " 60%  runs  about 3 min left", "100%  runs"]


def test_a_log_says_nothing_of_the_time_left_before_it_can_be_known(log):
    """13 of 20,000 rigs in 0.3 s say nothing of the rest."""
    assert log([(0, 0), (0.3, 13 / 20000), (11, 1.0)]) == ["100%  runs"]


def test_the_time_left_is_by_recent_updates(log):
    """A hundredth in the first 20 s, then one each second: at 66 s, 53 hundredths take 53 s more."""
    updates = [(float(s), max(s / 2000, (s - 19) / 100)) for s in range(70)]
    assert log(updates)[-2] == " 47%  runs  about 53 s left"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_stopped_export_leaves_no_half_capture(tmp_path, name):
    words = [
        sys.executable,
        "-m",
        "lidarcfg",
        "export",
        ROOF,
        "--scene",
        STREET,
        "--duration",
        "3600",
        "-o",
        str(tmp_path / "x.pcap"),
    ]
    process = started(words)
    wait_for(tmp_path, "*.part")
    process.send_signal(getattr(signal, name))
    process.communicate(timeout=180)
    assert process.returncode == 130
    assert list(tmp_path.iterdir()) == []


def test_no_command_is_the_help():
    assert run().stdout == run("--help").stdout


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error():
    words = f"{sys.executable} -m lidarcfg sensors show vlp-16 | head -1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", words], capture_output=True, text=True, cwd=ROOT)
    assert done.stderr == ""
    assert done.returncode in (0, 128 + signal.SIGPIPE)


@pytest.mark.slow
def test_the_shortest_budget_still_gives_a_rig(tmp_path, blank_pictures):
    done = run("optimize", STUDY, "-o", tmp_path, "--seconds", "1e-9", "--quiet")
    assert done.stderr == ""
    assert json.loads((tmp_path / "result.json").read_text())["interrupted"] is False


@pytest.mark.slow
def test_a_budget_in_seconds_cuts_a_large_swarm(tmp_path, blank_pictures):
    study = tmp_path / "s.yaml"
    study.write_text(Path(STUDY).read_text().replace("bees: 200", "bees: 100000"))
    run("optimize", study, "-o", tmp_path / "o", "--seconds", 0.2, "--quiet")
    assert json.loads((tmp_path / "o/result.json").read_text())["seconds"] < 60


@pytest.mark.slow
def test_names_that_look_like_markup_or_mathematics(tmp_path):
    study = tmp_path / "q$\\frac$.yaml"
    study.write_text(
        Path(STUDY).read_text().replace("name: car", "name: '[/bold] $\\frac$'").replace("cycles: 800", "cycles: null")
    )
    done = run("optimize", study, "-o", tmp_path / "o", "--evaluations", 50)
    assert "detection of [/bold] $\\frac$ " in done.stdout
    assert (tmp_path / "o/convergence.png").exists()


def test_resuming_from_what_is_none(tmp_path, out):
    assert "search.npz: no such file" in one_line("optimize", STUDY, "--resume", tmp_path, "-o", tmp_path / "x")
    (tmp_path / "search.npz").write_text("no")
    assert "search.npz: not a whole npz file" in one_line("optimize", STUDY, "--resume", tmp_path)
    earlier = {"cost": np.array([[0.0, 3.0], [2.0, np.inf]]), "seconds": np.float64(2), "asked": np.str_("x")}
    earlier |= {"points": np.empty((0, 0)), "given": np.int64(0)}
    earlier |= {"checked": np.array([[2, 0, 0]]), "places": np.zeros((1, 6))}
    np.savez(tmp_path / "search.npz", **earlier)
    assert "search.npz: is not the log of a search" in one_line("optimize", STUDY, "--resume", tmp_path)
    np.save(tmp_path / "search.npy", np.ones(3))
    (tmp_path / "search.npy").replace(tmp_path / "search.npz")
    assert "search.npz: not a whole npz file" in one_line("optimize", STUDY, "--resume", tmp_path)
    words = ("optimize", STUDY, "--resume", out / "two", "-o", tmp_path / "x", "--seed", 6, "--evaluations", 500)
    assert "is of another search; study, solver and seed must be the same" in one_line(*words)


@pytest.mark.slow
def test_resuming_ends_where_an_unbroken_search_does(tmp_path, out, blank_pictures):
    """The same seed finds the same rig, whatever the threads."""
    words = ("--seed", 5, "--evaluations", 700, "--quiet")
    run("optimize", STUDY, "--resume", out / "two", "-o", tmp_path / "on", *words)
    run("optimize", STUDY, "-o", tmp_path / "whole", "--threads", 1, *words)
    assert (tmp_path / "on/rig.yaml").read_bytes() == (tmp_path / "whole/rig.yaml").read_bytes()


@pytest.mark.slow
def test_whole_paths_in_a_result(tmp_path, blank_pictures):
    (tmp_path / "models").mkdir()
    (tmp_path / "models/mine.yaml").write_text("name: mine\nbeams: {elevation_deg: [-5, 5]}\n")
    (tmp_path / "s.yaml").write_text(Path(STUDY).read_text().replace("model: vlp-16", "model: models/mine.yaml"))
    run("optimize", tmp_path / "s.yaml", "-o", tmp_path / "a/b", "--evaluations", 20, "--quiet", cwd=tmp_path)
    result = json.loads((tmp_path / "a/b/result.json").read_text())
    whole = str((tmp_path / "models/mine.yaml").resolve())
    assert result["study"]["sensors"][0]["model"] == whole
    assert result["rig"]["sensors"][0]["model"] == whole
    run("evaluate", tmp_path / "s.yaml", tmp_path / "a/b/rig.yaml", "--quiet", cwd="/")


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_without_unicode(encoding):
    """Tables are drawn in what it has; what it lacks is a question mark."""
    words = [sys.executable, "-m", "lidarcfg", "sensors", "show", "vlp-16"]
    done = subprocess.run(words, capture_output=True, env=os.environ | {"PYTHONIOENCODING": encoding})
    assert (done.returncode, done.stderr) == (0, b"")
    text = done.stdout.decode(encoding)
    assert "elevation" in text
    assert "-15" in text


@pytest.mark.parametrize("text", ["abc", "-1", "1e9", "9" * 30, "\u0663x"])
def test_an_epoch_that_is_none(monkeypatch, text):
    """scipy would raise it as a ValueError as it is imported."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", text)
    assert "SOURCE_DATE_EPOCH: " in one_line("evaluate", STUDY, "data/rigs/roof.yaml")


def test_files_without_an_end(tmp_path):
    """A device, and a file of ten gigabytes that takes no room."""
    with open(tmp_path / "large.yaml", "wb") as file:
        file.truncate(10**10)
    for path, what in (("/dev/zero", "is not a regular file"), (tmp_path / "large.yaml", "not a capture")):
        assert "larger than the 64 million bytes that are read" in one_line("evaluate", path, "data/rigs/roof.yaml")
        assert what in one_line("decode", path, "-o", tmp_path / "a.ply")


def test_a_name_that_is_no_unicode(tmp_path):
    path = tmp_path / os.fsdecode(b"\xff.pcap")
    path.write_bytes(b"x")
    assert "\\udcff.pcap: not a capture" in one_line("decode", path, "-o", tmp_path / "a.ply")


def test_a_picture_is_a_png(tmp_path):
    assert "a.gif' does not end in .png" in one_line("view", "data/rigs/roof.yaml", "--png", tmp_path / "a.gif")
    assert "a.jpg' does not end in .png" in one_line("sensors", "show", "vlp-16", "--png", tmp_path / "a.jpg")


@pytest.mark.slow
def test_odd_environments():
    """matplotlib refuses to load where it does not know the backend, as one of another program's may be."""
    load = "import sys; from lidarcfg.cli.main import main\ntry: main()\nexcept SystemExit: import matplotlib"
    words = [sys.executable, "-c", load, "completion", "bash"]
    done = subprocess.run(words, env=os.environ | {"MPLBACKEND": "foo"}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    alone = subprocess.run(
        [sys.executable, "-c", "import matplotlib"], env=os.environ | {"MPLBACKEND": "foo"}, capture_output=True
    )
    assert alone.returncode == 1


def test_names_of_a_million_characters(tmp_path):
    """Drawing one takes minutes, and tables of it nobody reads."""
    rig = "name: {}\nsensors: [{{name: {}, model: vlp-16, position_m: [0, 0, 1]}}]\n"
    (tmp_path / "a.yaml").write_text(rig.format("n" * 10**6, "a"))
    (tmp_path / "b.yaml").write_text(rig.format("n" * 200, "n" * 201))
    for name in ("a.yaml", "b.yaml"):
        said = run("validate", tmp_path / name, code=2).stderr
        assert "'… is too long; allowed: at most 200 characters" in said
        assert len(said) < 400
