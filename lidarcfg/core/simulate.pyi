from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core import world

Array = NDArray[np.float64]

class Firings(Protocol):
    """Firings of one sensor."""

    @property
    def time_ns(self) -> NDArray[np.int64]: ...
    @property
    def laser(self) -> NDArray[np.uint8]: ...
    @property
    def encoder_rad(self) -> Array: ...
    @property
    def elevation_rad(self) -> Array: ...

class Surfaces(Protocol):
    """Which objects are hit, and how they reflect."""

    @property
    def object(self) -> NDArray[np.int32]: ...
    @property
    def reflectivity(self) -> NDArray[np.uint8]: ...

class Lasers(Protocol):
    """The lasers of a sensor, and the rays of a beam of each."""

    @property
    def cos_elevation(self) -> Array: ...
    @property
    def sin_elevation(self) -> Array: ...
    @property
    def cos_offset(self) -> Array: ...
    @property
    def sin_offset(self) -> Array: ...
    @property
    def forward_m(self) -> Array: ...
    @property
    def left_m(self) -> Array: ...
    @property
    def up_m(self) -> Array: ...
    @property
    def across(self) -> Array: ...
    @property
    def above(self) -> Array: ...

class Mounting(Protocol):
    """Where a sensor is."""

    @property
    def T_world_start(self) -> Array: ...
    @property
    def path(self) -> world.Path: ...
    @property
    def zero_ns(self) -> int: ...
    @property
    def T_vehicle_sensor(self) -> Array: ...

class SubRays(Protocol):
    """What the rays of beams hit; written by trace_firings, but `laser`."""

    @property
    def range_m(self) -> Array: ...
    @property
    def reflectivity(self) -> NDArray[np.uint8]: ...
    @property
    def object(self) -> NDArray[np.int32]: ...
    @property
    def cosine(self) -> Array: ...
    @property
    def laser(self) -> NDArray[np.uint8]: ...

class Echoes(Protocol):
    """Candidates of firings, to be written."""

    @property
    def range_m(self) -> Array: ...
    @property
    def reflectivity(self) -> NDArray[np.uint8]: ...
    @property
    def object(self) -> NDArray[np.int32]: ...

class Axes(Protocol):
    """The axes of beams in the world, (N, 3), to be written."""

    @property
    def origins_m(self) -> Array: ...
    @property
    def directions(self) -> Array: ...

def aim_firings(lasers: Lasers, mounting: Mounting, firings: Firings, axes: Axes) -> None:
    """Write where the beams of firings start and point; a beam has one ray."""

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
