"""Searches of studies with requirements: what they find, and that what they skip changes nothing."""

import math
import time
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest

from lidarcfg.packets.families import pattern
from lidarcfg.requirements.allowed_rigs import most_returns
from lidarcfg.requirements.resolved import Requirements
from lidarcfg.requirements.scenarios.requirement import ScenarioRequirement
from lidarcfg.requirements.shortfalls import Shortfalls
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns import scanners as firing
from lidarcfg.returns.counts import returns
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.misses import SEARCH, SEARCH_PLACES
from lidarcfg.returns.scanners import PHASES
from lidarcfg.returns.target import box_target
from lidarcfg.search import cheapest as cheapest_module
from lidarcfg.search.cheapest import cheapest
from lidarcfg.search.combinations import combinations, distinct_combinations
from lidarcfg.search.optimize import optimize
from lidarcfg.search.plain_rigs import PLAIN_MAX, plain_points
from lidarcfg.search.requirements_search import unachievable
from lidarcfg.search.run import INFEASIBLE
from lidarcfg.search.workers import Processes
from lidarcfg.sensors.firing import CycleBeams
from lidarcfg.solvers.search import unbounded
from lidarcfg.study.evaluator import SHORTFALL_MOST, Evaluator
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from tests.returns_cases import mount

pytestmark = pytest.mark.slow

YARD = """
region: {{min_m: [-8, -8, 0], max_m: [8, 8, 4], cuboid_m: [1, 1, 1]}}
vehicle: {{boxes: [{{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4]}}]}}
sensors:
  - model: vlp-16
    name: roof
    count: 2
    min: {{position_m: [-0.9, -0.45, 1.5], rpy_deg: [-15, -15, 0]}}
    max: {{position_m: [0.9, 0.45, 2.0], rpy_deg: [15, 15, 0]}}
requirements:
  - name: crates ahead
    object: {{size_m: [0.5, 0.5, 1]}}
    within_m: [1, 2]
    sector_deg: [-40, 40]
    headings_deg: [0, 30]
    returns: {returns}
    lost: {lost}
  - name: most of the crates
    object: {{size_m: [0.4, 0.4, 0.6]}}
    region: {{min_m: [-3, 1, -0.5], max_m: [3, 3, 2]}}
    headings_deg: [0]
    returns: 20
    at_least: 0.9
{more}
solver: {{method: annealing, evaluations: 150}}
"""
CRATES = YARD[: YARD.index("  - name: most")] + YARD[YARD.index("{more}") :]
SLIT = """
region: {min_m: [-8, -8, 0], max_m: [8, 8, 4], cuboid_m: [1, 1, 1]}
vehicle:
  boxes:
    - {name: one, center_m: [-3.5, 2.5, 1.5], size_m: [9, 0.2, 3]}
    - {name: other, center_m: [5.7, 2.5, 1.5], size_m: [8.6, 0.2, 3]}
sensors:
  - model: vlp-16
    min: {position_m: [-2, 0, 1], rpy_deg: [0, 0, 0]}
    max: {position_m: [3, 0, 1], rpy_deg: [0, 0, 0]}
requirements:
  - name: behind the slit
    object: {size_m: [0.1, 0.1, 1.5]}
    region: {min_m: [0.9, 4.9, -0.1], max_m: [1.1, 5.1, 2]}
    headings_deg: [0]
    returns: 20
solver: {evaluations: 150}
"""


@pytest.fixture
def study(tmp_path):
    def write(text, **values):
        path = tmp_path / "study.yaml"
        path.write_text(text.format(**values) if values else text)
        return load_study(path)

    return write


def yard(study, returns=20, lost=0, more=""):
    return study(YARD, returns=returns, lost=lost, more=more)


