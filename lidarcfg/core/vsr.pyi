from collections.abc import Sequence
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray

import lidarcfg.core.world

class Sight:
    """What LiDARs at known poses may see."""

    def __init__(
        self, limits: Annotated[NDArray[numpy.float64], dict(shape=(None, 9))], obstacles: lidarcfg.core.world.Obstacles
    ) -> None: ...
    @property
    def limits(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, 9))]: ...
    @property
    def obstacles(self) -> lidarcfg.core.world.Obstacles: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Placed:
    """LiDARs at poses."""

    def __init__(
        self,
        cones: Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))],
        limits: Annotated[NDArray[numpy.float64], dict(shape=(None, None, 9))],
        obstacles: lidarcfg.core.world.Obstacles,
    ) -> None: ...
    @property
    def cones(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))]: ...
    @property
    def limits(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None, 9))]: ...
    @property
    def obstacles(self) -> lidarcfg.core.world.Obstacles: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Batch:
    """Trials to evaluate, and what is known of their food sources."""

    def __init__(
        self,
        placed: Placed,
        upper_bound: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        moved: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))],
        source: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        certificates: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
        links: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None, 3))],
        same_position: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))],
        clear: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None))],
        smoothing: float,
    ) -> None: ...
    @property
    def placed(self) -> Placed: ...
    @property
    def upper_bound(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def moved(self) -> Annotated[NDArray[numpy.bool_], dict(shape=(None, None))]: ...
    @property
    def source(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    @property
    def certificates(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    @property
    def links(self) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None, 3))]: ...
    @property
    def same_position(self) -> Annotated[NDArray[numpy.bool_], dict(shape=(None, None))]: ...
    @property
    def clear(self) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None))]: ...
    @property
    def smoothing(self) -> float: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class BatchResult:
    """What becomes of trials, to be written."""

    def __init__(
        self,
        cost: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        refuted_by: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        certificates: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
        links: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, 3))],
        clear: Annotated[NDArray[numpy.uint64], dict(shape=(None, None))],
    ) -> None: ...
    @property
    def cost(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...
    @property
    def refuted_by(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    @property
    def certificates(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]: ...
    @property
    def links(self) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None, 3))]: ...
    @property
    def clear(self) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Sources:
    """Food sources whose links are to be recomputed."""

    def __init__(
        self,
        row: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        placed: Placed,
        changed: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))],
        same_position: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))],
        links: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None, 3))],
        clear: Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None))],
    ) -> None: ...
    @property
    def row(self) -> Annotated[NDArray[numpy.int64], dict(shape=(None,))]: ...
    @property
    def placed(self) -> Placed: ...
    @property
    def changed(self) -> Annotated[NDArray[numpy.bool_], dict(shape=(None, None))]: ...
    @property
    def same_position(self) -> Annotated[NDArray[numpy.bool_], dict(shape=(None, None))]: ...
    @property
    def links(self) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None, 3))]: ...
    @property
    def clear(self) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class Grid:
    """
    A region as rows of bits, 64 cuboids along x, with a margin; it does not change.
    """

    def __init__(
        self,
        x: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        y: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        z: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        included: Annotated[NDArray[numpy.uint64], dict(shape=(None,))],
        edge: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
        weight: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        weighted: Annotated[NDArray[numpy.uint64], dict(shape=(None, None))],
    ) -> None:
        """
        Centres (nx,), (ny,), (nz,); included (rows,); edge (3,); weight (levels,); weighted (levels, rows).
        """

    @property
    def rows(self) -> int:
        """How many rows of bits it has, those of the margin too."""

    @property
    def chunks(self) -> int:
        """How many rows there are along x."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """The cuboids along each axis."""

def beam_gaps(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    cones: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
) -> Annotated[NDArray[numpy.int64], dict(shape=(None, None))]:
    """
    (N, lidars) the beam gap index of points (N, 3) for each LiDAR of cones (lidars, 6 + beams).
    """

def seen(
    grid: Grid, cones: Annotated[NDArray[numpy.float64], dict(shape=(None, None))], sight: Sight
) -> Annotated[NDArray[numpy.uint64], dict(shape=(None, None))]:
    """(lidars, rows) which cuboids each LiDAR sees."""

def links(
    grid: Grid,
    cones: Annotated[NDArray[numpy.float64], dict(shape=(None, None))],
    seen: Annotated[NDArray[numpy.uint64], dict(shape=(None, None))],
    out: Annotated[NDArray[numpy.uint64], dict(shape=(None, 3))],
) -> None:
    """
    Write to out (rows, 3) the links by LiDARs that see seen (lidars, rows), or everything: (0, rows).
    """

def label_components(
    grid: Grid,
    links: Annotated[NDArray[numpy.uint64], dict(shape=(None, 3))],
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
) -> tuple[
    Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
    Annotated[NDArray[numpy.int64], dict(shape=(None,))],
]:
    """
    Write the number of each cuboid's subspace under links (rows, 3) to label (nx, ny, nz), −1 where excluded.

    Returns cuboids (n,) in each, internal faces (n, 3) of each across x, y and z, and the first cuboid (n,) of
    each.
    """

class TrialEvaluator:
    """Evaluates trials. Not for several threads at once."""

    def __init__(
        self, grid: Grid, cases: Annotated[NDArray[numpy.bool_], dict(shape=(None, None))], certificates: int
    ) -> None:
        """
        For rigs in a grid, with the LiDARs of each of the cases (cases, lidars).
        """

    def evaluate_batch(
        self,
        counter: Annotated[NDArray[numpy.int64], dict(shape=(1))],
        most: int,
        batch: Batch,
        in_full: bool,
        result: BatchResult,
    ) -> tuple[int, int, int]:
        """
        Evaluate the next trials, at most so many, that a counter (1,) has, and write what becomes of them.

        Returns how many cases were evaluated in full, how many rows were compared with cones for other trials, and
        how many segments were cast.
        """

    def recompute_links(
        self, counter: Annotated[NDArray[numpy.int64], dict(shape=(1))], most: int, sources: Sources
    ) -> None:
        """
        Compute the links of changed LiDARs of the next food sources of a counter (1,), at most so many.
        """

def promote_certificates(
    certificates: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
    source: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    refuted_by: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
) -> None:
    """
    Move what refuted trials (n,), in their order, to the front of their sources' certificates (sources, c).

    Where refuted_by is −1, no certificate has, and source does not matter.
    """

class Span:
    """Least and greatest beam gaps on lines, to be widened."""

    def __init__(
        self,
        low: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
        high: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    ) -> None: ...
    @property
    def low(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))]: ...
    @property
    def high(self) -> Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))]: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

def mark_subspaces(
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    cells: Annotated[NDArray[numpy.int64], dict(shape=(3, 2))],
    found: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
) -> None:
    """
    Mark in found (n + 1,) the subspaces of label (nx, ny, nz) with a cuboid in cells (3, 2); last: excluded ones.
    """

def count_lines(
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    row_of: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    x: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    y: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    z: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
) -> None:
    """
    Count the cuboids of subspaces on lines: x (n, ny, nz), y (n, nx, nz), z (n, nx, ny); row_of (subspaces + 1,).
    """

def widen_spans(
    label: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    gap: Annotated[NDArray[numpy.int64], dict(shape=(None, None))],
    blind: int,
    x: Span,
    y: Span,
    z: Span,
) -> None:
    """
    Widen the spans of lines along x, y and z by the gaps (n, lidars) of what lies on them, but blind ones.
    """

def detected_positions(
    labels: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    size: Sequence[int] | Annotated[NDArray[numpy.int64], dict(shape=(3))],
    threshold: int,
    layers: int,
    misses: int,
    held: Annotated[NDArray[numpy.bool_], dict(shape=(None,))],
) -> tuple[
    Annotated[NDArray[numpy.int64], dict(shape=(None, None))], Annotated[NDArray[numpy.int64], dict(shape=(None, None))]
]:
    """
    At how many places (mx, my) a box of cuboids touches more than `threshold` subspaces; how many places there are.

    labels (nx, ny, nz), −1 where excluded; the box's lowest layer is one of the first `layers`. Ends after so
    many misses. held (n,) is set for subspaces that a box lies in, if it is not empty.
    """

def detected_boxes(
    labels: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    low: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
    edge: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
    boxes: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
    size: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
    threshold: int,
) -> tuple[int, int]:
    """
    How many boxes (n, 4: centre x, y, bottom, heading) touch more than `threshold` subspaces; how many are free.
    """
