"""The loop of encoding: what packets say of ranges and reflectivities."""

import numpy as np

from lidarcfg.jit import njit


@njit(cache=True, nogil=True)
def fill(range_m, reflectivity, at, limits, data):
    """Write returns into packets (P, size): return n of the N (P, N) to its place at[n].

    Limits are least and most metres, the packet's unit, and how many of them it can say.
    """
    least_m, most_m, unit_m, units_max = limits
    for p in range(len(range_m)):
        packet = data[p]
        for n in range(len(at)):
            measured_m = range_m[p, n]
            units = np.rint(measured_m / unit_m) if least_m <= measured_m <= most_m else 0.0
            if 0 < units <= units_max:
                whole = int(units)
                packet[at[n]], packet[at[n] + 1] = whole >> 8, whole & 255
                packet[at[n] + 2] = reflectivity[p, n]