def test_costs_are_lexicographic(study):
    """Shortfall first; misses count among rigs that meet all, and no shortfall is as bad as a broken constraint."""
    text = CRATES.replace("[0.5, 0.5, 1]", "[1, 1, 1]").replace("[1, 2]", "[1, 2.5]")
    one = study(text, returns=60, lost=0, more="")
    poses = one.space.poses(plain_points(one))
    with Evaluator(one, 1) as evaluator:
        costs = evaluator.costs(poses, np.zeros(len(poses), np.int64), poses[:1], unbounded(len(poses)))
        short = np.array([sum(evaluator.shortfalls(row)) for row in poses])
    met = short == 0
    assert 0 < met.sum() < len(met)
    assert costs[~met].tolist() == [[each, math.inf] for each in short[~met].tolist()]
    for row, (shortfall, objective) in zip(poses[met], costs[met].tolist(), strict=True):
        assert shortfall == 0
        at_some = one.misses.known(SEARCH_PLACES, SEARCH)
        assert objective == pytest.approx(one.misses.found_at(at_some, one.rig(row).mounts).mean)
    assert SHORTFALL_MOST < INFEASIBLE


NEARER = """  - name: the same crates nearer
    object: {size_m: [1, 1, 1]}
    within_m: [1, 1.5]
    sector_deg: [-60, 20]
    headings_deg: [30]
    returns: 20
    lost: 0
"""


def poses_of(study, count, seed=5):
    rng = np.random.default_rng(seed)
    return study.space.poses(rng.random((count, study.space.dimensions)))


@pytest.mark.parametrize("lost", [0, 1])
def test_shortfall_is_the_definition(study, lost):
    """Mean over places and cases of max(0, 1 − reached/demanded), from counts of each sensor at each place."""
    one = yard(study, lost=lost, more=NEARER)
    judge = Shortfalls(one.requirements, one.rig(one.space.lower).mounts)
    poses = poses_of(one, 4)
    for row, rig in zip(poses, judge.rigs(poses), strict=True):
        total = 0.0
        for item in one.requirements.items:
            places = item.stand.base
            counts = lowest_at(places, item.target, one.rig(row).mounts, one.requirements.site.obstacles, 10**6, 99)
            each = counts.counts.astype(float)
            cases = [each.sum(axis=1)] + ([each[:, 0], each[:, 1]] if item.lost else [])
            worst = []
            for got in cases:
                by_position = {}
                for place, value in zip(places.tolist(), got.tolist(), strict=True):
                    by_position.setdefault(tuple(place[:2]) if item.at_least < 1 else tuple(place), []).append(value)
                best = sorted((min(values) for values in by_position.values()), reverse=True)
                best = best[: math.ceil(item.at_least * len(best) - 1e-9)]
                worst.append(np.mean([max(0.0, 1 - value / item.returns) for value in best]))
            total += np.mean(worst)
        assert judge.shortfall(rig) == pytest.approx(total, rel=1e-12)
        assert judge.shortfall(rig, total / 2) == math.inf
        assert judge.shortfall(rig, total * 2) == judge.shortfall(rig)


def test_scenarios_are_tried_last(study, monkeypatch):
    """They take seconds: what the places refute is not fired at all."""
    one = yard(study, more="  - {name: crossing, scenario: cpna, speeds_km_h: [20]}")
    poses = poses_of(one, 4)
    judge = Shortfalls(one.requirements, one.rig(one.space.lower).mounts)
    places = Shortfalls(replace(one.requirements, items=one.requirements.items[:-1]), one.rig(one.space.lower).mounts)
    known = [places.shortfall(rig) for rig in places.rigs(poses)]
    monkeypatch.setattr(ScenarioRequirement, "tried", lambda *_: pytest.fail("it is fired"))
    for rig, short in zip(judge.rigs(poses), known, strict=True):
        assert short > 0
        assert judge.shortfall(rig, short) == math.inf


def test_base_verdict_and_search_agree(study):
    one = yard(study, returns=3, lost=1)
    judge = Shortfalls(one.requirements, one.rig(one.space.lower).mounts)
    poses = poses_of(one, 2)
    for row, rig in zip(poses, judge.rigs(poses), strict=True):
        verdict = Verifier(one.requirements).verify(one.rig(row).mounts)
        for short, item in zip(judge.shortfalls(rig), verdict.requirements, strict=True):
            assert not (short > 0 and item.passed)
            assert short > 0 or item.shortfall < 1e-3  # at refined places alone


