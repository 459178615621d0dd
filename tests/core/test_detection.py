"""The core's boxes that touch subspaces."""

import numpy as np
import pytest

from lidarcfg.core import vsr as core

ONE = (1.0, 1.0, 1.0)


@pytest.mark.parametrize("high", [3, 64, 70, 130])
def test_boxes_are_counted_at_every_place(high):
    rng = np.random.default_rng(high)
    label = np.repeat(rng.integers(-1, 9, (4, 3, -(-high // 5))), 5, axis=2)[:, :, :high].astype(np.int32)
    for size in ((1, 1, 1), (2, 2, 3), (4, 3, high)):
        boxes = np.lib.stride_tricks.sliding_window_view(label, size).reshape(-1, np.prod(size))
        free = boxes[(boxes >= 0).all(axis=1)]
        for threshold in range(4):
            held = np.zeros(9, bool)
            detected, places = core.detected_positions(label, size, threshold, high, 2**62, held)
            assert places.shape == tuple(np.subtract(label.shape, size)[:2] + 1)
            assert places.sum() == len(free)
            assert detected.sum() == sum(len(set(box)) > threshold for box in free)
            assert set(np.flatnonzero(held)) == {box[0] for box in free if len(set(box)) == 1}
    one = (1, 1, 1)
    assert core.detected_positions(label, one, 2**31, high, 2**62, held)[0].sum() == 0  # more than there can be
    rows = core.detected_positions(label, one, 2**31, high, -(2**63), held)[1]
    assert np.count_nonzero(rows.ravel()[1:]) == 0  # so many were missed before the first row
    for changed in ((0, 1, 1), (5, 1, 1), (1, 1, high + 1)):
        with pytest.raises(ValueError, match="size"):
            core.detected_positions(label, changed, 1, 1, 1, held)
    for arguments, named in (
        ((-1, 1, 1, held), "threshold"),
        ((1, 0, 1, held), "layers"),
        ((1, 1, 1, held[:1]), "held"),
    ):
        with pytest.raises(ValueError, match=named):
            core.detected_positions(label, (1, 1, 1), *arguments)


def test_boxes_anywhere():
    label = np.arange(27, dtype=np.int32).reshape(3, 3, 3)
    label[2, 2] = -1
    boxes = np.array([(1, 1, 0, 0), (1.5, 1.5, 1, np.pi / 4), (2.5, 2.5, 0, 0), (9, 9, 9, 0), (np.nan, 1, 1, 0)])
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[:1], (1, 1, 1), 3) == (1, 1)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[1:2], (0.5, 0.5, 0.5), 0) == (1, 1)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[2:3], (0.5, 0.5, 0.5), 0) == (0, 0)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[3:], (0.5, 0.5, 0.5), 0)[0] == 0
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[:0], ONE, 0) == (0, 0)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[:1], (1, 1, 1), 2**31) == (0, 1)
    with pytest.raises(ValueError, match="edge"):
        core.detected_boxes(label, (0, 0, 0), (1, 1, np.nan), boxes, ONE, 0)
    with pytest.raises(ValueError, match="threshold"):
        core.detected_boxes(label, (0, 0, 0), ONE, boxes, ONE, -1)
    with pytest.raises(TypeError, match="boxes"):
        core.detected_boxes(label, (0, 0, 0), ONE, boxes[:, :3].copy(), ONE, 0)
