#!/usr/bin/env python3
"""The long run of the stress tests: cases, failures and worst error of each, as the table of docs/accuracy.md.

    .venv/bin/python tools/stress.py [--quick] [NAME …]

The short run is part of the tests (tests/test_stress.py), and the cases are the same.
"""

import argparse
import platform
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from lidarcfg.placement import rows, runs  # noqa: E402
from lidarcfg.placement.lidar import gaps_at  # noqa: E402
from lidarcfg.placement.region import Region  # noqa: E402
from tests.oracle import FANS, Line, Tally, along_a_cone, angles, sensor  # noqa: E402

SEED = 1
Row = tuple[int, int, str]  # cases, failures, worst error and what else was seen


def said(tally: Tally) -> Row:
    """A tally as a row of the table."""
    worst = f"{tally.worst:.2f}·2⁻⁵² (band: 8); {tally.near:,} pairs within the band, {tally.wrong_inside:,} of them on"
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


CASES = {"labels, random": labels_random, "labels, near a cone": labels_near}


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