MORE = """  - {name: shadow, shadow_at_most_m3: 0.4, within_m: [0, 1]}
objective: {max_vsr: 1}
"""


@pytest.mark.parametrize(
    ("more", "robust"),
    [("", ""), (MORE, ""), ("robust: {position_sigma_m: 0.05, samples: 3, quantile: 0.6}", "draws")],
    ids=["misses", "objective", "draws"],
)
def test_skipping_and_threads_change_nothing(study, more, robust):
    one = with_solver(yard(study, returns=4, more=more), evaluations=24 if robust else 64)
    found = optimize(one, threads=2)
    kept = found.log.cost[:, 0] < math.inf  # what was to beat was beaten
    for other in (optimize(one, threads=1), optimize(one, threads=2, skip=False)):
        assert (other.log.cost[kept] == found.log.cost[kept]).all()
        assert other.rig == found.rig
        assert other.objective == found.objective
        assert other.verdict == found.verdict


def test_a_resumed_search_ends_the_same(study):
    one = yard(study, returns=4)
    whole = optimize(with_solver(one, evaluations=96), threads=2)
    begun = optimize(with_solver(one, evaluations=64), threads=2)
    resumed = optimize(with_solver(one, evaluations=96), threads=2, log=begun.log)
    assert resumed.rig == whole.rig
    assert (resumed.log.cost == whole.log.cost).all()


@pytest.mark.parametrize("returns", [60, 600])
def test_the_result_is_no_worse_than_the_best_plain_rig_of_those_that_pass_or_else_of_all(study, returns):
    text = CRATES.replace("[0.5, 0.5, 1]", "[1, 1, 1]").replace("[1, 2]", "[1, 2.5]").replace("[0, 30]", "[0]")
    one = study(text, returns=returns, lost=0, more="")
    points = plain_points(one)
    assert len(points) == len(np.unique(points, axis=0)) <= PLAIN_MAX
    poses = one.space.poses(points)
    assert (poses >= one.space.lower - 1e-12).all()
    assert (poses <= one.space.upper + 1e-12).all()
    assert (poses[1:, :, 3:5] == 0).all()  # upright
    with Evaluator(one, 2) as evaluator:
        costs = evaluator.costs(poses, np.zeros(len(poses), np.int64), poses[:1], unbounded(len(poses)))
    found = optimize(with_solver(one, evaluations=1), threads=2)
    assert sorted(found.log.points.tolist()) == sorted(points.tolist())
    verifier = Verifier(one.requirements)
    passing = [
        cost for cost, row in zip(costs.tolist(), poses, strict=True) if verifier.verify(one.rig(row).mounts).passed
    ]
    assert bool(passing) == (returns == 60)
    at = np.array([[*mount.position_m, *mount.rpy_rad] for mount in found.rig.mounts])[None]
    with Evaluator(one, 1) as evaluator:
        cost = evaluator.costs(at, np.zeros(1, np.int64), at, unbounded(1))[0].tolist()
    assert cost <= min(passing or costs.tolist())
    assert found.verdict.passed == bool(passing)


def test_the_first_rig_that_meets_all_is_verified_at_once(study, monkeypatch):
    """By what was told: at the end of its batch; and until a rig passes, all that meet cost the same, nothing."""
    monkeypatch.setattr("lidarcfg.requirements.object_judge.TRIAL_PLACES", 12)
    one = study(CRATES.replace("150", "500"), returns=130, lost=0, more="")
    found = optimize(one, threads=2)
    checks = found.log.checks
    met = np.flatnonzero(found.log.cost[:, 0] == 0)
    batches = [0, *np.minimum([2, 2 + 6, 8 + 24, 32 + 96], len(found.log.points)).tolist()]
    batches += range(batches[-1] + 16, len(found.log.cost) + 1, 16)  # of annealing's 16 chains
    assert checks[0].told == next(end for end in batches if end > met[0])
    passed = [check.passed for check in checks]
    assert passed[0] is False
    assert any(passed)
    until = checks[passed.index(True)].told
    assert (found.log.cost[met[met < until], 1] == 0).all()
    assert (found.log.cost[met[met >= until], 1] > 0).all()
    assert found.verdict.passed


