from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lidarcfg.core.visibility import Obstacles, Sight

Array = NDArray[np.float64]
Words = NDArray[np.uint64]
Counts = NDArray[np.int64]
Labels = NDArray[np.int32]
Flags = NDArray[np.bool_]
Vector = Array | Sequence[float]

class Placed(Protocol):
    """LiDARs at poses."""

    @property
    def cones(self) -> Array: ...
    @property
    def limits(self) -> Array: ...
    @property
    def obstacles(self) -> Obstacles: ...

class Batch(Protocol):
    """Trials to evaluate, and what is known of their food sources."""

    @property
    def placed(self) -> Placed: ...
    @property
    def upper_bound(self) -> Array: ...
    @property
    def moved(self) -> Flags: ...
    @property
    def source(self) -> Counts: ...
    @property
    def certificates(self) -> Counts: ...
    @property
    def links(self) -> Words: ...
    @property
    def same_position(self) -> Flags: ...
    @property
    def clear(self) -> Words: ...
    @property
    def smoothing(self) -> float: ...

class BatchResult(Protocol):
    """What becomes of trials, to be written."""

    @property
    def cost(self) -> Array: ...
    @property
    def refuted_by(self) -> Counts: ...
    @property
    def certificates(self) -> Counts: ...
    @property
    def links(self) -> Words: ...
    @property
    def clear(self) -> Words: ...

class Sources(Protocol):
    """Food sources whose links are to be recomputed."""

    @property
    def row(self) -> Counts: ...
    @property
    def placed(self) -> Placed: ...
    @property
    def changed(self) -> Flags: ...
    @property
    def same_position(self) -> Flags: ...
    @property
    def links(self) -> Words: ...
    @property
    def clear(self) -> Words: ...

class Grid:
    """A region as rows of bits, 64 cuboids along x, with a margin; it does not change."""

    def __init__(
        self, x: Array, y: Array, z: Array, included: Words, edge: Sequence[float], weight: Array, weighted: Words
    ) -> None:
        """Centres (nx,), (ny,), (nz,); included (rows,); edge (3,); weight (levels,); weighted (levels, rows)."""
    @property
    def rows(self) -> int:
        """How many rows of bits it has, those of the margin too."""
    @property
    def chunks(self) -> int:
        """How many rows there are along x."""
    @property
    def shape(self) -> tuple[int, int, int]:
        """The cuboids along each axis."""

class TrialEvaluator:
    """Evaluates trials. Not for several threads at once."""

    def __init__(self, grid: Grid, cases: Flags, certificates: int) -> None:
        """For rigs in a grid, with the LiDARs of each of the cases (cases, lidars)."""
    def evaluate_batch(
        self, counter: Counts, most: int, batch: Batch, in_full: bool, result: BatchResult
    ) -> tuple[int, int, int]:
        """Evaluate the next trials, at most so many, that a counter (1,) has, and write what becomes of them.

        Returns how many cases were evaluated in full, how many rows were compared with cones for other trials, and how
        many segments were cast.
        """
    def recompute_links(self, counter: Counts, most: int, sources: Sources) -> None:
        """Compute the links of changed LiDARs of the next food sources of a counter (1,), at most so many."""

def beam_gaps(points: Array, cones: Array) -> Counts:
    """(N, lidars) the beam gap index of points (N, 3) for each LiDAR of cones (lidars, 6 + beams)."""

def seen(grid: Grid, cones: Array, sight: Sight) -> Words:
    """(lidars, rows) which cuboids each LiDAR sees."""

def links(grid: Grid, cones: Array, seen: Words, out: Words) -> None:
    """Write to out (rows, 3) the links by LiDARs that see seen (lidars, rows), or everything: (0, rows)."""

def label_components(grid: Grid, links: Words, label: Labels) -> tuple[Counts, Counts, Counts]:
    """Write the number of each cuboid's subspace under links (rows, 3) to label (nx, ny, nz), −1 where excluded.

    Returns cuboids (n,) in each, internal faces (n, 3) of each across x, y and z, and the first cuboid (n,) of each.
    """

def promote_certificates(certificates: Counts, source: Counts, refuted_by: Counts) -> None:
    """Move what refuted trials (n,), in their order, to the front of their sources' certificates (sources, c).

    Where refuted_by is −1, no certificate has, and source does not matter.
    """

def detected_positions(
    labels: Labels, size: tuple[int, int, int], threshold: int, layers: int, misses: int, held: Flags
) -> tuple[Counts, Counts]:
    """At how many places (mx, my) a box of cuboids touches more than `threshold` subspaces; how many places there are.

    labels (nx, ny, nz), −1 where excluded; the box's lowest layer is one of the first `layers`. Ends after so many
    misses. held (n,) is set for subspaces that a box lies in, if it is not empty.
    """

def detected_boxes(
    labels: Labels, low: Vector, edge: Vector, boxes: Array, size: Vector, threshold: int
) -> tuple[int, int]:
    """How many boxes (n, 4: centre x, y, bottom, heading) touch more than `threshold` subspaces; how many are free."""
