#!/usr/bin/env python3
"""The long run of the stress tests: cases, failures and worst error of each.

    .venv/bin/python tools/stress.py                  all, about a quarter of an hour on two cores
    .venv/bin/python tools/stress.py rays files       some of them
    .venv/bin/python tools/stress.py --quick          a hundredth of the cases

Prints the table of docs/evidence/accuracy.md. A short run is part of the tests (tests/test_stress.py and
tests/config/test_document.py), which have smaller cases besides. Exits with 1 if anything failed.
"""

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from bench_capture import pave
from hypothesis import HealthCheck, given, settings
from page import ROOT, machine, table

sys.path.insert(0, str(ROOT))

from lidarcfg.geometry import Array
from lidarcfg.vsr.cones import gaps_at
from lidarcfg.vsr.metric import max_vsr
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import beam_gaps, segment
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import Tracer
from tests import documents, ray_cases, visibility_cases
from tests.oracle import ANGLES, BAND, FANS, PLACES, Line, Tally, along_a_cone, angles, points_of, sensor

Row = tuple[str, int, int, str]  # what, cases, failures, worst error and what else was seen
SEED = 1
BATCHES = 8
BATCH = 100_000  # of aimed rays, of a body at a place; and rays of a random batch
# Rays of a batch; the half-spaces of the spheres are thousands.
AIMED = {"cube": 30_000, "box": 30_000, "cylinder": 24_000, "mesh": 12_000, "sphere": 1000, "large sphere": 10}
RANDOM = 2_500_000
SOUP_M = (0.02, 0.3, 2.0)
SOUP = 20_000  # rays a scene; sizes of a soup's triangles, their number
EXACT = 20_000  # cases of a kind
NEAR_M = 1e-3  # a shorter range counts as so long: the loop itself rounds it by 1e-15 m
PAIRS = 10_000_000  # of cuboids and sensors beside bodies


def said(what: str, tally: Tally, differ: int = 0) -> Row:
    """A tally as a row of a table."""
    worst = f"{tally.worst:.2g}·2⁻⁵² (band: 8)" if tally.worst else "none is wrong"
    return (
        what,
        tally.pairs,
        tally.wrong_outside + differ,
        f"{worst}; {tally.near:,} pairs within 1e-15, of which {tally.wrong_inside:,} on the other side; "
        f"{tally.computed:,} in 50 digits",
    )


def labels_random(size: float) -> Iterator[Row]:
    """Random rigs and regions of 48,000 cuboids, against 50 digits."""
    rng = np.random.default_rng(SEED)
    tally = Tally()
    for _ in range(max(int(200 * size), 1)):
        edge = 10 ** rng.uniform(-2, 1, 3)
        low = rng.uniform(-1, 1, 3) * 10 ** rng.uniform(0, 4)
        shape = np.array((60, 40, 20))
        region = Region(low, low + shape * edge, np.ones(shape, bool))
        position = low + rng.uniform(-0.5, 1.5, 3) * shape * edge
        known, exact = sensor(position, angles(rng), FANS[rng.integers(len(FANS))])
        tally.add(exact, points_of(region), beam_gaps(region, known).ravel())
    yield said("cuboid–beam pairs of random rigs", tally)


def labels_posed(size: float) -> Iterator[Row]:
    """Sensors on centres, walls and corners, beside them and far away, turned by angles that have gone wrong."""
    rng = np.random.default_rng(SEED)
    tally = Tally()
    region = Region.from_boxes((0, 0, 0), (6, 4, 2), (1, 0.5, 0.25))
    points = points_of(region)
    for number in range(max(int(3000 * size), 6)):
        place = [*PLACES.values()][number % len(PLACES)]
        known, exact = sensor(place, rng.choice(ANGLES, 3), FANS[rng.integers(len(FANS))])
        tally.add(exact, points, beam_gaps(region, known).ravel())
    yield said("pairs of sensors in odd places, turned by odd angles", tally)


def labels_near(size: float) -> Iterator[Row]:
    """Points on lines that cut a cone, most of them within 1e-15 of it; rows and single points alike."""
    rng = np.random.default_rng(SEED)
    tally = Tally()
    differ = 0
    near = 0
    while near < 1_000_000 * size:
        known, exact, points, along = along_a_cone(rng)
        line = Line(points, along)
        digit = beam_gaps(line, known).ravel()
        label = np.cumsum(np.diff(digit, prepend=digit[0]) != 0)
        differ += not np.array_equal(digit, gaps_at(points, known))
        differ += not np.array_equal(label, segment(line, [known]).label.ravel())
        before = tally.near
        tally.add(exact, points, digit)
        near += tally.near - before
    what, cases, failures, text = said("pairs on lines that cut a cone, by rows and point by point", tally, differ)
    yield what, cases, failures, f"{text}; the two differ in {differ} lines"