def test_what_was_verified_is_not_verified_again(study, monkeypatch):
    """A resumed search goes by its log: it verifies its best rig, and where that fails the one that it ends with."""
    monkeypatch.setattr("lidarcfg.requirements.object_judge.TRIAL_PLACES", 12)
    one = study(CRATES.replace("150", "500"), returns=130, lost=0, more="")
    begun = optimize(one, threads=2)
    verified = []
    verify = Verifier.verify
    monkeypatch.setattr(Verifier, "verify", lambda self, mounts: verified.append(mounts) or verify(self, mounts))
    resumed = optimize(one, threads=2, log=begun.log)
    assert resumed.rig == begun.rig
    assert [check.told for check in resumed.log.checks] == [check.told for check in begun.log.checks]
    assert len(verified) <= 2


def test_an_evaluator_that_knows_nothing_refutes_no_better_rig(study):
    """As after a pause: rigs that meet all, each beside one that misses hardly more."""
    text = CRATES.replace("[0.5, 0.5, 1]", "[1, 1, 1]").replace("[1, 2]", "[1, 2.5]")
    one = study(text, returns=1, lost=0, more="")
    poses = one.space.poses(plain_points(one))
    index = np.zeros(1, np.int64)
    with Evaluator(one, 1, skip=False) as evaluator:
        costs = evaluator.costs(poses, np.zeros(len(poses), np.int64), poses[:1], unbounded(len(poses)))
    met = np.flatnonzero((costs[:, 0] == 0) & (costs[:, 1] > 0))
    assert len(met)
    for number in met.tolist():
        with Evaluator(one, 1) as evaluator:
            limit = 1.001 * costs[[number]]
            assert evaluator.costs(poses[[number]], index, poses[:1], limit)[0].tolist() == costs[number].tolist()


def test_a_search_at_a_few_places_is_verified_at_all(study, monkeypatch):
    """Where rigs fail at places of the base grid that do not count, these join; the verdict is that of all places."""
    monkeypatch.setattr("lidarcfg.requirements.object_judge.TRIAL_PLACES", 12)
    one = study(CRATES.replace("150", "500"), returns=100, lost=0, more="")
    (item,) = one.requirements.items
    assert len(item.trial_places) < 20 < len(item.stand.base)
    found = optimize(one, threads=1)
    assert any("joined those that count" in remark for remark in found.remarks)
    assert found.verdict.passed
    lowest = lowest_at(item.stand.base, item.target, found.rig.mounts, one.requirements.site.obstacles, 1000, 3)
    assert lowest.counts.sum(axis=1).min() >= 100


def test_what_trials_miss_is_found(study, monkeypatch):
    """By brute force over the base grid: the places at which a rig fails, the worst of those first."""
    monkeypatch.setattr("lidarcfg.requirements.object_judge.TRIAL_PLACES", 12)
    monkeypatch.setattr("lidarcfg.requirements.object_judge.TRIAL_GROWTH", 3)
    one = study(CRATES, returns=120, lost=1, more="")
    (item,) = one.requirements.items
    (judge,) = Verifier(one.requirements).judges
    some = nearby = 0
    for poses in poses_of(one, 12):
        mounts = one.rig(poses).mounts
        counts = lowest_at(item.stand.base, item.target, mounts, one.requirements.site.obstacles, 1000, 3).counts
        short = item.stand.base[counts.min(axis=1) < 120]
        missed = judge.missed(mounts)
        assert {tuple(place) for place in missed} <= {tuple(place) for place in short}
        assert (len(missed) > 0) == (len(short) > 0)
        some += 0 < len(short) < len(item.stand.base)
        found = judge.missed_nearby(mounts)
        counts = lowest_at(found, item.target, mounts, one.requirements.site.obstacles, 1000, 3).counts
        assert (counts.min(axis=1) < 120).all()
        nearby += len(found) > 0
    assert some
    assert nearby


