"""Counts up to a cap, and clusters, against all counts and plain loops."""

import numpy as np
import pytest

from lidarcfg.requirements.objects import reached
from lidarcfg.requirements.sensor_counts import KeptCounts, lowest_at, poses_of, scanners_of, united
from lidarcfg.simulate.returns import Target, returns
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


def test_only_sensors_that_moved_are_cast(monkeypatch):
    target = Target(box(0.4, 0.4, 1.1))
    where = places()
    around = obstacles(BODY)
    kept = KeptCounts(where, target, around)
    first = kept.lowest(MOUNTS, 1000, len(MOUNTS))
    moved = (mount("vlp-16", (1, 0.2, 1.8), (5, 3, 20)), *MOUNTS[1:])
    cast = []
    from lidarcfg.requirements import sensor_counts

    def counted(places, target, scanners, poses, obstacles, cap, wanted, lowest, *others):
        cast.append((lowest.counts < 0).any(axis=0).tolist())
        original(places, target, scanners, poses, obstacles, cap, wanted, lowest, *others)

    original = sensor_counts.count_lowest
    monkeypatch.setattr(sensor_counts, "count_lowest", counted)
    second = kept.lowest(moved, 1000, len(MOUNTS))
    assert cast == [[True, False, False, False]]
    assert second.counts[:, 1:].tolist() == first.counts[:, 1:].tolist()
    assert second.counts.tolist() == lowest_at(where, target, moved, around, 1000, len(MOUNTS)).counts.tolist()
    more = kept.lowest(MOUNTS, 5000, len(MOUNTS))
    assert more.counts.tolist() == lowest_at(where, target, MOUNTS, around, 5000, len(MOUNTS)).counts.tolist()


def test_counts_that_requirements_share_are_those_of_each_alone():
    target = Target(box(0.4, 0.4, 1.1))
    where = places()
    around = obstacles(BODY)
    groups = where[:40], where[20:][::-1]
    every, numbers = united(groups)
    assert len(every) == len(where)
    kept = KeptCounts(every, target, around)
    for group, which in zip(groups, numbers, strict=True):
        assert every[which].tolist() == group.tolist()
        alone = lowest_at(np.ascontiguousarray(group), target, MOUNTS, around, 5000, len(MOUNTS))
        assert kept.lowest(MOUNTS, 5000, len(MOUNTS), which=which).counts.tolist() == alone.counts.tolist()
