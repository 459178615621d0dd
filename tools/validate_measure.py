"""Does a smaller max VSR see more? Measures of rigs against the returns that they get from objects around them.

For each study: rigs at random and the best of short searches; what each measure says of them; and how often objects
around the vehicle give too few returns in one revolution, by the sensors' real firing pattern, past the vehicle's body.
Rank correlations of the two, with intervals by bootstrap over the rigs, go to docs/evidence/validation.md
with their plots.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from page import ROOT, table, write_section
from PIL import Image
from scipy.stats import qmc, rankdata

import lidarcfg
from lidarcfg import core
from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.geometry import Array, rotation
from lidarcfg.packets.families import pattern
from lidarcfg.report.plots import COLOURS, new_figure, save_figure
from lidarcfg.returns.scanners import Poses, Scanner, compiled
from lidarcfg.returns.target import Target
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study, with_solver
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.detection import DetectionObject, detection_by_distance, from_point
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.subspaces import Subspaces, segment
from lidarcfg.vsr.visibility import fraction_below
from lidarcfg.world.meshes import read_mesh
from lidarcfg.world.tracer import NO_OBSTACLES

STUDIES = tuple(ROOT / f"data/studies/{name}.yaml" for name in ("sedan", "truck", "liu2018-4x16"))
MESHES = ROOT / "data/objects"
OBJECTS = ("pedestrian", "child", "cyclist", "car", "tyre")
EDGES_M = np.array([0.0, 6.0, 12.0, 20.0, 30.0])  # rings about the vehicle's reference point
RINGS = tuple(f"{low:g} to {high:g} m" for low, high in pairwise(EDGES_M))
SEARCHED = 0.4  # of the rigs; the others are at random
BUDGETS = (30, 250)  # evaluations of the shortest and the longest search
RESAMPLES = 2000
SPREAD = 0.01  # of undetected places between rigs; below it there is nothing to rank
PAGE = ROOT / "docs/evidence/validation.md"
MEASURES = {  # as result.json would call them; all the better, the smaller
    "max_vsr": "max VSR (the paper's)",
    "max_vsr_body": "max VSR with the body",
    "paper": "1 − the paper's detection",
    "blind": "blind volume",
    "below_two": "volume not seen by two",
}


@dataclass(frozen=True)
class Rigs:
    """What is known of R rigs of a study."""

    study: str
    searched: NDArray[np.bool_]  # (R,) the best of a short search; else at random
    measures: dict[str, Array]  # (R,), but the paper's detection: (R, objects, rings)
    undetected: Array  # (R, objects, rings) the fraction of places, and of phases, with too few returns


def drawn_places(study: Study, size_m: Array, count: int) -> Iterator[Array]:
    """(count, 4) places and headings of an object in each ring, clear of the body and of what is excluded."""
    center = study.space.reference_m
    around = float(np.hypot(*size_m[:2])) / 2
    region = study.region
    low, high = region.min_m[:2] + around, region.max_m[:2] - around
    layers = max(math.ceil(size_m[2] / region.cuboid_m[2]), 1)
    taken = (~region.included[:, :, :layers]).any(axis=2)
    points = qmc.Sobol(3, rng=np.random.default_rng(1)).random(2**16)
    where = low + points[:, :2] * (high - low)
    far = np.hypot(*(where - center).T)
    free = (study.body.to_points_m(where) if study.body else far) > around
    for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (0.7, 0.7), (0.7, -0.7), (-0.7, 0.7), (-0.7, -0.7)):
        i, j = (((where + around * np.array([dx, dy])) - region.min_m[:2]) / region.cuboid_m[:2]).astype(int).T
        free &= ~taken[i.clip(0, region.shape[0] - 1), j.clip(0, region.shape[1] - 1)]
    for first, last in pairwise(EDGES_M):
        some = np.flatnonzero(free & (far >= first) & (far < last))[:count]
        floor = np.full(len(some), region.min_m[2])
        yield np.column_stack([where[some], floor, 2 * np.pi * points[some, 2]])


def scanners(rig: Rig) -> list[Scanner]:
    """Its sensors, as they fire."""
    out = []
    for mount in rig.mounts:
        known = mount.sensor.range
        range_m = mount.range_m or ((known.min_m, known.max_m) if known else (0.0, COORDINATE_MAX_M))
        out.append(Scanner(mount.sensor, pattern(mount), (range_m[0], range_m[1]), mount.azimuth_fov_deg))
    return out


def within(study: Study, pose: Array) -> bool:
    """Whether a sensor at a pose is inside a body, where it sees nothing."""
    return study.vehicle is not None and study.vehicle.body_at(pose[:3]) is not None


def drawn_rigs(study: Study, count: int) -> tuple[list[Rig], list[bool]]:
    """Rigs at random, within the constraints, none inside the body; then the best of searches."""
    rng = np.random.default_rng(1)
    rigs: list[Rig] = []
    searched = round(SEARCHED * count)
    while len(rigs) < count - searched:
        poses = study.space.poses(rng.random((1, study.space.dimensions)))
        if study.space.violation(poses)[0] == 0.0 and not any(within(study, pose) for pose in poses[0]):
            rigs.append(study.rig(poses[0]))
    for seed, budget in enumerate(np.geomspace(*BUDGETS, searched).round().astype(int).tolist(), 1):
        task = replace(study, visibility=None) if seed % 2 else study
        rigs.append(optimize(with_solver(task, method="auto", evaluations=budget, seed=seed)).rig)
    return rigs, [False] * (count - searched) + [True] * searched


def measured(study: Study, rig: Rig, sizes: dict[str, Array]) -> dict[str, Array]:
    """What each measure says of a rig."""
    lidars = rig_lidars(rig)
    region = study.region
    paper = segment(region, lidars)
    found = {
        "max_vsr": np.float64(vsr_m(paper).max()),
        "paper": np.array([paper_undetected(study, paper, name, size) for name, size in sizes.items()]),
    }
    if study.visibility:
        body = segment(region, lidars, study.visibility)
        found |= {
            "max_vsr_body": np.float64(vsr_m(body).max()),
            "blind": np.float64(fraction_below(region, body.seen_by, 1)),
            "below_two": np.float64(fraction_below(region, body.seen_by, 2)),
        }
    return {key: np.asarray(value, np.float64) for key, value in found.items()}


def paper_undetected(study: Study, paper: Subspaces, name: str, size_m: Array) -> Array:
    """(rings,) 1 − the paper's detection rate of an object's bounding box on the ground; NaN without a place."""
    x, y, z = size_m.tolist()
    item = DetectionObject(name=name, size_m=(x, y, z), on_ground=True)
    out: Array = 1 - detection_by_distance(paper, item, from_point(study.space.reference_m), EDGES_M).rate
    return out


def undetected(study: Study, rig: Rig, targets: dict[str, Target], where: dict[str, list[Array]], least: int) -> Array:
    """(objects, rings) the fraction of places, and of phases, with fewer returns than `least`."""
    firing = compiled(scanners(rig))
    R = np.array([rotation(mount.rpy_rad) for mount in rig.mounts])
    poses = Poses(R, np.array([mount.position_m for mount in rig.mounts], np.float64))
    obstacles = study.visibility.obstacles if study.visibility else NO_OBSTACLES
    out = np.empty((len(targets), len(RINGS)))
    for n, (name, target) in enumerate(targets.items()):
        for ring, places in enumerate(where[name]):
            ends = np.array([len(places)])
            known = core.returns.KnownReturns(firing, [target.shape], places, ends, obstacles)
            out[n, ring] = known.missed(np.arange(len(firing)), *poses, 0, least, math.inf) / len(places)
    return out


def validate(path: Path, count: int, places: int, least: int) -> Rigs:
    """All rigs of a study, with what the measures say and what returns."""
    study = load_study(path)
    targets = {name: Target(read_mesh(MESHES / f"{name}.ply")) for name in OBJECTS}
    sizes = {name: target.size_m for name, target in targets.items()}
    where = {name: list(drawn_places(study, size, places)) for name, size in sizes.items()}
    rigs, searched = drawn_rigs(study, count)
    with ThreadPoolExecutor() as pool:
        found = list(pool.map(lambda rig: measured(study, rig, sizes), rigs))
        missed = list(pool.map(lambda rig: undetected(study, rig, targets, where, least), rigs))
    measures = {key: np.array([one[key] for one in found]) for key in found[0]}
    return Rigs(path.stem, np.array(searched), measures, np.array(missed))


def correlation(one: Array, other: Array) -> tuple[float, float, float]:
    """Spearman's rank correlation of two columns (R,), and the ends of its 95 % interval by bootstrap over rows."""
    draw = np.random.default_rng(1).integers(len(one), size=(RESAMPLES, len(one)))
    rows = np.concatenate([np.arange(len(one))[None], draw])
    a, b = (rankdata(column[rows], axis=1) for column in (one, other))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    scale = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    rho = np.divide((a * b).sum(axis=1), scale, out=np.zeros(len(rows)), where=scale > 0)
    low, high = np.quantile(rho[1:], (0.025, 0.975))
    return float(rho[0]), float(low), float(high)


