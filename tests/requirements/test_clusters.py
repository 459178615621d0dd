"""The rule for clusters, against a cloud made by hand, plain loops, Open3D, and counts of returns."""

import numpy as np
import pytest

from lidarcfg.core import returns as core
from lidarcfg.returns.counts import ClusterRule, count_clusters, returns
from lidarcfg.returns.scanners import poses_of, scanners_of
from lidarcfg.returns.target import Target
from lidarcfg.world.meshes import join_meshes
from lidarcfg.world.tracer import NO_OBSTACLES
from tests.naive import requirements as naive
from tests.returns_cases import box, mount

largest_cluster = core.largest_cluster
LOW = -1e9  # every point is high enough
MOUNTS = (mount("os0-32", (0, 0.4, 1.5), (0, 5, 0)), mount("vlp-16", (0, -0.4, 1.2), (3, 0, 40)))


def test_a_cloud_by_hand():
    row = np.array([[0.1 * n, 0.0, 0.05] for n in range(5)])  # on the ground
    high = np.array([[0.1 * n, 5.0, 0.3] for n in range(3)])
    cloud = np.concatenate([row, high])
    assert largest_cluster(cloud, 0.11, LOW) == 5
    assert largest_cluster(cloud, 0.11, 0.1) == 3
    assert largest_cluster(cloud, 0.09, LOW) == 1
    assert largest_cluster(cloud, 0.11, 0.4) == 0
    assert largest_cluster(np.empty((0, 3)), 0.11, LOW) == 0
    assert largest_cluster(np.array([[0.0, 0, 0], [0.25, 0, 0]]), 0.25, LOW) == 2  # within: at the tolerance, too


@pytest.mark.parametrize("seed", range(5))
def test_random_clouds(seed):
    import open3d as o3d

    cloud = np.random.default_rng(seed).uniform(0, 2, (120, 3))
    assert largest_cluster(cloud, 0.25, 1.0) == naive.largest_cluster(cloud.tolist(), 0.25, 1.0)
    theirs = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud))
    labels = np.asarray(theirs.cluster_dbscan(0.25, 1))
    sizes = [int((labels == one).sum()) for one in set(labels) if (cloud[labels == one][:, 2] >= 1.0).any()]
    assert largest_cluster(cloud, 0.25, 1.0) == max(sizes)


def clusters(target, where, rule, lost=0, sensors=0, joint=True, cap=1 << 20):
    found = count_clusters(
        where, target, scanners_of(MOUNTS), poses_of(MOUNTS), NO_OBSTACLES, rule, lost, sensors, joint, cap
    )
    return found.counts[:, 0].tolist(), found.phases


@pytest.mark.parametrize(("lost", "sensors"), [(0, 0), (1, 0), (0, 1), (0, 2), (1, 1)])
def test_a_wide_tolerance_counts_all_returns(lost, sensors):
    rng = np.random.default_rng(2)
    where = np.stack([rng.uniform(3, 12, 12), rng.uniform(-6, 6, 12), np.zeros(12), rng.uniform(0, 6, 12)], axis=1)
    target = Target(box(0.4, 0.4, 1.1))
    whole = returns(where, target, scanners_of(MOUNTS), poses_of(MOUNTS))
    expected = [
        naive.worst_returns([one[s, :n].tolist() for s, n in enumerate(whole.phases)], lost, sensors or None)
        for one in whole.counts
    ]
    found, phases = clusters(target, where, ClusterRule(100.0, LOW), lost, sensors)
    assert found == expected
    if not sensors:
        assert ((phases < 0).sum(axis=1) == lost).all()
    capped, _ = clusters(target, where, ClusterRule(100.0, LOW), lost, sensors, cap=5)
    assert all(one == other or other >= one >= 5 for one, other in zip(capped, expected, strict=True))


def test_two_boxes_are_two_clusters():
    """1 m apart across the line of sight: the larger count of the two, each counted alone."""
    one, other = box(0.3, 0.3, 1.0), box(0.3, 0.6, 0.8)
    both = join_meshes([(one[0] + (0, -1.0, 0), one[1]), (other[0] + (0, 0.85, 0), other[1])])
    where = np.array([[6.0, 0.0, 0.0, 0.0]])
    found, _ = clusters(Target(both), where, ClusterRule(0.6, LOW), joint=True)
    counts = []
    for mesh, y in ((one, -1.0), (other, 0.85)):
        alone = returns(where + np.array([0, y, 0, 0]), Target(mesh), scanners_of(MOUNTS), poses_of(MOUNTS))
        counts.append([alone.counts[0, s, :n] for s, n in enumerate(alone.phases)])
    worst = min(
        max(counts[0][0][a] + counts[0][1][b], counts[1][0][a] + counts[1][1][b])
        for a in range(len(counts[0][0]))
        for b in range(len(counts[0][1]))
    )
    assert found == [worst]
