"""The loops of encoding: firings in flat columns, and what blocks say of ranges and reflectivities."""

import numpy as np

from lidarcfg.jit import njit


@njit(cache=True, nogil=True)
def fired(start_ns, encoder_rad, loop, offset_ns):
    """Times, lasers and encoder angles (P × G × L,) of groups (P, G) that start so, with offsets (loops, L)."""
    packets, groups = start_ns.shape
    lasers = offset_ns.shape[1]
    count = packets * groups * lasers
    time_ns, laser, encoder = np.empty(count, np.int64), np.empty(count, np.uint8), np.empty(count)
    n = 0
    for p in range(packets):
        for g in range(groups):
            for k in range(lasers):
                time_ns[n] = start_ns[p, g] + offset_ns[loop[p, g], k]
                laser[n] = k
                encoder[n] = encoder_rad[p, g]
                n += 1
    return time_ns, laser, encoder


@njit(cache=True, nogil=True)
def fill(range_m, reflectivity, column, fires, limits, distance, intensity):
    """Write the blocks of packets (P, B, L): block b holds column `column[b]` of the returns (P, G, L, R).

    The lasers fire (P, G, L) or rest. Limits are least and most metres, the unit and how many units there may be.
    """
    least_m, most_m, unit_m, units_max = limits
    each = len(column) // range_m.shape[1]
    for p in range(len(range_m)):
        for b in range(len(column)):
            g, c = b // each, column[b]
            for k in range(range_m.shape[2]):
                met_m, units = range_m[p, g, k, c], 0.0
                if least_m <= met_m <= most_m and fires[p, g, k]:
                    units = np.rint(met_m / unit_m)
                sent = 0 < units <= units_max
                distance[p, b, k] = np.uint16(units) if sent else np.uint16(0)
                intensity[p, b, k] = reflectivity[p, g, k, c] if sent else np.uint8(0)
