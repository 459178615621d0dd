from collections.abc import Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray

class Bvh:
    """
    An immutable bounding volume hierarchy over S shapes, in the order of its leaves: a slot is a place there.
    """

    def __init__(
        self,
        shapes: Annotated[NDArray[numpy.float64], dict(shape=(None, 9))],
        kind: Annotated[NDArray[numpy.uint8], dict(shape=(None,))],
        number: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
        object: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
    ) -> None:
        """
        Build it over shapes (S, 9) of kinds (S,) with numbers (S,), which belong to objects (S,).
        """

    def __len__(self) -> int: ...
    def __getstate__(self) -> tuple[bytes, ...]: ...
    def __setstate__(self, arg: tuple[bytes, ...], /) -> None: ...
    @property
    def number(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def object(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,), writable=False)]: ...
    @property
    def kind(self) -> Annotated[NDArray[numpy.uint8], dict(shape=(None,), writable=False)]: ...
    @property
    def shapes(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 9), writable=False)]: ...

def first_hits(
    bvh: Bvh,
    origins: Annotated[NDArray[numpy.float64], dict(shape=(3, None))],
    directions: Annotated[NDArray[numpy.float64], dict(shape=(3, None))],
    limit_m: float,
    range_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    slot: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
) -> None:
    """
    Write ranges and slots (N,) of what rays (3, N) along unit vectors hit first: inf and -2 if nothing.
    """

def any_hits(
    bvh: Bvh,
    origins: Annotated[NDArray[numpy.float64], dict(shape=(3, None))],
    directions: Annotated[NDArray[numpy.float64], dict(shape=(3, None))],
    hit: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
) -> None:
    """
    Write which (N,) of the open segments (3, N) from origins along directions, to their ends, a hierarchy blocks.
    """

class Obstacles:
    """What blocks beams, relative to a point."""

    def __init__(
        self,
        tree: Bvh,
        boxes: Annotated[NDArray[numpy.float64], dict(shape=(6, None))],
        origin_m: Annotated[NDArray[numpy.float64], dict(shape=(3))],
        ground_m: float,
    ) -> None: ...
    @property
    def tree(self) -> Bvh: ...
    @property
    def boxes(self) -> Annotated[NDArray[numpy.float64], dict(shape=(6, None))]: ...
    @property
    def origin_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(3))]: ...
    @property
    def ground_m(self) -> float: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Found:
    """
    What N rays hit first, to be written; columns that are not asked for have no rows.
    """

    def __init__(
        self,
        range_m: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        slot: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
        normal: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        cosine: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    ) -> None: ...
    @property
    def range_m(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def slot(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None,))]: ...
    @property
    def normal(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 3))]: ...
    @property
    def cosine(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def boxes_of(bvh: Bvh) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    (6, 16) low and high corners of boxes that together hold a hierarchy's shapes; (6, 0) if there are none.
    """

class Path:
    """An immutable motion, in the frame at its time 0."""

    def at(
        self, seconds: Annotated[NDArray[numpy.float64], dict(shape=(None,))]
    ) -> tuple[
        Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))],
        Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    ]:
        """Rotations (N, 3, 3) and positions (N, 3) at times (N,)."""

def path_of_velocity(velocity_m_s: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))]) -> Path:
    """Along a line, from the origin at time 0."""

def path_of_arc(speed_m_s: float, yaw_rate_rad_s: float, heading_rad: float) -> Path:
    """
    Along a circle, from the origin at time 0, where it heads that far from x.
    """

def path_of_poses(
    times_s: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    positions_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    rotations: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
    rotation_vectors_rad: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
) -> Path:
    """
    Through poses (K, 3) and (K, 3, 3) at ascending times (K,); vectors (K, 3) turn each into the next.
    """

class World:
    """
    All that rays may hit, immutable. Slots count through the static hierarchy, then through the moving ones.
    """

    def __init__(
        self,
        ground_m: float,
        fixed: Bvh,
        moving: Sequence[Bvh],
        places_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        speeds_m_s: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        paths: Sequence[Path],
    ) -> None:
        """
        Of P moving objects: places (P, 3), greatest speeds (P,), paths. No ground: its height is inf.
        """

    def __len__(self) -> int: ...
    @property
    def fixed(self) -> Bvh: ...
    def along(self, speeds_m_s: Annotated[NDArray[numpy.float64], dict(shape=(None,))], paths: Sequence[Path]) -> World:
        """
        This world where its P moving objects have other greatest speeds (P,) and paths; hierarchies are shared.
        """

    def cast(
        self,
        origins: Annotated[NDArray[numpy.float64], dict(shape=(3, None))],
        directions: Annotated[NDArray[numpy.float64], dict(shape=(3, None))],
        seconds: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        limit_m: float,
        found: Found,
    ) -> None:
        """
        Write what rays (3, N) along unit vectors at times (N,) hit first within a limit.
        """

    def resolve(
        self, slot: Annotated[NDArray[numpy.int32], dict(shape=(None,))]
    ) -> tuple[
        Annotated[NDArray[numpy.int32], dict(shape=(None,))], Annotated[NDArray[numpy.int32], dict(shape=(None,))]
    ]:
        """The objects and the triangles (N,) of slots (N,); -1: none."""

def toggle_points(
    vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    triangles: Annotated[NDArray[numpy.int64], dict(shape=(None, 3))],
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    odd: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
) -> None:
    """
    Toggle odd (N,) for each of the triangles (T, 3) of vertices (V, 3) that is before a point (N, 3), along x.
    """

def toggle_lines(
    vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    triangles: Annotated[NDArray[numpy.int64], dict(shape=(None, 3))],
    lines: Annotated[NDArray[numpy.int64], dict(shape=(None, 4))],
    x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    y: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    z: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    odd: Annotated[NDArray[numpy.bool_], dict(shape=(None, None, None))],
) -> None:
    """
    Toggle odd (ny, nz, nx + 1) at the first point beyond each triangle on lines (T, 4) along x that cross it.
    """
