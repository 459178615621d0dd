"""Columns of cuboids: the core on small cases, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.core import vsr


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_lines_of_cuboids_beside_plain_loops(seed):
    rng = np.random.default_rng(seed)
    nx, ny, nz = rng.integers(1, 5, 3)
    label = rng.integers(-1, 3, (nx, ny, nz)).astype(np.int32)
    shapes = (ny, nz), (nx, nz), (nx, ny)
    row_of = np.array([1, -1, 0, -1])
    lines = [np.full((2, *shape), 2**31 - 1, np.int32) for shape in shapes]
    vsr.count_lines(label, row_of, *lines)
    for row, subspace in ((1, 0), (0, 2)):
        for axis in range(3):
            assert np.array_equal(lines[axis][row], (label == subspace).sum(axis=axis))
    gap = rng.integers(-1, 4, (3, 2))
    spans = [vsr.Span(np.full((2, *shape), 99, np.int32), np.full((2, *shape), -9, np.int32)) for shape in shapes]
    vsr.widen_spans(label, gap, -1, *spans)
    gaps = np.where(label[..., None] < 0, -1, gap[label])
    for axis, span in enumerate(spans):
        for lidar in range(2):
            here = gaps[..., lidar]
            assert np.array_equal(span.low[lidar], np.where(here < 0, 99, here).min(axis=axis))
            assert np.array_equal(span.high[lidar], np.where(here < 0, -9, here).max(axis=axis))
    ends = np.sort(rng.integers(0, [[nx + 1], [ny + 1], [nz + 1]], (3, 2)), axis=1)
    found = np.zeros(4, bool)
    vsr.mark_subspaces(label, ends, found)
    part = label[ends[0, 0] : ends[0, 1], ends[1, 0] : ends[1, 1], ends[2, 0] : ends[2, 1]]
    assert found.tolist() == [n in part for n in (0, 1, 2, -1)]


LABEL = np.zeros((1, 2, 3), np.int32)
LINES = [np.zeros((1, *shape), np.int32) for shape in ((2, 3), (1, 3), (1, 2))]
SPANS = [vsr.Span(one, one) for one in LINES]


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: vsr.mark_subspaces(LABEL, np.array([[0, 2], [0, 2], [0, 3]]), np.zeros(2, bool)), "cells"),
        (lambda: vsr.mark_subspaces(LABEL, np.array([[-1, 1], [0, 2], [0, 3]]), np.zeros(2, bool)), "cells"),
        (lambda: vsr.mark_subspaces(LABEL, np.zeros((3, 3), np.int64), np.zeros(2, bool)), "cells"),
        (lambda: vsr.mark_subspaces(LABEL + 1, np.array([[0, 1]] * 3), np.zeros(2, bool)), "label"),
        (lambda: vsr.count_lines(LABEL, np.array([1, -1]), *LINES), "row_of"),
        (lambda: vsr.count_lines(LABEL, np.empty(0, np.int64), *LINES), "label"),
        (lambda: vsr.count_lines(LABEL - 2, np.array([0, -1]), *LINES), "label"),
        (lambda: vsr.count_lines(LABEL, np.array([0, -1]), LINES[1], *LINES[1:]), "x"),
        (lambda: vsr.widen_spans(LABEL, np.zeros((1, 2), np.int64), -1, *SPANS), "x"),
        (lambda: vsr.widen_spans(LABEL + 1, np.zeros((1, 1), np.int64), -1, *SPANS), "label"),
    ],
)
def test_what_is_refused_is_named(call, named):
    with pytest.raises((TypeError, ValueError), match=named):
        call()
