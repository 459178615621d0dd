#!/usr/bin/env python3
"""The long run of the stress tests: cases, failures and worst error of each, as the table of docs/accuracy.md.

    .venv/bin/python tools/stress.py [--quick] [NAME …]

The short run is part of the tests (tests/test_stress.py), which has the smaller cases besides.
"""

import argparse
import platform
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from lidarcfg.placement import region as region_module  # noqa: E402
from lidarcfg.placement import rows, runs  # noqa: E402
from lidarcfg.placement.lidar import gaps_at  # noqa: E402
from lidarcfg.placement.region import Region  # noqa: E402
from tests import test_stress as loaders  # noqa: E402
from tests.oracle import BAND, FANS, Line, Tally, along_a_cone, angles, sensor  # noqa: E402

SEED = 1
Row = tuple[int, int, str]  # cases, failures, worst error and what else was seen


def said(tally: Tally) -> Row:
    """A tally as a row of the table."""
    worst = (
        f"{tally.worst:.2f}·2⁻⁵² (band: 8); {tally.near:,} pairs within 1e-15, {tally.wrong_inside:,} in the band on"
    )
    return tally.pairs, tally.wrong_outside, f"{worst} the other side; {tally.computed:,} in 50 digits"


def labels_random(size: float) -> Row:
    """Random rigs and regions of 48,000 cuboids, against 50 digits."""
    rng, tally = np.random.default_rng(SEED), Tally()
    for _ in range(max(int(200 * size), 1)):
        edge, low = 10 ** rng.uniform(-2, 1, 3), rng.uniform(-1, 1, 3) * 10 ** rng.uniform(0, 4)
        shape = np.array((60, 40, 20))
        region = Region(low, low + shape * edge, np.ones(shape, bool))
        position = low + rng.uniform(-0.5, 1.5, 3) * shape * edge
        known, exact = sensor(position, angles(rng), FANS[rng.integers(len(FANS))])
        points = np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1).reshape(-1, 3)
        tally.add(exact, points, rows.digits(region, known).ravel())
    return said(tally)


def labels_near(size: float) -> Row:
    """Points on lines that cut a cone, most of them within 1e-15 of it; rows, runs and single points alike."""
    rng, tally, differ, near = np.random.default_rng(SEED), Tally(), 0, 0
    while near < 1_000_000 * size:
        known, exact, points, along = along_a_cone(rng)
        line = Line(points, along)
        digit = rows.digits(line, known).ravel()
        label = np.cumsum(np.diff(digit, prepend=digit[0]) != 0)
        differ += not np.array_equal(digit, gaps_at(points, known))
        differ += not np.array_equal(label, rows.label(line, [known])[0].ravel())
        differ += not np.array_equal(label, runs.label(runs.Grid.of(line), [known])[0].ravel())
        before = tally.near
        tally.add(exact, points, digit)
        near += tally.near - before
    cases, failures, text = said(tally)
    return cases, failures + differ, f"{text}; rows, runs and single points differ in {differ} lines"


def labels_moved(size: float) -> Row:
    """Studies moved by up to 1e7 m: wrong is a digit that differs farther from a cone than the shift's rounding."""
    rng, pairs, wrong, differ = np.random.default_rng(SEED), 0, 0, 0
    shape, farthest = np.array((60, 40, 20)), 0.0
    for _ in range(max(int(400 * size), 1)):
        edge = np.array((1, 0.5, 0.2)) * 10 ** rng.uniform(-3, 3)
        by = rng.uniform(-1e7, 1e7, 3)
        here = Region(np.zeros(3), shape * edge, np.ones(shape, bool))
        there = Region(by, by + shape * edge, here.included)
        position, rpy, fan = rng.uniform(0, 1, 3) * shape * edge, angles(rng), FANS[rng.integers(len(FANS))]
        (known, exact), (moved, _) = (sensor(at, rpy, fan) for at in (position, position + by))
        digit, other = rows.digits(here, known).ravel(), rows.digits(there, moved).ravel()
        points = np.stack(np.meshgrid(*here.centres(), indexing="ij"), axis=-1).reshape(-1, 3)
        ulp = np.spacing(max(np.abs(there.min_m).max(), np.abs(there.max_m).max()))
        for n in np.flatnonzero(digit != other).tolist():
            nearest = min(abs(exact.above(points[n], beam)) for beam in range(len(fan)))
            share = float(nearest) / (BAND + 4 * ulp / float(np.linalg.norm(points[n] - position)))
            farthest, wrong, differ = max(farthest, share), wrong + (share > 1), differ + 1
        pairs += digit.size * len(fan)
    return pairs, wrong, f"{differ:,} digits differ, at most {farthest:.2f} of the way out of the shift's own rounding"


def fifty_million(size: float) -> Row:
    """Fifty million cuboids and four LiDARs: rows and runs, two programs with other counters, agree in all."""
    edge = 0.02 / size ** (1 / 3)
    shape = np.rint(np.array((10.0, 8.0, 5.0)) / edge).astype(int)
    region, rng = Region(np.zeros(3), shape * edge, np.ones(shape, bool)), np.random.default_rng(SEED)
    lidars = [sensor(rng.uniform(0, 1, 3) * (10, 8, 5), angles(rng), FANS[0])[0] for _ in range(4)]
    one, other = rows.label(region, lidars), runs.label(runs.Grid.of(region), lidars)
    differ = sum(not np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    differ += int(one[1].sum()) != region.included.size
    return region.included.size, differ, f"{len(one[1]):,} subspaces, the largest of {one[1].max():,} cuboids"


def files(size: float) -> Row:
    """Studies, rigs, scenes and sensors made odd: each an error in one line, or an answer without NaN."""
    tried: list[str] = []  # what else came of each; empty where nothing did

    def all_of(name: str, folder: Path) -> None:
        @settings(
            max_examples=max(int(2000 * size), 1), deadline=None, database=None, suppress_health_check=list(HealthCheck)
        )
        @given(loaders.documents(name))
        def one(text: str) -> None:
            try:
                said = loaders.outcome(name, text, folder)
                tried.append("" if loaders.one_line(said) else f"{name}: {said!r:.80}")
            except Exception as error:
                tried.append(f"{name}: {error!r:.80}")

        one()

    limit, region_module.CUBOIDS_MAX = region_module.CUBOIDS_MAX, 20_000
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        loaders.prepare(Path(folder))
        for name in loaders.USES:
            all_of(name, Path(folder))
    region_module.CUBOIDS_MAX = limit
    wrong = sorted(set(filter(None, tried)))
    return len(tried), sum(map(bool, tried)), "; ".join(wrong[:5]) or "–"


CASES = {
    "labels, random": labels_random,
    "labels, near a cone": labels_near,
    "labels, moved": labels_moved,
    "50 million cuboids": fifty_million,
    "files": files,
}


def main() -> None:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", nargs="*", help=f"of {', '.join(CASES)}")
    parser.add_argument("--quick", action="store_true", help="a hundredth of the cases")
    args = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, seed {SEED}\n")
    print("| what | cases | failures | worst error | seconds |\n|---|---|---|---|---|")
    failed = False
    for name in args.name or CASES:
        started = time.perf_counter()
        cases, failures, worst = CASES[name](0.01 if args.quick else 1.0)
        failed |= failures > 0
        print(f"| {name} | {cases:,} | {failures:,} | {worst} | {time.perf_counter() - started:.0f} |", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
