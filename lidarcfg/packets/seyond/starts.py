"""Where the beams of Seyond's sensors start: its SDK adds that to all points, by angle and channel or line.

Tables and arithmetic: Seyond-Inc/inno-lidar-sdk 3.103.4, InnoDataPacketUtils::get_xyzr_meter and what it calls.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lidarcfg.files import shipped
from lidarcfg.geometry import Array
from lidarcfg.packets.seyond.layout import Integers

FILE = "seyond-starts.npz"
CELL = 512  # units of angles
FALCON_STEP_M = 0.0025
ROBIN_STEP_M = 0.001
FALCON_AT = 6, 22  # the cell of angle 0: elevation, azimuth
FALCON_CELLS = 16, 64
ROBIN_AT = 27
ROBIN_CELLS = 64
GROUP = 12  # of channels whose lines are four apart
LINES = 48  # of a facet


@cache
def _tables() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(16, 64, 4, 2) of a Falcon: up and ahead; (192, 64, 3) of a Robin W: up, right and ahead. 0 beyond the edges."""
    with np.load(shipped("sensors") / FILE) as tables:
        falcon, robin = tables["falcon"].astype(np.int64), tables["robin_w"].astype(np.int64)
    over = [(0, full - size) for full, size in zip(FALCON_CELLS, falcon.shape[:2], strict=True)]
    falcon = np.pad(falcon, [*over, (0, 0), (0, 0)])
    return falcon, np.pad(robin, [(0, 0), (0, ROBIN_CELLS - robin.shape[1]), (0, 0)])


def channel_starts_m(azimuth: Integers, elevation: Integers, channel: Integers) -> Array:
    """(..., 3) where beams of a Falcon with these angles (...) in units and channels start, in the sensor's frame."""
    table, _ = _tables()
    at = []
    for angle, middle, cells in zip((elevation, azimuth), FALCON_AT, FALCON_CELLS, strict=True):
        cell = np.sign(angle) * (abs(angle) // CELL)  # towards 0
        at.append((cell + middle) % cells)
    up, ahead = np.moveaxis(table[at[0], at[1], channel], -1, 0)
    return np.stack([ahead, np.zeros_like(up), up], axis=-1) * FALCON_STEP_M


def line_starts_m(azimuth: Integers, line: Integers) -> Array:
    """(..., 3) where beams of a Robin W with these azimuths (...) in units and lines start, in the sensor's frame."""
    _, table = _tables()
    turned = azimuth + ROBIN_AT * CELL
    cell = np.minimum(turned // CELL % ROBIN_CELLS, ROBIN_CELLS - 2)
    part = (turned % CELL)[..., None]
    steps = (table[line, cell] * (CELL - part) + table[line, cell + 1] * part + CELL // 2) // CELL
    up, right, ahead = np.moveaxis(steps, -1, 0)
    return np.stack([ahead, -right, up], axis=-1) * ROBIN_STEP_M


def line_of(scan: Integers, facet: Integers, channel: Integers) -> Integers:
    """The lines, 0 to 191, of a Robin W's sets of channels (`scan`, 0 to 5), facets and channels."""
    order = scan * 8 + channel
    return np.asarray(order % GROUP * 4 + order // GROUP + LINES * facet)
