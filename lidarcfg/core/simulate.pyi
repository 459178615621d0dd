from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.simulate.echoes import Echoes, SubRays

def merge_echoes(
    rays: SubRays,
    weights: Array,
    range_max_m: float,
    step_rad: float,
    least: float,
    droplets: Array,
    fade: Array,
    out: Echoes,
) -> None:
    """Write the six candidates (N, 6) of beams of K rays (N, K) with weights (K,) to ranges, reflectivities, objects.

    Echoes beyond a range, or with less than the least power, do not count; `step_rad` is the angle between neighbouring
    rays. In bad weather droplets (N, 2) are range and albedo of what the weather echoes, and fade (N, K + 1) is what is
    left of the light; else both are empty.
    """
