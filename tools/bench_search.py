#!/usr/bin/env python3
"""How near solvers come to the best rigs known on the paper's 15 studies.

    .venv/bin/python tools/bench_search.py                        five seeds, 60 s each, all cores: 75 minutes a method
    .venv/bin/python tools/bench_search.py --studies 2x8 3x16 --seeds 1 2 --methods auto
    .venv/bin/python tools/bench_search.py --busy                 one thread, until it has used as much of the processor
    .venv/bin/python tools/bench_search.py --best-known 3600      an hour a study, in searches of ten minutes

Prints the table of docs/evidence/benchmarks.md. What is finished stands in data/reference/search.jsonl and is not run
again, so a run may be stopped at any time and started anew. A rig better than the best known takes its place in
data/reference/best_known.json and docs/evidence/paper.md. `--best-known` only searches for such: seeds from 1000 on,
until the runs of a study come to that many seconds.
"""

import argparse
import ast
import hashlib
import json
import os
import signal
import statistics
import time
from typing import Any

from page import ROOT, write_section

import lidarcfg
from lidarcfg.files import replacing
from lidarcfg.report.plots import COLOURS, new_figure, save_figure
from lidarcfg.search.optimize import optimize
from lidarcfg.solvers import SOLVERS
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver

RUNS = ROOT / "data/reference/search.jsonl"
KNOWN = ROOT / "data/reference/best_known.json"
LIDARS = (1, 2, 3, 4, 5)
STUDIES = [f"{lidars}x{beams}" for beams in (4, 8, 16) for lidars in LIDARS]
SEEDS = 5  # with fewer a study's median and worst say little, most of all where one of them is the best known
MEDIAN, WORST = 0.01, 0.04  # how far over the best known they may be
MOST = 10**9  # evaluations of a search that is ended by its time
PIECE_S = 600.0
FIRST_SEED = 1000  # of searches for the best known
Run = dict[str, Any]


def code() -> str:
    """What decides which rigs are tried: runs of other code are made again.

    How fast rigs are evaluated is no part of it, nor are comments and docstrings.
    """
    package = ROOT / "lidarcfg"
    said = hashlib.sha256()
    for file in (*sorted(package.glob("solvers/*.py")), package / "study/search_space.py", package / "search/run.py"):
        tree = ast.parse(file.read_bytes())
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node):
                del node.body[0]
        said.update(ast.dump(tree).encode())
    return said.hexdigest()[:12]


def search(study: str, method: str, seed: int, seconds: float, threads: int, busy: bool = False) -> Run:
    """One search. On a machine that is busy it has one thread, and as much of the processor as all would have had."""
    loaded = load_study(ROOT / f"data/studies/liu2018-{study}.yaml")
    solver = {"method": method, "seed": seed}
    if busy:
        signal.signal(signal.SIGPROF, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_PROF, seconds * threads)
        found = optimize(with_solver(loaded, **solver, evaluations=MOST), 1)
    else:
        found = optimize(with_solver(loaded, **solver, seconds=seconds), threads)
    if found.interrupted and not (busy and signal.getitimer(signal.ITIMER_PROF)[0] == 0.0):
        raise KeyboardInterrupt
    return {
        "study": study,
        "method": method,
        "seed": seed,
        "seconds": seconds,
        "threads": threads,
        "busy": busy,
        "code": code(),
        "date": time.strftime("%Y-%m-%d"),
        "load": os.getloadavg()[0],
        "max_vsr_m": found.objective,
        "evaluations": found.evaluations,
        "poses": [{"position_m": list(one.position_m), "rpy_rad": list(one.rpy_rad)} for one in found.rig.mounts],
    }


def finished() -> list[Run]:
    """The runs so far."""
    return [json.loads(line) for line in RUNS.read_text().splitlines()] if RUNS.exists() else []


def record(run: Run) -> None:
    """Add a run to what is finished, and its rig to the best known if it is better."""
    RUNS.parent.mkdir(exist_ok=True)
    with RUNS.open("a") as file:
        file.write(json.dumps(run) + "\n")
    known = json.loads(KNOWN.read_text())
    best = known[run["study"]]
    study = run["study"]
    best["searched_s"] += run["seconds"] if run["seed"] >= FIRST_SEED else 0.0
    if run["max_vsr_m"] < best["max_vsr_m"]:
        threads = f"{run['threads']} thread{'s' * (run['threads'] > 1)}"
        lasted = f"{run['seconds']:.0f} s on {threads}" + ", by the processor's time" * run["busy"]
        by = f"`{run['method']}`, seed {run['seed']}, {lasted}, {run['date']}"
        known[study] = {**best, "max_vsr_m": run["max_vsr_m"], "found_by": by, "poses": run["poses"]}
    with replacing(KNOWN) as file:
        json.dump(known, file, indent=1)
        file.write("\n")


