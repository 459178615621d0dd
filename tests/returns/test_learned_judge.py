"""Misses against a learned detector: 23 rigs, of which it was measured how well a detector sees objects with each."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.vsr.metric import max_vsr

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
JUDGED = json.loads((ROOT / "data/reference/learned_judge.json").read_text())
RIGS = JUDGED["rigs"]
MAP = [np.mean(one["ap"]) for one in RIGS]


@pytest.fixture(scope="module")
def study():
    return load_study(ROOT / "data/studies/sedan.yaml")


@pytest.fixture(scope="module")
def found(study):
    return [study.misses.found(study.rig(np.array(one["poses"])).mounts) for one in RIGS]


def test_the_fewer_misses_the_better_the_detector_sees(found):
    """By our objects and our engine, which are not those of the detector's clouds."""
    assert spearmanr([one.mean for one in found], MAP).statistic <= -0.95


def test_the_tyre_s_misses_rank_the_detector_s_precision_of_the_tyre(found):
    """The object that tells rigs apart, by itself."""
    number = JUDGED["objects"].index("tyre")
    tyre = [next(item.share for item in one.objects if item.name == "tyre") for one in found]
    assert spearmanr(tyre, [one["ap"][number] for one in RIGS]).statistic <= -0.9


def test_max_vsr_says_the_opposite(study):
    """The larger, the more is detected; and the reference's figures are those of the engine, the body's first."""
    assert spearmanr([one["max_vsr_m"][0] for one in RIGS], MAP).statistic == pytest.approx(0.50, abs=0.005)
    for one in (RIGS[0], RIGS[12]):
        lidars = lidars_at(study.slots, np.array(one["poses"]))
        values = [max_vsr(study.region, lidars, study.visibility), max_vsr(study.region, lidars)]
        assert values == pytest.approx(one["max_vsr_m"], rel=2e-3)  # poses have six digits


def test_rigs_are_those_of_the_study(study):
    """Four sensors within its bounds, to the digits of the file."""
    poses = np.array([one["poses"] for one in RIGS])
    assert poses.shape == (23, 4, 6)
    assert (poses >= study.space.lower - 1e-5).all()
    assert (poses <= study.space.upper + 1e-5).all()
