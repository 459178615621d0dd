"""Coverage: how many beams cross a straight line of cuboids, as a map of the region from above, the side or the front.

A beam is a whole cone. It crosses a line where the line's centres lie on both sides of it, so a thin pole that stood
along the line would be hit by it; it counts once, however often it crosses. Cuboids that are excluded, and those that
its sensor does not see, do not count.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core
from lidarcfg.placement.subspace import BLIND, Subspaces

Lines = NDArray[np.int32]
Counts = NDArray[np.int64]
MOST = np.int32(2**31 - 1)


class Span(NamedTuple):
    """The least and the greatest beam gap of each LiDAR on lines of cuboids: (lidars, a, b) each."""

    low: Lines
    high: Lines


def beams_across(subspaces: Subspaces) -> tuple[Counts, Counts, Counts]:
    """The number of each LiDAR's beams that cross the lines along x, y and z: (lidars, a, b) for the other two axes.

    −1 where a line has no cuboid that counts.
    """
    included, lidars = subspaces.region.included, subspaces.gap.shape[1]
    empty = [~included.any(axis=axis) for axis in range(3)]
    x_span, y_span, z_span = [
        Span(np.full((lidars, *one.shape), MOST, np.int32), np.full((lidars, *one.shape), -1, np.int32))
        for one in empty
    ]
    core.visibility.widen_spans(subspaces.label, subspaces.gap, BLIND, x_span, y_span, z_span)
    x, y, z = (
        np.where(none, -1, np.maximum(span.high.astype(np.int64) - span.low, 0))
        for none, span in zip(empty, (x_span, y_span, z_span), strict=True)
    )
    return x, y, z


@dataclass(frozen=True)
class Coverage:
    """The beams across lines of cuboids, and figures of the upright lines."""

    beams: tuple[Counts, Counts, Counts]  # (lidars, a, b) across the lines along x, y and z; −1 where none counts
    median_beams: float
    by_none: float  # fraction of the lines that no beam crosses
    by_one_sensor: float  # fraction whose beams are all of one sensor


def coverage(subspaces: Subspaces) -> Coverage:
    """The beams across the lines of cuboids along each axis."""
    along_x, along_y, along_z = beams_across(subspaces)
    upright = along_z[:, along_z[0] >= 0]
    sensors = (upright > 0).sum(axis=0)
    return Coverage(
        (along_x, along_y, along_z),
        float(np.median(upright.sum(axis=0))),
        float((sensors == 0).mean()),
        float((sensors == 1).mean()),
    )
