"""What the weights of an objective do: searches of one study with other weights, evaluated alike.

Usage: .venv/bin/python tools/measure_weights.py          (writes the table of docs/objectives.md; five minutes)
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from page import ROOT, table, write_section

import lidarcfg
from lidarcfg.placement.study import Study

STUDY = ROOT / "data/studies/sedan.yaml"
EVALUATIONS, SEEDS = 1500, (1, 2, 3)
OBJECTIVES: tuple[dict[str, Any], ...] = (
    {"max_vsr": 1.0},
    {"max_vsr": 1.0, "detection": {"lost_cargo": 0.2}},
    {"max_vsr": 1.0, "detection": {"lost_cargo": 2.0}},
    {"detection": {"lost_cargo": 1.0}},
    {"max_vsr": 1.0, "seen_by_two": 5.0},
)
HEADER = "objective", "max VSR (m)", "child", "lost cargo", "volume seen by two", "seconds"


def main() -> None:
    """Searches, and writes the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    rows = []
    for objective in OBJECTIVES:
        middle = np.median([figures(objective, seed) for seed in SEEDS], axis=0)
        shown = ", ".join(f"{key}: {_plain(value)}" for key, value in objective.items())
        rows.append(
            [f"`{{{shown}}}`", f"{middle[0]:.3f}", *(f"{value:.1%}" for value in middle[1:4]), f"{middle[4]:.0f}"]
        )
        print(rows[-1], flush=True)
    how = f"{STUDY.stem}, {EVALUATIONS:,} evaluations, medians of {len(SEEDS)} seeds; "
    when = f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}."
    write_section("weights", [how + when, "", *table(HEADER, rows)], ROOT / "docs/objectives.md")


def figures(objective: dict[str, Any], seed: int) -> list[float]:
    """Max VSR, detection rates, the volume that two sensors see, and the seconds of a search."""
    began = time.perf_counter()
    study = changed(objective, seed)
    rig = lidarcfg.optimize(study).rig
    seconds = time.perf_counter() - began
    found = lidarcfg.evaluate(study, rig)
    rates = [found.detection[name].rate for name in ("child", "lost_cargo")]
    volumes = np.array(found.blind.seen_by_m3)
    return [found.max_vsr_m, *rates, float(volumes[2:].sum() / volumes.sum()), seconds]


def changed(objective: dict[str, Any], seed: int) -> Study:
    """The study with another objective and a budget of its own."""
    values = yaml.safe_load(STUDY.read_text())
    values |= {"objective": objective, "solver": {"method": "auto", "evaluations": EVALUATIONS, "seed": seed}}
    for mesh in values["vehicle"]["meshes"]:
        mesh["file"] = str((STUDY.parent / mesh["file"]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.yaml").write_text(yaml.safe_dump(values))
        return lidarcfg.load_study(Path(folder) / "study.yaml")


def _plain(value: Any) -> str:
    return (
        "{" + ", ".join(f"{key}: {one:g}" for key, one in value.items()) + "}"
        if isinstance(value, dict)
        else f"{value:g}"
    )


if __name__ == "__main__":
    main()
