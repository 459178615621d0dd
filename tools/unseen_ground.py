#!/usr/bin/env python3
"""What a search gains by the vehicle's body: the ground that its rigs leave unseen, beside those of one without it.

    .venv/bin/python tools/unseen_ground.py            # prints the tables of docs/vehicles.md, draws its picture

Each study is searched with and without its body, with the same seeds and evaluations; all rigs are then evaluated with
the body. What they see of the ground is independent of any measure: Open3D casts the beams of one revolution at the
body and the ground, and a cell of the ground is seen if a return lies in it. Rigs that are in out/unseen are not
searched again.
"""

import argparse
import statistics
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import open3d as o3d

from lidarcfg.geometry import Array, transform
from lidarcfg.placement.evaluation import evaluate
from lidarcfg.placement.optimize import optimize
from lidarcfg.placement.study import Study, load_study, with_solver
from lidarcfg.report import new_figure, save_figure
from lidarcfg.rig import Rig, load_rig, save_rig

ROOT = Path(__file__).parent.parent
STUDIES = ("sedan", "truck")
NEAR_M, FAR_M = 10.0, 40.0  # of the ground that counts, from the middle of the vehicle
CELL_M = 0.5
STEP_DEG = 0.2  # of the azimuth: 1,800 firings a revolution, as a VLP-16 at 600 rpm


@dataclass(frozen=True)
class Found:
    """One rig, and what it does with the body."""

    rig: Rig
    max_vsr_m: float
    blind_m3: float
    unseen: float  # fraction of the cells from NEAR_M to FAR_M
    unseen_region: float  # the same of those in the study's region
    seen: np.ndarray  # (n, n) bool, by x and y, cells of the ground


def beams(rig: Rig) -> tuple[Array, Array]:
    """Origins and directions (N, 3) of all beams of one revolution, in the vehicle frame."""
    azimuth = np.radians(np.arange(0, 360, STEP_DEG))
    origins, directions = [], []
    for mount in rig.mounts:
        sensor, T = mount.sensor, mount.T_vehicle_sensor
        w, a = (part.ravel() for part in np.meshgrid(sensor.elevation_rad, azimuth, indexing="ij"))
        own = np.stack([np.cos(w) * np.cos(a), -np.cos(w) * np.sin(a), np.sin(w)], axis=1)
        up = np.zeros((len(w), 3))
        up[:, 2] = np.repeat(sensor.vertical_offset_m, len(azimuth))
        origins.append(transform(T, up))
        directions.append(own @ T[:3, :3].T)
    return np.concatenate(origins), np.concatenate(directions)


def seen_cells(rig: Rig, body: o3d.t.geometry.TriangleMesh) -> np.ndarray:
    """(n, n) bool: which cells of the ground up to FAR_M get a return, if the body is in the way."""
    origins, directions = beams(rig)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(body)
    hit = caster.cast_rays(o3d.core.Tensor(np.hstack([origins, directions]).astype(np.float32)))["t_hit"].numpy()
    with np.errstate(divide="ignore"):
        ground = np.where(directions[:, 2] < 0, -origins[:, 2] / directions[:, 2], np.inf)
    free = (ground < hit) & np.isfinite(ground)
    points = origins[free] + ground[free, None] * directions[free]
    n = round(2 * FAR_M / CELL_M)
    cell = np.floor((points[:, :2] + FAR_M) / CELL_M).astype(int)
    cell = cell[((cell >= 0) & (cell < n)).all(axis=1)]
    seen = np.zeros((n, n), np.bool_)
    seen[cell[:, 0], cell[:, 1]] = True
    return seen


def ring() -> tuple[np.ndarray, Array, Array]:
    """(n, n) which cells count, by their centres; and x and y of the centres."""
    centre = (np.arange(round(2 * FAR_M / CELL_M)) + 0.5) * CELL_M - FAR_M
    x, y = np.meshgrid(centre, centre, indexing="ij")
    far = np.hypot(x, y)
    return (far >= NEAR_M) & (far <= FAR_M), x, y


def measured(study: Study, rig: Rig, body: o3d.t.geometry.TriangleMesh) -> Found:
    """The rig, evaluated with the study's body."""
    found, seen = evaluate(study, rig), seen_cells(rig, body)
    counted, x, y = ring()
    low, high = study.region.min_m, study.region.max_m
    within = counted & (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
    blind_m3 = found.blind.volume_m3
    return Found(rig, found.max_vsr_m, blind_m3, 1 - seen[counted].mean(), 1 - seen[within].mean(), seen)


def search(study: Study, name: str, seed: int, evaluations: int, folder: Path) -> Rig:
    """The best rig of one search."""
    path = folder / f"{name}-{evaluations}-{seed}.yaml"
    if not path.exists():
        save_rig(optimize(with_solver(study, seed=seed, evaluations=evaluations), threads=1).rig, path)
    return load_rig(path)


def draw(found: dict[tuple[str, str], Found], bodies: dict[str, o3d.t.geometry.TriangleMesh], path: Path) -> None:
    """The ground of one rig of each kind, from above."""
    figure = new_figure(12, 12)
    counted, _, _ = ring()
    for axes, ((study, kind), one) in zip(
        figure.subplots(2, 2, sharex=True, sharey=True).flat, found.items(), strict=True
    ):
        shade = np.where(one.seen, 1.0, 0.0)
        shade[~counted] = np.nan
        edges = (-FAR_M, FAR_M, -FAR_M, FAR_M)
        axes.imshow(shade.T, origin="lower", extent=edges, cmap="cividis", interpolation="nearest")
        corners = bodies[study].vertex.positions.numpy()[bodies[study].triangle.indices.numpy()]
        axes.fill(*corners[..., :2].transpose(2, 1, 0), color="black")
        axes.scatter(*np.array([mount.position_m[:2] for mount in one.rig.mounts]).T, s=14, color="tab:red", zorder=3)
        axes.set_title(f"{study}, found {kind} the body: {one.unseen:.1%} unseen", fontsize=11)
        axes.set(xlabel="x (m)", ylabel="y (m)")
    save_figure(figure, path)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluations", type=int, default=5000)
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    folder, first, bodies = ROOT / "out/unseen", {}, {}
    folder.mkdir(parents=True, exist_ok=True)
    print("| study | search | max VSR with the body (m) | blind volume (m³) | ground unseen | of it in the region |")
    print("|---|---|---|---|---|---|")
    for name in STUDIES:
        study = load_study(ROOT / f"data/studies/{name}.yaml")
        bodies[name] = o3d.t.io.read_triangle_mesh(str(ROOT / f"data/vehicles/{name}.ply"))
        for kind, searched in (("without", replace(study, visibility=None)), ("with", study)):
            rigs = [
                search(searched, f"{name}-{kind}", seed, given.evaluations, folder)
                for seed in range(1, given.seeds + 1)
            ]
            found = [measured(study, rig, bodies[name]) for rig in rigs]
            first[name, kind] = found[0]
            cells = [
                spread([one.max_vsr_m for one in found], ".4f"),
                spread([one.blind_m3 for one in found], ".1f"),
                spread([100 * one.unseen for one in found], ".1f") + " %",
                spread([100 * one.unseen_region for one in found], ".1f") + " %",
            ]
            print(f"| {name} | {kind} the body | " + " | ".join(cells) + " |", flush=True)
    draw(first, bodies, ROOT / "docs/unseen-ground.png")


def spread(values: list[float], form: str) -> str:
    """Median, least and most."""
    return f"{statistics.median(values):{form}} ({min(values):{form}} to {max(values):{form}})"


if __name__ == "__main__":
    main()
