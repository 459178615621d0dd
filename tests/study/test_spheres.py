"""The largest spheres inside subspaces, against plain loops and by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg import inputs
from lidarcfg.errors import LidarcfgError
from lidarcfg.study import spheres
from lidarcfg.study.spheres import clearance_m, largest_spheres
from tests.naive import vsr as naive
from tests.vsr.test_metric import bodies as bodies_in_blobs
from tests.vsr.test_subspace import EDGES, bodies, cells


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.tuples(*[st.integers(1, 4)] * 3))
def test_inscribed_spheres_equal_brute_force(seed, shape):
    """Around the centre that is found, and around any node, too."""
    body = bodies(np.random.default_rng(seed).integers(1, 3, shape))
    found = largest_spheres(body)
    for number in sorted({0, int(body.cuboids.argmax())}):
        expected = naive.inscribed_radius(cells(body, number), EDGES, shape)
        assert found.radius_m[number] == pytest.approx(expected, rel=1e-12)
    assert clearance_m(body, found.centre) == pytest.approx(found.radius_m.max(), rel=1e-12)
    for node in np.random.default_rng(seed).integers(0, 2 * np.array(shape) + 1, (5, 3)).tolist():
        own = body.label[tuple(np.minimum(np.array(node) // 2, np.array(shape) - 1))]
        expected = naive.distance([n / 2 for n in node], naive.outside(cells(body, own), shape), EDGES)
        assert clearance_m(body, tuple(node)) == pytest.approx(expected, rel=1e-12)


def test_of_equal_spheres_the_first_is_found():
    """Three boxes of 10, 9 and 9 × 6 × 5."""
    whole = np.ones((30, 6, 5))
    whole[[10, 20]] = 0
    found = largest_spheres(bodies(whole, (1.0, 1.0, 1.0)))
    assert found.radius_m.tolist() == [2.5, 2.5, 2.5]
    assert found.centre == (5, 5, 5)


@pytest.mark.parametrize("slab", [1, 90, 400])
def test_slabs_find_what_the_whole_grid_finds(monkeypatch, slab):
    """Slabs of as few layers as a sphere reaches, and of some more."""
    for seed in range(3):
        body = bodies_in_blobs((30, 6, 5), np.array((0.1, 0.4, 0.3)), seed)
        whole = largest_spheres(body)
        monkeypatch.setattr(spheres, "SLAB", slab)
        found = largest_spheres(body)
        monkeypatch.undo()
        assert found.radius_m.tolist() == whole.radius_m.tolist()
        assert found.centre == whole.centre


def test_what_memory_does_not_hold_is_refused(monkeypatch):
    body = bodies(np.ones((3, 4, 5)))
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 350 * 60 - 1.0)
    with pytest.raises(LidarcfgError, match="finding spheres in 60 cuboids needs"):
        largest_spheres(body)