def outcome(values: Array, item: int | None = None, ring: int | None = None) -> Array:
    """(R,) the mean of values (R, objects, rings) over the cells of an object, of a ring, or over all."""
    part = values[:, slice(None) if item is None else slice(item, item + 1)]
    part = part[:, :, slice(None) if ring is None else slice(ring, ring + 1)]
    out: Array = np.nanmean(part, axis=(1, 2))
    return out


def of_measure(rigs: Rigs, key: str, item: int | None = None, ring: int | None = None) -> Array:
    """(R,) a measure; the paper's detection of the same object at the same distance."""
    values = rigs.measures[key]
    return values if values.ndim == 1 else outcome(values, item, ring)


def ranked(rigs: Rigs, key: str, item: int | None = None, ring: int | None = None, only: slice = slice(None)) -> str:
    """The rank correlation of a measure with what goes undetected, and its interval, in words of a table."""
    if key not in rigs.measures:
        return "–"
    missed = outcome(rigs.undetected, item, ring)[only]
    value = of_measure(rigs, key, item, ring)[only]
    if np.ptp(missed) < SPREAD or np.ptp(value) == 0:
        return "–"
    rho, low, high = correlation(value, missed)
    text = f"{rho:.2f} ({low:.2f} to {high:.2f})"
    return f"**{text}**" if low > 0 else text


