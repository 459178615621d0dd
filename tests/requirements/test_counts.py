"""Counts up to a cap, and clusters, against all counts and plain loops."""

import numpy as np
import pytest

from lidarcfg.returns.counts import returns
from lidarcfg.returns.known import KnownReturns, Standing, lowest_at, shares, united
from lidarcfg.returns.reach import reached
from lidarcfg.returns.scanners import poses_of, scanners_of
from lidarcfg.returns.target import Target
from tests.naive import requirements as naive
from tests.returns_cases import box, mount
from tests.simulate.test_returns import BODY, obstacles

MOUNTS = (
    mount("vlp-16", (1, 0.5, 1.8), (5, 3, 20)),
    mount("vlp-16", (-2.3, 0, 0.6), (0, 0, 180), 600.0, (280.0, 80.0)),
    mount("os1-32", (0, 0, 2.0), (0, 0, 77)),
    mount("qt128", (2.3, 0.9, 0.7), (0, 10, 45)),
)


def places(seed=4, count=60, far_m=25.0):
    rng = np.random.default_rng(seed)
    far = rng.uniform(3.2, far_m, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    return np.stack([far * np.cos(angle), far * np.sin(angle), 0 * far, rng.uniform(0, 6.28, count)], axis=1)


@pytest.mark.parametrize(("lost", "sensors"), [(0, None), (1, None), (2, None), (0, 2), (1, 2), (2, 3)])
@pytest.mark.parametrize("cap", [1, 7, 40, 5000])
def test_capped_counts_are_exact_below_the_cap(lost, sensors, cap):
    target = Target(box(0.4, 0.4, 1.1))
    where = places()
    around = obstacles(BODY)
    whole = returns(where, target, scanners_of(MOUNTS), poses_of(MOUNTS), around)
    wanted = lost + (sensors or 1)
    found = reached(lowest_at(where, target, MOUNTS, around, cap, wanted).counts, lost, sensors)
    rows = [[counts[s, :n].tolist() for s, n in enumerate(whole.phases)] for counts in whole.counts]
    exact = [naive.worst_returns(row, lost, sensors) for row in rows]
    assert [min(one, cap) for one in found.tolist()] == [min(one, cap) for one in exact]
    if cap == 5000:
        assert found.tolist() == exact


def test_only_sensors_that_moved_are_cast():
    target = Target(box(0.4, 0.4, 1.1))
    where = places()
    around = obstacles(BODY)
    every = np.arange(len(where))
    known = KnownReturns([Standing(target, where)], around, MOUNTS)
    first = known.lowest(known.rig(MOUNTS), 0, every, 1000, len(MOUNTS))
    traced = known.traced
    assert known.lowest(known.rig(MOUNTS), 0, every, 1000, len(MOUNTS)).counts.tolist() == first.counts.tolist()
    assert known.traced == traced == len(MOUNTS) * len(where)
    moved = (mount("vlp-16", (1, 0.2, 1.8), (5, 3, 20)), *MOUNTS[1:])
    second = known.lowest(known.rig(moved), 0, every, 1000, len(MOUNTS))
    assert known.traced == traced + len(where)
    assert second.counts[:, 1:].tolist() == first.counts[:, 1:].tolist()
    assert second.counts.tolist() == lowest_at(where, target, moved, around, 1000, len(MOUNTS)).counts.tolist()
    more = known.lowest(known.rig(MOUNTS), 0, every, 5000, len(MOUNTS))
    assert more.counts.tolist() == lowest_at(where, target, MOUNTS, around, 5000, len(MOUNTS)).counts.tolist()


def test_a_sensor_that_is_new_is_known_from_then_on():
    target = Target(box(0.4, 0.4, 1.1))
    where = places()
    known = KnownReturns([Standing(target, where)], obstacles(BODY))
    assert known.numbers(MOUNTS[:1]).tolist() == [0]
    assert known.numbers([MOUNTS[2], MOUNTS[0], MOUNTS[2]]).tolist() == [1, 0, 1]
    found = known.lowest(known.rig(MOUNTS), 0, np.arange(len(where)), 5000, len(MOUNTS))
    alone = lowest_at(where, target, MOUNTS, obstacles(BODY), 5000, len(MOUNTS))
    assert found.counts.tolist() == alone.counts.tolist()


def test_counts_that_requirements_share_are_those_of_each_alone():
    target = Target(box(0.4, 0.4, 1.1))
    other = Target(box(0.9, 0.4, 0.5))
    where = places()
    around = obstacles(BODY)
    groups = where[:40], where[20:][::-1], where[5:30]
    every, numbers = united(groups)
    assert len(every) == len(where)
    assert [every[which].tolist() for which in numbers] == [group.tolist() for group in groups]
    of = target, Target(box(0.4, 0.4, 1.1)), other
    found = shares([Standing(*one) for one in zip(of, groups, strict=True)], around)
    assert [one.number for one in found] == [0, 0, 1]  # objects of one shape are one
    for one, group, share in zip(of, groups, found, strict=True):
        alone = lowest_at(np.ascontiguousarray(group), one, MOUNTS, around, 5000, len(MOUNTS))
        assert share.places.tolist() == group.tolist()
        rig = share.known.rig(MOUNTS)
        assert share.lowest(rig, 5000, len(MOUNTS)).counts.tolist() == alone.counts.tolist()
        some = share.lowest(rig, 5000, len(MOUNTS), rows=np.array([3, 1]), threads=1)
        assert some.counts.tolist() == alone.counts[[3, 1]].tolist()
