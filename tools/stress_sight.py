"""Millions of cuboids and sensors beside bodies, against a loop over all triangles; rows of stress.py."""

import sys
from collections.abc import Iterator

import numpy as np
from page import ROOT
from stress_rays import SEED, Row

sys.path.insert(0, str(ROOT))

from tests import visibility_cases

PAIRS = 10_000_000


def visibility(size: float) -> Iterator[Row]:
    """What is hidden by bodies of 12 to 50,000 triangles, from outside, on, under and inside them."""
    rng = np.random.default_rng(SEED)
    for triangles, share in visibility_cases.SHARE.items():
        found = visibility_cases.compared(triangles, int(PAIRS * size * share), rng)
        what = f"cuboids and sensors beside a body of {triangles:,} triangles, hidden or not"
        yield what, found.pairs, found.wrong, f"{found.differ} differ, all within 1e-9 m of an edge"