def labels_moved(size: float) -> Iterator[Row]:
    """Studies moved by up to 1e7 m: wrong is a digit that differs farther from a cone than the shift's rounding.

    And where none differs, max VSR that does by more than the cuboids' edges are rounded.
    """
    rng = np.random.default_rng(SEED)
    pairs = 0
    wrong = 0
    differ = 0
    shape = np.array((60, 40, 20))
    farthest = 0.0
    off = 0.0
    for _ in range(max(int(400 * size), 1)):
        edge = np.array((1, 0.5, 0.2)) * 10 ** rng.uniform(-3, 3)
        by = rng.uniform(-1e7, 1e7, 3)
        here = Region(np.zeros(3), shape * edge, np.ones(shape, bool))
        there = Region(by, by + shape * edge, here.included)
        position = rng.uniform(0, 1, 3) * shape * edge
        rpy = angles(rng)
        fan = FANS[rng.integers(len(FANS))]
        (known, exact), (moved, _) = (sensor(at, rpy, fan) for at in (position, position + by))
        digit = beam_gaps(here, known).ravel()
        other = beam_gaps(there, moved).ravel()
        points = points_of(here)
        ulp = np.spacing(max(np.abs(there.min_m).max(), np.abs(there.max_m).max()))
        for n in np.flatnonzero(digit != other).tolist():
            nearest = min(abs(exact.above(points[n], beam)) for beam in range(len(fan)))
            apart = float(nearest) / (BAND + 4 * ulp / float(np.linalg.norm(points[n] - position)))
            farthest = max(farthest, apart)
            wrong = wrong + (apart > 1)
            differ = differ + 1
        if np.array_equal(digit, other):
            change = abs(max_vsr(there, [moved]) / max_vsr(here, [known]) - 1)
            off = max(off, change)
            wrong = wrong + (change > 1e-12 + 4 * ulp / (there.max_m - there.min_m).min())
        pairs += digit.size * len(fan)
    seen = f", by {farthest:.2f} of the shift's own rounding at most" if differ else ""
    yield (
        "pairs of studies of 1e-3 to 1e3 times the paper's cuboids, moved by up to 1e7 m",
        pairs,
        wrong,
        f"{differ:,} digits differ{seen}; max VSR by {off:.1e} of it",
    )


def fifty_million(size: float) -> Iterator[Row]:
    """Fifty million cuboids and four LiDARs: neighbours share a subspace where all their beam gaps are equal, only."""
    edge = 0.02 / size ** (1 / 3)
    shape = np.rint(np.array((10.0, 8.0, 5.0)) / edge).astype(int)
    region = Region(np.zeros(3), shape * edge, np.ones(shape, bool))
    rng = np.random.default_rng(SEED)
    lidars = [sensor(rng.uniform(0, 1, 3) * (10, 8, 5), angles(rng), FANS[0])[0] for _ in range(4)]
    found, (xs, ys, zs) = segment(region, lidars), region.centres()
    differ = int(found.cuboids.sum() != region.included.size)
    before = None
    for x, label in zip(xs, found.label, strict=True):
        points = np.stack(np.meshgrid([x], ys, zs, indexing="ij"), axis=-1).reshape(-1, 3)
        here = np.stack([*(gaps_at(points, one).reshape(label.shape) for one in lidars), label])
        pairs = [(here[:, 1:], here[:, :-1]), (here[:, :, 1:], here[:, :, :-1])]
        for one, other in [*pairs, (here, before)] if before is not None else pairs:
            differ += int(((one[:-1] == other[:-1]).all(axis=0) != (one[-1] == other[-1])).sum())
        before = here
    seen = f"{len(found):,} subspaces, the largest of {found.cuboids.max():,} cuboids"
    yield "cuboids of one region, four LiDARs, each against its neighbours", region.included.size, differ, seen


def rays(size: float) -> Iterator[Row]:
    """All of them; `size` is a fraction of the long run's cases."""
    yield from closed_bodies(size)
    yield from beside_open3d(size)
    yield from exactly(size)


