"""The loops of encoding: firings in flat columns, and what blocks say of ranges and reflectivities."""

import numpy as np

from lidarcfg.jit import njit


@njit(cache=True, nogil=True)
def fired(start_ns, encoder_rad, loop, lasers, offset_ns):
    """Times, lasers and encoder angles (P × G × F,) of groups (P, G) that start so.

    In each loop the `lasers` (loops, F) fire, with offsets (loops, L).
    """
    packets, groups = start_ns.shape
    count = packets * groups * lasers.shape[1]
    time_ns, laser, encoder = np.empty(count, np.int64), np.empty(count, np.uint8), np.empty(count)
    n = 0
    for p in range(packets):
        for g in range(groups):
            for k in lasers[loop[p, g]]:
                time_ns[n] = start_ns[p, g] + offset_ns[loop[p, g], k]
                laser[n] = k
                encoder[n] = encoder_rad[p, g]
                n += 1
    return time_ns, laser, encoder


@njit(cache=True, nogil=True)
def fill(range_m, reflectivity, laser, column, inside, limits, distance, intensity):
    """Write the blocks of packets (P, B, L): block b holds column `column[b]` of the returns (P, G, F, R).

    They are those of `laser` (P, G, F), if the group is inside (P, G) the field of view. Limits are least and most
    metres, the unit and how many units there may be. What is not written is 0.
    """
    least_m, most_m, unit_m, units_max = limits
    each = len(column) // range_m.shape[1]
    for p in range(len(range_m)):
        for b in range(len(column)):
            g, c = b // each, column[b]
            if inside[p, g]:
                for j in range(range_m.shape[2]):
                    at_m, k = range_m[p, g, j, c], laser[p, g, j]
                    units = np.rint(at_m / unit_m) if least_m <= at_m <= most_m else 0.0
                    if 0 < units <= units_max:
                        distance[p, b, k] = np.uint16(units)
                        intensity[p, b, k] = reflectivity[p, g, j, c]