def test_the_search_looks_through_the_slit(study):
    """The wall is open from x = 1 to 1.4 m at y = 2.5: the post at (1, 5) is seen from 1 < x < 1.8 at y = 0."""
    one = study(SLIT)
    found = optimize(one, threads=2)
    assert found.verdict.passed
    assert 0.9 < found.rig.mounts[0].position_m[0] < 1.9
    with Evaluator(one, 1) as evaluator:
        poses = one.space.poses(plain_points(one))
        costs = evaluator.costs(poses, np.zeros(len(poses), np.int64), poses[:1], unbounded(len(poses)))
    assert (costs[:, 0] > 0).all()  # no plain rig does


CHOICE = """
region: {min_m: [-8, -8, 0], max_m: [8, 8, 4], cuboid_m: [1, 1, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4]}]}
sensors:
  - name: left
    choose: [vlp-16, vlp-32c, none]
    min: {position_m: [0, 0.4, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [0.5, 0.4, 1.8], rpy_deg: [0, 0, 0]}
  - name: right
    choose: [vlp-16, vlp-32c, none]
    min: {position_m: [0, -0.4, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [0.5, -0.4, 1.8], rpy_deg: [0, 0, 0]}
prices: {vlp-16: 4000, vlp-32c: 7000}
requirements:
  - name: crates ahead
    object: {size_m: [1, 1, 1]}
    within_m: [2, 3]
    sector_deg: [-30, 30]
    headings_deg: [0]
    returns: RETURNS
  - {name: budget, price_at_most: 13000}
solver: {evaluations: 200}
"""


def test_each_rig_is_searched_once(study):
    """Two groups of one sensor each. In the same bounds: multisets of two of three choices, without that of no sensor."""
    apart = study(CHOICE.replace("RETURNS", "10"))
    assert len(distinct_combinations(apart)) == len(combinations(apart)) == 3**2 - 1  # a mirror image is another rig
    together = CHOICE.replace("RETURNS", "10").replace("-0.4", "0.4")
    distinct = distinct_combinations(study(together))
    assert len(distinct) == math.comb(3 + 2 - 1, 2) - 1
    prices = [each.price for each in distinct]
    assert prices == sorted(sum(pair) for pair in combinations_with_replacement((4000, 7000, 0), 2) if any(pair))
    drawn = study(together.replace("solver:", "robust: {angle_sigma_deg: 0.5, samples: 4}\nsolver:"))
    assert len(distinct_combinations(drawn)) == 3**2 - 1  # each sensor has mounting errors of its own
    other = study(together.replace("right\n", "right\n    range_m: [0.5, 30]\n"))
    assert len(distinct_combinations(other)) == 3**2 - 1


@pytest.mark.parametrize("returns", [300, 100_000])
def test_the_cheapest_is_that_of_brute_force(study, returns):
    one = study(CHOICE.replace("RETURNS", str(returns)))
    found = cheapest(one, threads=2)
    passing = []
    for option in distinct_combinations(one):
        each = option.study
        evaluations = 60 if returns == 300 else 1  # the plain rigs alone
        rigs = [optimize(with_solver(each, evaluations=evaluations), threads=2)] if each.space.free.any() else []
        if option.price <= 13000 and any(rig.verdict.passed for rig in rigs):
            passing.append(option.price)
    if passing:
        assert found.meets
        assert found.combination.price == min(passing)
        cheaper = [tried for tried in found.tried if tried.price < min(passing)]
        searched = [tried for tried in cheaper if not tried.excluded]
        assert all(tried.evaluations > 0 and tried.shortfall > 0 and tried.failing for tried in searched)
        answer = next(tried for tried in found.tried if tried.name == found.combination.name)
        assert answer.evaluations > len(found.placement.log.cost) > 0  # the plain rigs that were screened, too
    else:
        assert not found.meets
        assert found.placement.verdict.shortfall > 0
        assert [tried.excluded for tried in found.tried].count("too dear") == 1  # two VLP-32C
        assert all("returns" in tried.excluded for tried in found.tried if tried.price <= 13000)
    assert [tried.name for tried in found.tried] == [option.name for option in distinct_combinations(one)]
    assert isinstance(one.requirements, Requirements)