def closed_bodies(size: float) -> Iterator[Row]:
    """Rays aimed at the very vertices and edges of closed meshes, from inside and outside, against half-spaces."""
    with tempfile.TemporaryDirectory() as folder:
        for place in ray_cases.BODIES_PLACES:
            rng = np.random.default_rng(SEED)
            cases = 0
            slipped = 0
            off = 0
            worst = 0.0
            for name, count in AIMED.items():
                body = ray_cases.body_at(Path(folder), name, place)
                batches = max(int(BATCHES * size), 1)
                each = max(int(2 * count * BATCHES * size / batches), 10)
                for _ in range(batches):
                    for inside in (True, False):
                        error = ray_cases.cast_aimed(ray_cases.aimed(body, inside, rng, each))
                        hit = np.isfinite(error)
                        cases = cases + len(error)
                        slipped = slipped + int((~hit).sum())
                        off += int((error[hit] > ray_cases.off_m(place)).sum())
                        worst = max(worst, float(error[hit].max()))
            away = f"{np.abs(place).max():g} m from the origin"
            what = f"rays aimed at vertices and edges of closed meshes, {away}"
            yield what, cases, slipped + off, f"{slipped} slip through; range off by {worst:.1e} m at most"


def beside_open3d(size: float) -> Iterator[Row]:
    """Random rays in the paved street and in soups of triangles: every difference above 1 mm is Open3D's error."""
    rng = np.random.default_rng(SEED)
    for name, stage, low, high in _stages(rng):
        tracer = Tracer(stage, np.zeros(3))
        theirs = ray_cases.open3d_scene(stage.vertices_m, stage.triangles)
        cases = max(int(RANDOM * size), 1)
        differ = 0
        wrong = 0
        worst = 0.0
        for first in range(0, cases, BATCH):
            count = min(BATCH, cases - first)
            origins = rng.uniform(low, high, (count, 3))
            along = ray_cases.unit(rng.normal(size=(count, 3)))
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


def visibility(size: float) -> Iterator[Row]:
    """What is hidden by bodies of 12 to 50,000 triangles, from outside, on, under and inside them."""
    rng = np.random.default_rng(SEED)
    for triangles, share in visibility_cases.SHARE.items():
        found = visibility_cases.compared(triangles, int(PAIRS * size * share), rng)
        what = f"cuboids and sensors beside a body of {triangles:,} triangles, hidden or not"
        yield what, found.pairs, found.wrong, f"{found.differ} differ, all within 1e-9 m of an edge"


def files(size: float) -> Iterator[Row]:
    """Studies, rigs, scenes and sensors made odd: each an error in one line, or an answer without NaN."""
    tried: list[str] = []  # what else came of each; empty where nothing did

    def all_of(name: str, folder: Path) -> None:
        @settings(
            max_examples=max(int(2000 * size), 1), deadline=None, database=None, suppress_health_check=list(HealthCheck)
        )
        @given(documents.documents(name))
        def one(text: str) -> None:
            try:
                said = documents.outcome(name, text, folder)
                tried.append("" if documents.one_line(said) else f"{name}: {said!r:.80}")
            except Exception as error:
                tried.append(f"{name}: {error!r:.80}")

        one()

    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        documents.prepare(Path(folder))
        for name in documents.USES:
            all_of(name, Path(folder))
    wrong = sorted(set(filter(None, tried)))
    yield "studies, rigs, scenes and sensors made odd", len(tried), sum(map(bool, tried)), "; ".join(wrong[:5]) or "–"


CASES = {
    "random": labels_random,
    "poses": labels_posed,
    "near": labels_near,
    "moved": labels_moved,
    "cuboids": fifty_million,
    "rays": rays,
    "visibility": visibility,
    "files": files,
}


def main(arguments: list[str] | None = None) -> None:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="name", help=f"of {', '.join(CASES)}; all without any")
    parser.add_argument("--quick", action="store_true", help="a hundredth of the cases")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - set(CASES):
        parser.error(f"no case is called {', '.join(sorted(unknown))}; allowed: {', '.join(CASES)}")
    began = time.perf_counter()
    found = []
    for name in given.names or CASES:
        started = time.perf_counter()
        for row in CASES[name](0.01 if given.quick else 1.0):
            found.append((*row, time.perf_counter() - started))
            print(f"{name}: {row[1]:,} cases, {row[2]:,} failures; {row[3]}", file=sys.stderr, flush=True)
            started = time.perf_counter()
    lines = [
        f"{machine()}, NumPy {np.__version__}, seed {SEED}, {time.perf_counter() - began:.0f} s",
        "",
        *table(
            ("what", "cases", "failures", "worst error", "seconds"),
            [(what, f"{cases:,}", f"{bad:,}", worst, f"{seconds:.0f}") for what, cases, bad, worst, seconds in found],
        ),
    ]
    print(*lines, sep="\n")
    sys.exit(any(bad for _, _, bad, _, _ in found))


if __name__ == "__main__":
    main()