def by_study(all_rigs: Sequence[Rigs]) -> list[str]:
    """Rank correlations over all objects and distances: all rigs, and those at random."""
    rows = []
    for rigs in all_rigs:
        random = slice(0, int((~rigs.searched).sum()))
        rows += [
            (rigs.study, name, ranked(rigs, key), ranked(rigs, key, only=random), *picked(rigs, key))
            for key, name in MEASURES.items()
            if key in rigs.measures
        ]
        missed = np.sort(outcome(rigs.undetected))
        least = f"{missed[:10].mean():.1%}", f"{missed[0]:.1%}"
        rows.append((rigs.study, f"*what truly misses least; all rigs: {missed.mean():.1%}*", "", "", *least))
    return table(("study", "measure", "all rigs", "rigs at random", "its ten best rigs miss", "its best misses"), rows)


def picked(rigs: Rigs, key: str) -> tuple[str, str]:
    """What goes undetected by the ten rigs that a measure takes for the best, and by the best of them."""
    missed = outcome(rigs.undetected)
    order = np.argsort(of_measure(rigs, key), kind="stable")
    return f"{missed[order[:10]].mean():.1%}", f"{missed[order[0]]:.1%}"


def draw(rigs: Rigs, path: Path) -> None:
    """Each measure against what goes undetected; and the rank correlations by object and distance."""
    keys = [key for key in MEASURES if key in rigs.measures]
    rows = -(-len(keys) // 3)
    figure = new_figure(12, 3.6 + 2.7 * rows)
    top, bottom = figure.subfigures(2, 1, height_ratios=(0.75 * rows, 1))
    panels = top.subplots(rows, 3, sharey=True).ravel()
    missed = 100 * outcome(rigs.undetected)
    for axes, key in zip(panels, keys, strict=False):
        for which, name in ((~rigs.searched, "at random"), (rigs.searched, "best of a search")):
            mark = "^" if name != "at random" else "o"
            colour = COLOURS[5 if name != "at random" else 0]
            axes.plot(of_measure(rigs, key)[which], missed[which], mark, color=colour, ms=4, alpha=0.7, label=name)
        rho, low, high = correlation(of_measure(rigs, key), outcome(rigs.undetected))
        axes.set_title(f"ρ = {rho:.2f} ({low:.2f} to {high:.2f})", fontsize=9)
        axes.set_xlabel(MEASURES[key] + " (m)" * ("max VSR" in MEASURES[key]), fontsize=8)
        axes.locator_params(axis="x", nbins=6)
        axes.grid(alpha=0.3)
    for axes in panels[len(keys) :]:
        axes.set_visible(False)
    for axes in panels[::3]:
        axes.set_ylabel("undetected (%)")
    panels[0].legend(fontsize=7)
    cells = [(n, m) for n in range(len(OBJECTS)) for m in range(len(RINGS))]
    grid = np.full((len(keys), len(cells)), np.nan)
    for i, key in enumerate(keys):
        for j, (item, ring) in enumerate(cells):
            truth = outcome(rigs.undetected, item, ring)
            value = of_measure(rigs, key, item, ring)
            if np.ptp(truth) >= SPREAD and np.ptp(value) > 0:
                grid[i, j] = correlation(value, truth)[0]
    axes = bottom.subplots()
    image = axes.imshow(grid, cmap="RdBu", vmin=-1, vmax=1, aspect="auto")
    for i, j in np.argwhere(np.isfinite(grid)):
        axes.text(j, i, f"{grid[i, j]:.2f}", ha="center", va="center", fontsize=7)
    axes.set_yticks(range(len(keys)), [MEASURES[key] for key in keys], fontsize=8)
    names = [f"{OBJECTS[n]}\n{RINGS[m].replace(' to ', '–')}" for n, m in cells]
    axes.set_xticks(range(len(cells)), names, fontsize=6.5, rotation=60)
    bottom.colorbar(image, ax=axes, label="ρ", pad=0.01)
    bottom.suptitle(
        "rank correlation by object and distance; white: rigs hardly differ there, or the measure does not", fontsize=9
    )
    save_figure(figure, path)
    picture = Image.open(path).convert("RGB")
    picture.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)