def test_the_seconds_are_those_of_the_search(study, monkeypatch):
    """What is found out about the cheapest rig at the end takes its own time, however long."""
    began = time.perf_counter()
    searched = []

    def late(*args):
        searched.append(time.perf_counter())
        time.sleep(0.3)
        return placement(*args)

    placement = cheapest_module._placement
    monkeypatch.setattr(cheapest_module, "_placement", late)
    found = cheapest(with_solver(study(CHOICE.replace("RETURNS", "300")), evaluations=1), threads=2)
    assert 0 < found.seconds <= searched[0] - began


@pytest.mark.parametrize("evaluations", range(17, 33, 3))
def test_the_rig_that_is_said_to_meet_all_does(study, evaluations):
    """Also one of a batch that the budget cuts short: of 16, and the first rig that passes is the tenth of the second."""
    text = SLIT.replace("model: vlp-16", "choose: [vlp-16, none]").replace("solver:", "prices: {vlp-16: 4000}\nsolver:")
    one = with_solver(study(text), evaluations=evaluations)
    found = cheapest(one, threads=2)
    verdict = Verifier(one.requirements).verify(found.placement.rig.mounts)
    assert (verdict.passed, found.meets) == (found.placement.verdict.passed, verdict.passed)


def test_what_is_excluded_meets_nothing_when_searched(study):
    """Combinations of which it is said that no rig can meet all are searched all the same without skipping."""
    one = study(CHOICE.replace("RETURNS", "1500").replace("evaluations: 200", "evaluations: 600"))
    excluded = {tried.name for tried in cheapest(one, threads=2).tried if tried.excluded not in (None, "too dear")}
    searched = [tried for tried in cheapest(one, threads=2, skip=False).tried if tried.name in excluded]
    assert len(searched) == len(excluded) > 0
    assert all(tried.evaluations > 0 and tried.shortfall > 0 and not tried.meets for tried in searched)


def test_what_no_rig_can_meet_is_said(study):
    """A zone beyond the range, and a budget below the cheapest rig."""
    assert unachievable(study(SLIT)) == {}
    near = study(SLIT.replace("model: vlp-16", "model: vlp-16\n    range_m: [0.5, 3]"))
    assert "no range exceeds 3 m" in unachievable(near)["behind the slit"]
    dear = study(CHOICE.replace("RETURNS", "10").replace("13000", "3999"))
    assert unachievable(dear) == {"budget": "the cheapest rig costs 4,000"}


def beams_by_hand(step_deg=0.2):
    """Sixteen beams 2° apart that all start at one point, once every `step_deg`."""
    none = np.zeros(16)
    heads_rad = np.radians(np.arange(0.0, 360.0, step_deg))
    elevation_rad = np.radians(np.arange(-15.0, 16.0, 2.0))
    start_m = np.zeros((16, 3))
    return CycleBeams(
        heads_rad, math.radians(step_deg), 1, none, none, none, elevation_rad, start_m, np.empty(0, np.int32)
    )