def best_known() -> None:
    """The table of docs/evidence/paper.md, and its picture."""
    known = json.loads(KNOWN.read_text())
    figure = new_figure(7, 4.2)
    axes = figure.subplots()
    for beams, colour in zip((4, 8, 16), COLOURS, strict=False):
        least = [known[f"{lidars}x{beams}"]["max_vsr_m"] for lidars in LIDARS]
        axes.plot(LIDARS, least, "o-", color=colour, label=f"{beams} beams")
        for lidars, value in zip(LIDARS, least, strict=True):
            axes.annotate(f"{value:.3f}", (lidars, value), (0, 5), textcoords="offset points", ha="center", fontsize=7)
    axes.set(xlabel="LiDARs", ylabel="best max VSR known (m)", xticks=LIDARS)
    axes.margins(y=0.1)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    save_figure(figure, ROOT / "docs/evidence/paper/best-known.png")
    titles = ("one LiDAR", "two", "three", "four", "five")
    lines = [f"| best known (m) | {' | '.join(titles)} |", "|---" * (1 + len(titles)) + "|"]
    for beams in (4, 8, 16):
        least = [f"{known[f'{lidars}x{beams}']['max_vsr_m']:.4f}" for lidars in LIDARS]
        lines.append(f"| {beams} beams | {' | '.join(least)} |")
    write_section("best known", lines, ROOT / "docs/evidence/paper.md")


def compared(runs: list[Run], methods: list[str], known: dict[str, Any]) -> list[str]:
    """The table of docs/evidence/benchmarks.md, and how many studies keep the targets."""
    cells = ("best, median, worst (m)", "median and worst over the best known", "seeds", "evaluations")
    head = " | ".join(f"`{method}`: {cells[0]} | {' | '.join(cells[1:])}" for method in methods)
    lines = [f"| LiDARs × beams | best known (m) | {head} |", "|---" * (2 + len(cells) * len(methods)) + "|"]
    kept: dict[str, list[tuple[bool, bool]]] = {method: [] for method in methods}
    for study in STUDIES:
        least = known[study]["max_vsr_m"]
        row = []
        for method in methods:
            some = [run for run in runs if (run["study"], run["method"]) == (study, method)]
            if not some:
                row += ["–"] * len(cells)
                continue
            found = sorted(run["max_vsr_m"] for run in some)
            median, worst = statistics.median(found), found[-1]
            if len(found) >= SEEDS:
                kept[method].append((median <= least * (1 + MEDIAN), worst <= least * (1 + WORST)))
            row += [f"{found[0]:.4f} {median:.4f} {worst:.4f}", f"{median / least - 1:+.1%} {worst / least - 1:+.1%}"]
            row += [f"{len(found)}", f"{statistics.median(run['evaluations'] for run in some):,.0f}"]
        if any(cell != "–" for cell in row):
            lines.append(f"| {study.replace('x', ' × ')} | {least:.4f} | " + " | ".join(row) + " |")
    for method in methods:
        if not kept[method]:
            lines += ["", f"`{method}`: no study has {SEEDS} seeds yet, so none can keep the targets."]
            continue
        both = sum(median and worst for median, worst in kept[method])
        lines += [
            "",
            f"`{method}`: the median within {MEDIAN:.0%} and the worst within {WORST:.0%} on {both} of "
            f"{len(kept[method])} studies; the median on {sum(one for one, _ in kept[method])}, "
            f"the worst on {sum(one for _, one in kept[method])}.",
        ]
    return lines


def hunt(studies: list[str], seconds: float, threads: int, busy: bool) -> None:
    """Search for better rigs than the best known, in pieces, until so many seconds were spent on each study."""
    for study in studies:
        while (spent := json.loads(KNOWN.read_text())[study]["searched_s"]) < seconds:
            seed = FIRST_SEED + sum(run["study"] == study and run["seed"] >= FIRST_SEED for run in finished())
            run = search(study, "auto", seed, min(PIECE_S, seconds - spent), threads, busy)
            record(run)
            print(f"{study}: {run['max_vsr_m']:.6f} m, seed {seed}, {spent + run['seconds']:.0f} s", flush=True)
            best_known()


def compare(given: argparse.Namespace) -> None:
    """Run what is not finished, seed by seed, and print the table."""
    digest = code()
    for seed in given.seeds:
        for study in given.studies:
            for method in given.methods:
                budget = {"seconds": given.seconds, "threads": given.threads, "busy": given.busy}
                key = {"study": study, "method": method, "seed": seed, **budget, "code": digest}
                if not any(key.items() <= run.items() for run in finished()):
                    run = search(study, method, seed, **budget)
                    record(run)
                    print(f"{study} {method}, seed {seed}: {run['max_vsr_m']:.6f} m", flush=True)
    runs = [run for run in finished() if (run["code"], run["seconds"]) == (digest, given.seconds)]
    runs = [run for run in runs if (run["threads"], run["busy"]) == (given.threads, given.busy)]
    runs = [run for run in runs if run["seed"] < FIRST_SEED]
    loads = [run["load"] for run in runs]
    lasted = f"{given.seconds:g} s a search, {given.threads} threads"
    if given.busy:
        seconds = given.seconds * given.threads
        lasted = f"one thread of a busy machine, {seconds:g} s of the processor a search, as {lasted} have"
    lines = [
        f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}, {lasted}, "
        f"load {min(loads):.1f} to {max(loads):.1f}.",
        "",
        *compared(runs, given.methods, json.loads(KNOWN.read_text())),
    ]
    best_known()
    print("\n".join(lines))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--studies", nargs="+", choices=STUDIES, default=STUDIES)
    parser.add_argument("--methods", nargs="+", choices=SOLVERS, default=["auto", "annealing"])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(1, SEEDS + 1)))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--busy", action="store_true", help="other work is on the machine: count the processor's time")
    parser.add_argument("--best-known", type=float, metavar="SECONDS")
    given = parser.parse_args()
    if given.best_known:
        hunt(given.studies, given.best_known, given.threads, given.busy)
    else:
        compare(given)


if __name__ == "__main__":
    main()
