"""Who else says what rigs miss? A detector that was trained on simulated clouds, and Open3D's rays.

Usage: .venv/bin/python tools/validate_misses.py [learned-judge] [outside-judge] [--places 600]

Writes sections of docs/evidence/validation.md: how misses of 23 rigs (data/reference/learned_judge.json) rank them
beside what the detector sees, with a plot; and the misses of ten rigs beside those of tools/judge_misses.py.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import judge_misses as judge
import numpy as np
import open3d as o3d
import yaml
from page import ROOT, machine, table, write_section
from scipy.stats import spearmanr

from lidarcfg.geometry import Array
from lidarcfg.report.plots import COLOURS, new_figure, save_figure
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.sensors.rig import Rig, save_rig
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study

PAGE = ROOT / "docs/evidence/validation.md"
PLOT = PAGE.parent / "validation/learned-judge.png"
RETURNS = range(1, 11)
NAMED = {
    "smallest max VSR": "smallest max VSR",
    "by hand, roof tilted 12°": "by hand, tilted",
    "upright, all low, roof along x": "by hand, upright",
    "annealed, 64 places": "searched by misses",
}
STUDIES = {"sedan": 2, "truck": 1, "bus": 1}  # random rigs of each
BUS = "os1-64", "pandar-xt32", "vlp-16"  # its sensors on the roof, in front and at the rear


def rho(values: Array, mean_precision: Array) -> float:
    """Spearman's."""
    return float(spearmanr(values, mean_precision).statistic)


def learned_judge() -> None:
    """How misses rank rigs beside what a detector sees: the table and the plot."""
    rigs = json.loads((ROOT / "data/reference/learned_judge.json").read_text())["rigs"]
    study = load_study(ROOT / "data/studies/sedan.yaml")
    assert study.misses
    mounts = [study.rig(np.array(one["poses"])).mounts for one in rigs]
    own = np.array(
        [
            [replace(study.misses, returns=least).found_at(study.misses.fresh, one).mean for least in RETURNS]
            for one in mounts
        ]
    )
    judge = np.array([one["missed_percent"] for one in rigs]) / 100
    precision = np.array([np.mean(one["ap"]) for one in rigs])
    max_vsr_m = np.array([one["max_vsr_m"][0] for one in rigs])
    rows = [
        ("misses by lidarcfg", *(f"{rho(column, precision):.2f}" for column in own.T)),
        ("misses by `tools/judge_misses.py`'s objects", *(f"{rho(column, precision):.2f}" for column in judge.T)),
    ]
    write_section("learned-judge", table(("fewer returns than", *RETURNS), rows), PAGE)
    draw(100 * own[:, 2], max_vsr_m, precision, [one["name"] for one in rigs])


def draw(missed_percent: Array, max_vsr_m: Array, precision: Array, names: Sequence[str]) -> None:
    """The detector's mAP of rigs over both measures."""
    figure = new_figure(10, 4.2)
    for axes, values, label in zip(
        figure.subplots(1, 2, sharey=True),
        (missed_percent, max_vsr_m),
        ("misses: places with fewer than 3 returns (%)", "max VSR with the body (m)"),
        strict=True,
    ):
        axes.plot(values, precision, "o", color=COLOURS[0], ms=5, alpha=0.8)
        axes.set(xlabel=label, title=f"ρ = {rho(values, precision):.2f}")
        axes.grid(alpha=0.3)
        axes.margins(x=0.2)
        for x, y, name in zip(values, precision, names, strict=True):
            if name in NAMED:
                axes.plot(x, y, "o", color=COLOURS[5], ms=6)
                axes.annotate(NAMED[name], (x, y), (8, 2), textcoords="offset points", fontsize=8)
    figure.axes[0].set_ylabel("mAP of the detector")
    save_figure(figure, PLOT)


def vehicle(name: str) -> Study:
    """The study of a vehicle, without requirements; where it lets one choose, with models for it."""
    values = yaml.safe_load((ROOT / f"data/studies/{name}.yaml").read_text())
    for key in ("requirements", "prices", "robust"):
        values.pop(key, None)
    for sensor, model in zip(values["sensors"], BUS, strict=False):
        if sensor.pop("choose", None):
            sensor["model"] = model
    for mesh in values["vehicle"]["meshes"]:
        mesh["file"] = str(ROOT / f"data/vehicles/{Path(mesh['file']).name}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.yaml"
        path.write_text(yaml.safe_dump(values))
        return load_study(path)


def ten_rigs() -> Iterator[tuple[str, str, Study, Rig]]:
    """Of each vehicle its name, a rig's name, the study and the rig: the midpoint, random ones, and an upright one."""
    for name, count in STUDIES.items():
        study = vehicle(name)
        rng = np.random.default_rng(1)
        yield name, "midpoint", study, study.rig(study.space.midpoint)
        for number in range(count):
            poses = study.space.poses(rng.random((1, study.space.dimensions)))
            while study.space.violation(poses)[0] > 0:
                poses = study.space.poses(rng.random((1, study.space.dimensions)))
            yield name, f"random {number + 1}", study, study.rig(poses[0])
        yield name, "upright", study, study.rig(study.space.poses(plain_points(study)[1:2])[0])


def judged(vehicle: str, rig: Rig, folder: Path | None, places: int, seed: int = 1) -> tuple[float, float]:
    """The misses of a rig by the outside judge with objects of its own or of a folder, and their standard error."""
    body = o3d.io.read_triangle_mesh(str(ROOT / f"data/vehicles/{vehicle}.ply"))
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "rig.yaml"
        save_rig(rig, path)
        found = judge.counts(path, body, judge.things(folder), places, 20.0, seed)
    shares = np.array([(values < 3).mean() for values in found.values()])
    return float(shares.mean()), math.sqrt(float((shares * (1 - shares)).sum()) / places) / len(shares)


def outside_judge(places: int) -> None:
    """The misses of ten rigs, beside those by Open3D's rays with the same objects and with others."""
    rows = []
    for name, kind, study, rig in ten_rigs():
        assert study.misses
        own = study.misses.found(rig.mounts)
        cells = [f"{own.mean:.2%} ({own.interval[0]:.2%} to {own.interval[1]:.2%})"]
        for folder in (ROOT / "data/objects", None):
            mean, error = judged(name, rig, folder, places)
            cells.append(f"{mean:.2%} (± {judge.Z_95 * error:.2%})")
        rows.append((name, kind, *cells))
    header = "vehicle", "rig", "lidarcfg", "Open3D, the same objects", "Open3D, its own objects"
    write_section("outside-judge", [machine().partition(", Python")[0] + ":", "", *table(header, rows)], PAGE)


def main() -> None:
    """Write sections."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", default=["learned-judge", "outside-judge"])
    parser.add_argument("--places", type=int, default=600, help="of each object, for the outside judge")
    given = parser.parse_args()
    if "learned-judge" in given.sections:
        learned_judge()
    if "outside-judge" in given.sections:
        outside_judge(given.places)


if __name__ == "__main__":
    main()