def test_the_most_returns_of_a_ball_by_hand():
    """A ball 10° wide has six of the beams. At 13° and 15° it is 51 steps wide, nearer to the horizon 50; and two more.

    asin(sin 5° / cos 15°) is 5.18°, asin(sin 5° / cos 11°) 5.09°. A ball around the sensor may get all.
    """
    beams = beams_by_hand()
    assert most_returns(beams, math.sin(math.radians(5.0001)), 1.0) == 2 * 53 + 4 * 52
    assert most_returns(beams, 1.0, 1.0) == 16 * 1800
    beside = beams._replace(start_m=np.full((16, 3), 0.01))
    assert most_returns(beside, 0.05, 1.0) == most_returns(beams, 0.05 + 0.01 * math.sqrt(3), 1.0)


@pytest.mark.parametrize("model", ["vlp-16", "os0-32", "mid-360"])
def test_no_sensor_gets_more_returns_than_the_most(model):
    """However near and far a box is, and however the sensor is turned; counted as verdicts are."""
    rng = np.random.default_rng(5)
    one = mount(model, (0.0, 0.0, 0.0), (0, 0, 0))
    beams = pattern(one).beams(one.sensor, PHASES)
    closest = 0.0
    for _ in range(12):
        size_m = rng.uniform(0.2, 2.0, 3)
        distance_m = rng.uniform(0.3, 10)
        way = rng.normal(size=3)
        at_m = np.array([0.0, 0.0, size_m[2] / 2]) + distance_m * way / np.linalg.norm(way)
        placed = mount(model, tuple(at_m.tolist()), rng.uniform(-180, 180, 3))
        target = box_target(tuple(size_m.tolist()))
        fires = firing.scanners_of([placed])
        got = returns(np.zeros((1, 4)), target, fires, firing.poses_of([placed])).counts.max()
        most = most_returns(beams, 0.5 * float(np.linalg.norm(size_m)), distance_m)
        assert got <= most
        closest = max(closest, got / most)
    assert closest > 0.2


def test_returns_that_no_rig_gets_are_said(study):
    """Two VLP-16 fire 1809 times 16 beams a revolution each, as one cycle takes 55.296 µs; the crates may stand among them."""
    every = 1809 * 16
    near = CHOICE.replace("[vlp-16, vlp-32c, none]", "[vlp-16]")
    for bound, wider in {"[0, 0.4, 1.5]": "[0, -3, 0.4]", "[0.5, 0.4,": "[5, 3,"}.items():
        near = near.replace(bound, wider).replace(bound.replace("0.4,", "-0.4,"), wider)
    for more, most, who in [
        ("", 2 * every, "the sensors together get"),
        ("\n    lost: 1", every, "the sensors together get"),
        ("\n    sensors: 2", every, "2 of the sensors get, each alone,"),
        ("\n    sensors: 2\n    lost: 1", 0, "2 of the sensors get, each alone,"),
    ]:
        said = unachievable(study(near.replace("RETURNS", f"{most + 1}{more}")))
        assert said["crates ahead"].startswith(f"{who} at most {most:,} returns")
        assert not most or "crates ahead" not in unachievable(study(near.replace("RETURNS", f"{most}{more}")))
    many = SLIT.replace(
        "returns: 20", "returns: 100000"
    )  # posts 4.95 to 5.05 m to the left, their middles 0.25 m lower
    assert unachievable(study(many))["behind the slit"].endswith("from 5.1 m away")
    some = unachievable(study(many.replace("returns:", "at_least: 0.5\n    returns:")))
    assert some["behind the slit"].endswith("from 5.0 m away")


def test_workers_find_the_same(study):
    """Processes stand for a cluster's workers."""
    text = CHOICE.replace("RETURNS", "300").replace("within_m: [2, 3]", "within_m: [2, 3.5]")
    one = with_solver(study(text), evaluations=400)
    alone = cheapest(one, threads=2)
    workers = Processes(2)
    try:
        found = cheapest(one, workers=workers)
    finally:
        workers.close()
    assert found.combination.name == alone.combination.name
    assert found.placement.rig == alone.placement.rig
    assert found.placement.verdict == alone.placement.verdict
    assert found.tried == alone.tried
    assert any(each.price > alone.combination.price for each in alone.tried)  # one was searched before the find
