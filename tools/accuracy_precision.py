"""float32 beside float64: wrong labels, wrong ranges, and the speed that either gives."""

# mypy: disallow-untyped-decorators=False
import time
from functools import partial
from pathlib import Path

import numpy as np
import open3d as o3d
from accuracy_rays import facets
from numba import njit
from numpy.typing import NDArray
from page import ROOT, table

from lidarcfg.geometry import Array, directions
from lidarcfg.placement.cones import Lidar
from lidarcfg.placement.grid import beam_gaps
from lidarcfg.placement.region import Region
from lidarcfg.placement.study import load_study
from lidarcfg.report import COLOURS, new_figure, save_figure
from lidarcfg.sensor import load_sensor
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from tests.naive.rays import first_triangle
from tests.ray_cases import mesh_scene, open3d_scene

STREET = ROOT / "data/scenes/street.yaml"
OURS, RELATIVE = "float64, as captures are traced", "float32, relative"
RAYS = (OURS, RELATIVE, "float32")
OTHER_SURFACE_MM = 1.0  # further off, a ray has hit something else
AWAY_M = (0.0, 1e2, 1e3, 1e4, 1e5, 1e6)


@njit(cache=True, nogil=True)
def digits(x: Array, y: Array, z: Array, position: Array, axis: Array, limit: Array, out: NDArray[np.uint8]) -> None:
    """The comparison of core/placement/linker.cpp, cuboid by cuboid, in the precision of its arguments."""
    for i in range(len(x)):
        for j in range(len(y)):
            for k in range(len(z)):
                dx, dy, dz = x[i] - position[0], y[j] - position[1], z[k] - position[2]
                height = (dx * axis[0] + dy * axis[1]) + dz * axis[2]
                square, signed = (dx * dx + dy * dy) + dz * dz, height * abs(height)
                count = 0
                for b in range(len(limit)):
                    count += signed >= limit[b] * square
                out[i, j, k] = count


def labelled(region: Region, lidar: Lidar, away_m: float, dtype: type, local: bool) -> tuple[NDArray[np.uint8], float]:
    """The digits of one LiDAR in a precision, and the seconds; the study stands `away_m` from the origin.

    `local`: positions relative to the LiDAR are taken in float64 first.
    """
    arrays = [axis + away_m for axis in region.centres()]
    position = lidar.position_m + away_m
    if local:
        arrays = [axis - at for axis, at in zip(arrays, position, strict=True)]
        position = np.zeros(3)
    limit = lidar.sin_elevation * abs(lidar.sin_elevation)
    given = [np.ascontiguousarray(array, dtype) for array in (*arrays, position, lidar.axis, limit)]
    out = np.empty(region.shape, np.uint8)
    started = time.process_time()
    digits(*given, out)
    return out, time.process_time() - started


def labels(quick: bool) -> tuple[list[str], dict[str, list[float]]]:
    """The table of wrong labels, and their numbers by precision."""
    study = load_study(ROOT / "data/studies/liu2018-4x16.yaml")
    cut = 1 if quick else 2  # of the paper's edges
    region = Region.from_boxes(study.region.min_m, study.region.max_m, study.region.cuboid_m / cut)
    rng = np.random.default_rng(1)
    poses = study.poses(rng.random((1 if quick else 10, int(study.free.sum()))))
    lidars = [lidar for rig in poses for lidar in study.lidars(rig)]
    truth = [beam_gaps(region, lidar) for lidar in lidars]
    wrong: dict[str, list[float]] = {}
    seconds: dict[str, list[float]] = {}
    methods = {"float64": (np.float64, False), "float32, relative": (np.float32, True), "float32": (np.float32, False)}
    for name, (dtype, local) in methods.items():
        labelled(region, lidars[0], 0.0, dtype, local)  # compiles
        for away_m in AWAY_M:
            fraction = []
            for lidar, right in zip(lidars, truth, strict=True):
                found, took = labelled(region, lidar, away_m, dtype, local)
                fraction.append(np.mean(found != right))
                seconds.setdefault(name, []).append(took)
            wrong.setdefault(name, []).append(1e6 * float(np.mean(fraction)))
    cells = region.included.size
    rows = [
        (name, f"{cells / np.median(seconds[name]) / 1e6:.0f}", *(f"{value:,.2f}" for value in values))
        for name, values in wrong.items()
    ]
    header = ("labels in", "million cuboids/s", *(f"{away_m:g} m" for away_m in AWAY_M))
    return [
        *table(header, rows),
        "",
        f"Wrong digits per million, {len(lidars)} LiDARs × {cells:,} cuboids, by how far the study stands from the "
        "origin. One plain loop in either precision, one thread.",
    ], wrong


