"""The story of the docs page "How it works", run as it is written there, against `evaluate` and `optimize`."""

import re
from pathlib import Path

import numpy as np
import pytest

from lidarcfg import evaluate, optimize
from lidarcfg.search import place
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from lidarcfg.vsr import max_vsr, rig_lidars

ROOT = Path(__file__).parents[2]


def blocks():
    """The Python blocks of the page's section on studies, as one text."""
    page = (ROOT / "docs/how-it-works.md").read_text()
    (section,) = re.findall(r"^## From a study to a rig$(.*?)^## ", page, re.M | re.S)
    return "\n".join(re.findall(r"^```python\n(.*?)^```$", section, re.M | re.S))


@pytest.fixture(scope="module")
def story():
    """The names that the story leaves."""
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        exec(compile(blocks(), "how-it-works.md", "exec"), names)
    return names


def test_the_steps_give_what_evaluate_gives(story):
    found = evaluate(story["study"], story["rig"])
    ours = story["subspaces"]
    for name in ("label", "cuboids", "internal", "gap", "first"):
        assert np.array_equal(getattr(ours, name), getattr(found.subspaces, name))
    assert np.array_equal(story["vsr"], found.vsr_m)
    assert story["cost"] == found.max_vsr_m == max_vsr(story["region"], story["lidars"])


def test_the_search_gives_what_optimize_gives(story):
    found = optimize(story["study"], threads=1)
    assert story["rig"] == found.rig
    assert story["cost"] == found.objective


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "abc", "annealing"])
def test_place_is_optimize_whatever_the_solver(method):
    """Also where the budget cuts the last batch short, and where costs are smoothed."""
    bees = {"bees": 20} if method == "abc" else {}
    study = with_solver(load_study(ROOT / "data/studies/liu2018-2x4.yaml"), method=method, evaluations=450, **bees)
    found = optimize(study)
    rig = place(study, threads=1)
    assert rig == found.rig
    assert max_vsr(study.region, rig_lidars(rig)) == found.objective
