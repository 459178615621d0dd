from typing import Annotated, Any

import numpy
from numpy.typing import NDArray

import lidarcfg.core.world

class Firings:
    """Firings of one sensor."""

    def __init__(
        self,
        time_ns: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        laser: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        encoder_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        elevation_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        start_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    ) -> None: ...
    @property
    def time_ns(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    @property
    def laser(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    @property
    def encoder_rad(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def elevation_rad(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def start_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Surfaces:
    """Which objects are hit, and how they reflect."""

    def __init__(
        self,
        object: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
        reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    ) -> None: ...
    @property
    def object(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,))]: ...
    @property
    def reflectivity(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Lasers:
    """The lasers of a sensor, and the rays of a beam of each."""

    def __init__(
        self,
        cos_elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        sin_elevation: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        cos_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        sin_offset: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        forward_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        left_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        up_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        across: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        above: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    ) -> None: ...
    @property
    def cos_elevation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def sin_elevation(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def cos_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def sin_offset(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def forward_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def left_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def up_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def across(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def above(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Mounting:
    """Where a sensor is."""

    def __init__(
        self,
        T_world_start: Annotated[NDArray[numpy.float64], dict(shape=(4, 4))],
        path: lidarcfg.core.world.Path,
        zero_ns: int,
        T_vehicle_sensor: Annotated[NDArray[numpy.float64], dict(shape=(4, 4))],
    ) -> None: ...
    @property
    def T_world_start(self) -> Annotated[NDArray[numpy.float64], dict(shape=(4, 4))]: ...
    @property
    def path(self) -> lidarcfg.core.world.Path: ...
    @property
    def zero_ns(self) -> int: ...
    @property
    def T_vehicle_sensor(self) -> Annotated[NDArray[numpy.float64], dict(shape=(4, 4))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Hits:
    """
    What the K rays of N firings hit, to be written; `cosine` may be without rows.
    """

    def __init__(
        self,
        range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
        reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
        object: Annotated[NDArray[numpy.int32], dict(shape=(None, None))],
        cosine: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    ) -> None: ...
    @property
    def range_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    @property
    def reflectivity(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]: ...
    @property
    def object(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None, None))]: ...
    @property
    def cosine(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class SubRays:
    """What the rays of beams hit, and which lasers fired."""

    def __init__(
        self,
        range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
        reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
        object: Annotated[NDArray[numpy.int32], dict(shape=(None, None))],
        cosine: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
        laser: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    ) -> None: ...
    @property
    def range_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    @property
    def reflectivity(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]: ...
    @property
    def object(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None, None))]: ...
    @property
    def cosine(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    @property
    def laser(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Candidates:
    """Candidates of N firings, to be written."""

    def __init__(
        self,
        range_m: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
        reflectivity: Annotated[NDArray[numpy.uint8], dict(shape=(None, None))],
        object: Annotated[NDArray[numpy.int32], dict(shape=(None, None))],
    ) -> None: ...
    @property
    def range_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]: ...
    @property
    def reflectivity(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None, None))]: ...
    @property
    def object(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def merge_echoes(
    rays: SubRays,
    weights: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    range_max_m: float,
    step_rad: float,
    least: float,
    droplets: Annotated[NDArray[numpy.float64], dict(shape=(None, 2))],
    fade: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    which: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
    out: Candidates,
) -> None:
    """
    Write candidates `which` (C,) of beams of K rays (N, K) with weights: ranges, reflectivities, objects (N, C).

    Echoes beyond a range, or with less than the least power, do not count; `step_rad` is the angle between
    neighbouring rays. In bad weather droplets (N, 2) are range and albedo of what the weather echoes, and fade
    (N, K + 1) is what is left of the light; else both are empty.
    """

def aim_firings(
    lasers: Lasers,
    mounting: Mounting,
    firings: Firings,
    origins_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    directions: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
) -> None:
    """
    Write where the beams of firings start in the world, and their unit vectors; a beam has one ray.
    """

def trace_firings(
    world: lidarcfg.core.world.World,
    bodies: lidarcfg.core.world.Bvh,
    surfaces: Surfaces,
    lasers: Lasers,
    mounting: Mounting,
    firings: Firings,
    zero_ns: int,
    limit_m: float,
    hits: Hits,
) -> None:
    """
    Write what the K rays (N, K) of N firings hit within a limit, K being 1 or 9; `cosine` may be without rows.

    The bodies are in the vehicle's frame. Moving objects have their time 0 at `zero_ns`.
    """