def rays(quick: bool) -> tuple[list[str], dict[str, list[float]]]:
    """The table of range errors, and their 99.9 % quantiles by precision."""
    count, repeats = (2_000, 1) if quick else (60_000, 10)
    scene = load_scene(STREET)
    vertices, triangles = facets(scene)
    rng = np.random.default_rng(1)
    elevation = np.sort(rng.choice(load_sensor("vlp-16").elevation_rad, count))
    azimuth = rng.uniform(0, 2 * np.pi, count)
    order = np.lexsort((azimuth, elevation))  # laser by laser, as captures are traced
    towards = directions(azimuth[order], elevation[order])
    start = np.array([0.3, 0.5, 1.9])
    truth, which = first_triangle(vertices, triangles, np.tile(start, (count, 1)), towards)
    many = np.repeat(towards, repeats, axis=0)
    rows: list[tuple[str, ...]] = []
    most: dict[str, list[float]] = {}
    for name in RAYS:
        for away_m in AWAY_M:
            offset = np.array([away_m, away_m, 0.0])
            if name == OURS:
                tracer = Tracer(mesh_scene(vertices + offset, triangles), start + offset)
                cast = partial(ours, tracer, start + offset)
            else:
                base = start + offset if name == RELATIVE else np.zeros(3)
                cast = partial(plain, open3d_scene(vertices + offset - base, triangles), start + offset - base)
            cast(many[:100])
            started = time.process_time()
            range_m, triangle = cast(many)
            seconds = time.process_time() - started
            range_m, same = range_m[::repeats], triangle[::repeats] == which
            hit = np.isfinite(range_m) & np.isfinite(truth)
            error_mm = 1000 * abs(np.subtract(range_m, truth, where=hit, out=np.zeros(count)))
            other = (np.isfinite(range_m) != np.isfinite(truth)) | ~same & (error_mm > OTHER_SURFACE_MM)
            error_mm = error_mm[hit & ~other]
            middle, high = np.quantile(error_mm, (0.5, 0.999))
            most.setdefault(name, []).append(float(high))
            figures = (f"{value:.3g}" for value in (middle, high, error_mm.max()))
            speed = f"{len(many) / seconds / 1e6:.1f}"
            rows.append((name, f"{away_m:g}", speed, *figures, f"{1e6 * other.mean():,.0f}"))
    header = (
        "rays in",
        "away (m)",
        "million rays/s",
        "median (mm)",
        "99.9 % (mm)",
        "worst (mm)",
        "other surface (per million)",
    )
    return [
        *table(header, rows),
        "",
        f"{count:,} rays of a VLP-16 in the street, {len(triangles):,} triangles, per second of processor time; truth: "
        f"every triangle in float64. Another surface: another triangle, further off than {OTHER_SURFACE_MM:g} mm.",
    ], most


def plain(scene: o3d.t.geometry.RaycastingScene, start: Array, towards: Array) -> tuple[Array, NDArray[np.int64]]:
    """Ranges and triangles (N,) as Open3D gives them."""
    given = np.hstack([np.tile(start, (len(towards), 1)), towards]).astype(np.float32)
    hits = scene.cast_rays(o3d.core.Tensor.from_numpy(given), nthreads=1)
    return hits["t_hit"].numpy().astype(np.float64), hits["primitive_ids"].numpy().astype(np.int64)


def ours(tracer: Tracer, start: Array, towards: Array) -> tuple[Array, NDArray[np.int64]]:
    """Ranges and triangles (N,) as a capture has them."""
    hits = tracer.cast(np.tile(start, (len(towards), 1)), towards)
    return hits.range_m, hits.triangle.astype(np.int64)


def run(quick: bool, plots: Path) -> list[str]:
    """The section's lines; draws precision.png."""
    label_lines, wrong = labels(quick)
    ray_lines, most = rays(quick)
    figure = new_figure(9, 4)
    left, right = figure.subplots(1, 2)
    for axes, values, unit in ((left, wrong, "wrong labels (per million)"), (right, most, "99.9 % range error (mm)")):
        for (name, line), style, colour in zip(values.items(), ("s-", "^--", "o-"), COLOURS, strict=False):
            axes.plot(AWAY_M, line, style, color=colour, label=name)
        axes.set_xscale("symlog", linthresh=100.0)
        axes.set_yscale("symlog", linthresh=0.1 if axes is left else 1e-3)
        axes.set(xlabel="distance of the study or scene from the origin (m)", ylabel=unit, ylim=(0, None))
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save_figure(figure, plots / "precision.png")
    return [*label_lines, "", *ray_lines]
