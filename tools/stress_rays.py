"""Millions of rays: at shared edges and vertices, beside Open3D's, and against exact arithmetic; rows of stress.py."""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from bench_capture import pave
from page import ROOT

sys.path.insert(0, str(ROOT))

from lidarcfg.geometry import Array
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import Tracer
from tests import ray_cases

Row = tuple[str, int, int, str]  # what, cases, failures, worst error and what else was seen
SEED = 1
BATCHES, BATCH = 8, 100_000  # of aimed rays, of a body at a place; and rays of a random batch
# Rays of a batch; the half-spaces of the spheres are thousands.
AIMED = {"cube": 30_000, "box": 30_000, "cylinder": 24_000, "mesh": 12_000, "sphere": 1000, "large sphere": 10}
RANDOM, SOUP_M, SOUP = 2_500_000, (0.02, 0.3, 2.0), 20_000  # rays a scene; sizes of a soup's triangles, their number
EXACT = 20_000  # cases of a kind
NEAR_M = 1e-3  # a shorter range counts as so long: the loop itself rounds it by 1e-15 m


def rays(size: float) -> Iterator[Row]:
    """All of them; `size` is a fraction of the long run's cases."""
    yield from closed_bodies(size)
    yield from beside_open3d(size)
    yield from exactly(size)


def closed_bodies(size: float) -> Iterator[Row]:
    """Rays aimed at the very vertices and edges of closed meshes, from inside and outside, against half-spaces."""
    with tempfile.TemporaryDirectory() as folder:
        for place in ray_cases.BODIES_PLACES:
            rng, cases, slipped, off, worst = np.random.default_rng(SEED), 0, 0, 0, 0.0
            for name, count in AIMED.items():
                body = ray_cases.body_at(Path(folder), name, place)
                batches = max(int(BATCHES * size), 1)
                each = max(int(2 * count * BATCHES * size / batches), 10)
                for _ in range(batches):
                    for inside in (True, False):
                        error = ray_cases.cast_aimed(ray_cases.aimed(body, inside, rng, each))
                        hit = np.isfinite(error)
                        cases, slipped = cases + len(error), slipped + int((~hit).sum())
                        off += int((error[hit] > ray_cases.off_m(place)).sum())
                        worst = max(worst, float(error[hit].max()))
            away = f"{np.abs(place).max():g} m from the origin"
            what = f"rays aimed at vertices and edges of closed meshes, {away}"
            yield what, cases, slipped + off, f"{slipped} slip through; range off by {worst:.1e} m at most"


def beside_open3d(size: float) -> Iterator[Row]:
    """Random rays in the paved street and in soups of triangles: every difference above 1 mm is Open3D's error."""
    rng = np.random.default_rng(SEED)
    for name, stage, low, high in _stages(rng):
        tracer, theirs = Tracer(stage, np.zeros(3)), ray_cases.open3d_scene(stage.vertices_m, stage.triangles)
        cases, differ, wrong, worst = max(int(RANDOM * size), 1), 0, 0, 0.0
        for first in range(0, cases, BATCH):
            count = min(BATCH, cases - first)
            origins, along = rng.uniform(low, high, (count, 3)), ray_cases.unit(rng.normal(size=(count, 3)))
            found = ray_cases.differences(tracer, theirs, origins, along)
            hit = np.isfinite(found.truth)
            relative = abs(found.mine[hit] - found.truth[hit]) / np.maximum(found.truth[hit], NEAR_M)
            differ += len(found.rays)
            wrong += int((relative > 1e-9).sum() + np.isfinite(found.mine[~hit]).sum())
            worst = max(worst, float(relative.max(initial=0.0)))
        seen = f"{differ:,} differ by more than 1 mm; there ours is within {worst:.1e} of the loop over all triangles"
        yield f"random rays beside Open3D's, {name}", cases, wrong, seen


def _stages(rng: np.random.Generator) -> Iterator[tuple[str, Scene, Array, Array]]:
    """Scenes of triangles, and the corners of the box that rays start in."""
    with tempfile.TemporaryDirectory() as folder:
        street = load_scene(pave(Path(folder)))
    stage = ray_cases.mesh_scene(street.vertices_m, street.triangles)
    yield (
        f"paved street, {len(street.triangles):,} triangles",
        stage,
        np.array([-40.0, -20, 0.1]),
        np.array([40.0, 20, 9]),
    )
    for edge in SOUP_M:
        vertices, triangles = ray_cases.soup(rng, SOUP, edge)
        name = f"{SOUP:,} random triangles of {edge:g} m"
        yield name, ray_cases.mesh_scene(vertices, triangles), np.full(3, -8.0), np.full(3, 8.0)


def exactly(size: float) -> Iterator[Row]:
    """One ray and one triangle, of every difficult kind, up to 1e8 m from the origin, in exact arithmetic."""
    for kind in ray_cases.KINDS:
        rng = np.random.default_rng(SEED)
        found = [ray_cases.settled(ray_cases.case(rng, kind)) for _ in range(max(int(EXACT * size), 1))]
        plane, edge = max(one.plane for one in found), max(one.edge for one in found)
        steep = max((one.range for one in found if one.sine > ray_cases.GRAZING), default=0.0)
        text = f"plane {plane:.1e}, range {steep:.1e}, edge {edge:.1e} of the distance"
        if kind == "grazing":
            text += f"; below 1e-5 rad, range {max(one.range for one in found):.1e}"
        failures = sum(map(ray_cases.wrong, found))
        yield f"a ray and a triangle in exact arithmetic: {kind}", len(found), failures, text
