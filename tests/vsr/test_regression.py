"""Searches that version 0.1.0 made, bit for bit."""

from pathlib import Path

import pytest

from lidarcfg.search.optimize import optimize
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver

STUDIES = Path(__file__).parents[2] / "data/studies"
WITHOUT_BODY = Path(__file__).parents[1] / "search/studies"  # the sedan, as it was: transparent, a box excluded for it


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "seed", "objective", "x"),
    [
        (STUDIES / "liu2018-2x8.yaml", 1, "0x1.4310572620ae5p-2", "0x1.e4047b2930f39p+4"),
        (STUDIES / "liu2018-4x16.yaml", 2, "0x1.abbf309b8b578p-3", "0x1.c52988c9d5b9ep+4"),
        (WITHOUT_BODY / "sedan.yaml", 3, "0x1.17a75f83717a8p-2", "-0x1.3333333333333p-1"),
    ],
)
def test_bees_find_the_same_rig(study, seed, objective, x):
    found = optimize(with_solver(load_study(study), method="abc", seed=seed, bees=20, evaluations=400))
    assert found.objective.hex() == objective
    assert found.rig.mounts[0].position_m[0].hex() == x