def saved(path: Path, study: Path, asked: dict[str, int]) -> Rigs:
    """The rigs of a study, from a file that the same task left there; else computed, and written there."""
    if path.exists():
        with np.load(path) as file:
            if json.loads(str(file["asked"])) == asked:
                measures = {key: file[key] for key in MEASURES if key in file}
                return Rigs(study.stem, file["searched"], measures, file["undetected"])
    rigs = validate(study, asked["rigs"], asked["places"], asked["least"])
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {"searched": rigs.searched, "undetected": rigs.undetected}
    np.savez_compressed(path, asked=json.dumps(asked), **columns, **rigs.measures)
    return rigs


def main() -> None:
    """Validates, and writes docs/evidence/validation.md and its plots, unless they are to go elsewhere."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", type=Path, default=STUDIES)
    parser.add_argument("--rigs", type=int, default=100, help="of each study")
    parser.add_argument("--places", type=int, default=48, help="of each object in each ring")
    parser.add_argument("--least", type=int, default=10, help="returns that make an object detected")
    parser.add_argument("--results", type=Path, default=ROOT / "out/validation", help="studies found here are not run")
    parser.add_argument("--plots", type=Path, default=ROOT / "docs/evidence/validation")
    parser.add_argument("--page", type=Path, default=PAGE, help="with the sections' markers")
    given = parser.parse_args()
    asked = {"rigs": given.rigs, "places": given.places, "least": given.least}
    all_rigs = [saved(given.results / f"{study.stem}.npz", study, asked) for study in given.studies]
    given.plots.mkdir(parents=True, exist_ok=True)
    for rigs in all_rigs:
        draw(rigs, given.plots / f"{rigs.study}.png")
    how = (
        f"{given.rigs} rigs a study, {given.places} places an object and ring; undetected: below {given.least} returns."
    )
    when = f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}."
    write_section("studies", [when, how, "", *by_study(all_rigs)], given.page)


if __name__ == "__main__":
    main()
