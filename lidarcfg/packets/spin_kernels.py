"""The loop of schedules: where the head points at each firing."""

import math

import numpy as np

from lidarcfg.jit import njit


@njit(cache=True, nogil=True)
def turned(revolutions, offset_ns, revolutions_per_ns, first_ns):
    """Times and azimuths (P × N,) of firings that come so much (N,) after their packets' stamps (P,).

    `revolutions` (P,) is how far the head has turned then.
    """
    count = len(offset_ns)
    time_ns, encoder_rad = np.empty(len(revolutions) * count, np.int64), np.empty(len(revolutions) * count)
    for p in range(len(revolutions)):
        for k in range(count):
            turn = revolutions[p] + offset_ns[k] * revolutions_per_ns
            time_ns[p * count + k] = first_ns[p] + offset_ns[k]
            encoder_rad[p * count + k] = (turn - math.floor(turn)) * (2 * math.pi)
    return time_ns, encoder_rad
