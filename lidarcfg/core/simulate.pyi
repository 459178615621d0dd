import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import world
from lidarcfg.geometry import Array
from lidarcfg.sensors.firing import Firings
from lidarcfg.simulate.echoes import Echoes, SubRays
from lidarcfg.simulate.simulator import Lasers, Mounting, Surfaces

def merge_echoes(
    rays: SubRays,
    weights: Array,
    range_max_m: float,
    step_rad: float,
    least: float,
    droplets: Array,
    fade: Array,
    which: NDArray[np.uint8],
    out: Echoes,
) -> None:
    """Write candidates `which` (C,) of beams of K rays (N, K) with weights : ranges, reflectivities, objects (N, C).

    Echoes beyond a range, or with less than the least power, do not count; `step_rad` is the angle between neighbouring
    rays. In bad weather droplets (N, 2) are range and albedo of what the weather echoes, and fade (N, K + 1) is what is
    left of the light; else both are empty.
    """

def trace_firings(
    world: world.World,
    bodies: world.Bvh,
    surfaces: Surfaces,
    lasers: Lasers,
    mounting: Mounting,
    firings: Firings,
    zero_ns: int,
    limit_m: float,
    hits: SubRays,
) -> None:
    """Write what the K rays (N, K) of N firings hit within a limit, K being 1 or 9; `cosine` may be without rows.

    The bodies are in the vehicle's frame. Moving objects have their time 0 at `zero_ns`.
    """

def cos_sin(angle_rad: float) -> tuple[float, float]:
    """Cosine and sine, the same on every processor; the error is some 2e-16 up to many revolutions."""
