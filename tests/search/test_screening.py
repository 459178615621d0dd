"""What plain rigs reach, by what each sensor gets alone: against verdicts and against trials; and where they stand."""

import numpy as np
import pytest

from lidarcfg.returns.known import lowest_at
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.search.screening import Screening
from lidarcfg.study.evaluator import Evaluator
from lidarcfg.study.loading import load_study
from tests.search.test_requirements_search import YARD


@pytest.fixture
def study(tmp_path):
    def write(text):
        path = tmp_path / "study.yaml"
        path.write_text(text)
        return load_study(path)

    return write


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0, 1])
def test_a_screen_and_trials_agree(study, lost):
    """Without failures the shortfalls are those of trials; the worst place is that of counts by plain loops."""
    one = study(YARD.format(returns=30, lost=lost, more=""))
    points = plain_points(one)[:10]
    found = Screening(one.requirements).judge(one, points)
    poses = one.space.poses(points)
    with Evaluator(one, 1) as evaluator:
        trials = np.array([evaluator.shortfalls(row) for row in poses])
    assert ((trials > 0) <= (found.shortfalls > 0)).all() if lost else found.shortfalls == pytest.approx(trials)
    crates, most = one.requirements.items
    for rig, row in enumerate(poses):
        mounts = one.rig(row).mounts
        worst = []
        for item in (crates, most):
            counts = lowest_at(item.stand.base, item.target, mounts, one.requirements.site.obstacles, 10**6, 9).counts
            cases = [counts.sum(axis=1)] + [np.delete(counts, n, axis=1).sum(axis=1) for n in range(2) if item.lost]
            got = np.sort(np.min(cases, axis=0))[::-1]
            kept = got[: int(np.ceil(item.at_least * len(got) - 1e-9))]  # one heading: a place is a position
            worst.append(1 - min(kept.min() / item.returns, 2))
        assert found.worst[rig] == pytest.approx(max(worst))


def test_more_places_and_a_quick_look(study):
    """A rig seems no worse at some of the places than at all, and no better with more."""
    one = study(YARD.format(returns=30, lost=0, more=""))
    points = plain_points(one)[:6]
    screen = Screening(one.requirements)
    quick = screen.judge(one, points, quick=True)
    whole = screen.judge(one, points)
    assert (quick.worst <= whole.worst).all()
    hidden = np.array([[-1.3, 0.0, 0.0, 0.0]])  # right behind the body
    screen.add_places({0: hidden})
    more = screen.judge(one, points)
    assert (more.worst >= whole.worst).all()
    assert (more.shortfalls[:, 0] > whole.shortfalls[:, 0]).any()
    ranked = screen.ranked(one, points)
    assert sorted(map(tuple, ranked.points.tolist())) == sorted(map(tuple, points.tolist()))
    assert (np.diff(ranked.worst) >= 0).all()


CORNERS = """
region: {min_m: [-8, -8, 0], max_m: [8, 8, 4], cuboid_m: [1, 1, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [4, 2, 1.4]}]}
sensors:
  - {name: fl, model: vlp-16, min: {position_m: [2.1, 0.5, 0.4], rpy_deg: [0, 0, 0]}, max: {position_m: [2.3, 0.9, 1], rpy_deg: [0, 0, 0]}}
  - {name: fr, model: vlp-16, min: {position_m: [2.1, -0.9, 0.4], rpy_deg: [0, 0, 0]}, max: {position_m: [2.3, -0.5, 1], rpy_deg: [0, 0, 0]}}
  - {name: rear, model: vlp-16, count: 2, mirror_y_m: 0, min: {position_m: [-2.3, 0.5, 0.4], rpy_deg: [0, 0, 0]}, max: {position_m: [-2.1, 0.9, 1], rpy_deg: [0, 0, 0]}}
solver: {evaluations: 10}
"""


def test_mirrored_corners_are_among_the_plain_rigs(study):
    """All four farthest out, at each of three heights in front and at the rear: nine rigs by hand."""
    one = study(CORNERS)
    found = {tuple(np.round(row[:, :3], 6).ravel().tolist()) for row in one.space.poses(plain_points(one))}
    for front in (0.4, 0.7, 1.0):
        for rear in (0.4, 0.7, 1.0):
            rig = [2.3, 0.9, front, 2.3, -0.9, front, -2.3, 0.9, rear, -2.3, -0.9, rear]
            assert tuple(rig) in found
