from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

class Bvh:
    """An immutable bounding volume hierarchy over S shapes, in the order of its leaves: a slot is a place there."""

    def __init__(
        self, shapes: Array, kind: NDArray[np.uint8], number: NDArray[np.int32], object: NDArray[np.int32]
    ) -> None:
        """Build it over shapes (S, 9) of kinds (S,) with numbers (S,), which belong to objects (S,)."""
    def __len__(self) -> int: ...
    @property
    def shapes(self) -> Array: ...
    @property
    def kind(self) -> NDArray[np.uint8]: ...
    @property
    def number(self) -> NDArray[np.int32]: ...
    @property
    def object(self) -> NDArray[np.int32]: ...

def first_hits(
    bvh: Bvh, origins: Array, directions: Array, limit_m: float, range_m: Array, slot: NDArray[np.int32]
) -> None:
    """Write ranges and slots (N,) of what rays (3, N) along unit vectors hit first: inf and -2 if nothing."""

def any_hits(bvh: Bvh, origins: Array, directions: Array, hit: NDArray[np.bool_]) -> None:
    """Write which (N,) of the open segments (3, N) from origins along directions, to their ends, a hierarchy blocks."""

class Path:
    """An immutable motion, in the frame at its time 0."""

    def at(self, seconds: Array) -> tuple[Array, Array]:
        """Rotations (N, 3, 3) and positions (N, 3) at times (N,)."""

def path_of_velocity(velocity_m_s: Sequence[float]) -> Path:
    """Along a line, from the origin at time 0."""

def path_of_arc(speed_m_s: float, yaw_rate_rad_s: float, heading_rad: float) -> Path:
    """Along a circle, from the origin at time 0, where it heads that far from x."""

def path_of_poses(times_s: Array, positions_m: Array, rotations: Array, rotation_vectors_rad: Array) -> Path:
    """Through poses (K, 3) and (K, 3, 3) at ascending times (K,); vectors (K, 3) turn each into the next."""

class Found(Protocol):
    """What N rays hit first, to be written; columns that are not asked for have no rows."""

    @property
    def range_m(self) -> Array: ...
    @property
    def slot(self) -> NDArray[np.int32]: ...
    @property
    def normal(self) -> Array: ...
    @property
    def cosine(self) -> Array: ...

class World:
    """All that rays may hit, immutable. Slots count through the static hierarchy, then through the moving ones."""

    def __init__(
        self,
        ground_m: float,
        fixed: Bvh,
        moving: Sequence[Bvh],
        places_m: Array,
        speeds_m_s: Array,
        paths: Sequence[Path],
    ) -> None:
        """Of P moving objects: places (P, 3), greatest speeds (P,), paths. No ground: its height is inf."""
    def __len__(self) -> int: ...
    @property
    def fixed(self) -> Bvh: ...
    def cast(self, origins: Array, directions: Array, seconds: Array, limit_m: float, found: Found) -> None:
        """Write what rays (3, N) along unit vectors at times (N,) hit first within a limit."""
    def resolve(self, slot: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The objects and the triangles (N,) of slots (N,); -1: none."""

def toggle_points(vertices: Array, triangles: NDArray[np.int64], points: Array, odd: NDArray[np.bool_]) -> None:
    """Toggle odd (N,) for each of the triangles (T, 3) of vertices (V, 3) that is before a point (N, 3), along x."""

def toggle_lines(
    vertices: Array,
    triangles: NDArray[np.int64],
    lines: NDArray[np.int64],
    x: Array,
    y: Array,
    z: Array,
    odd: NDArray[np.bool_],
) -> None:
    """Toggle odd (ny, nz, nx + 1) at the first point beyond each triangle on lines (T, 4) along x that cross it."""
