from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarcfg.core.visibility import Obstacles
from lidarcfg.core.world import Bvh

Array = NDArray[np.float64]

class Scanner:
    """A sensor's firing pattern, whatever its pose: H heads of all phases, F firings a cycle; it does not change."""

    def __init__(
        self,
        cos_head: Array,
        sin_head: Array,
        start_rad: float,
        step_rad: float,
        phases: int,
        lag_rad: Array,
        gating_rad: Array,
        offset_rad: Array,
        elevation_rad: Array,
        start_m: Array,
        phase: NDArray[np.int32],
        range_m: Sequence[float] | Array,
        fov_rad: Sequence[float] | Array,
    ) -> None:
        """Heads (H,) when cycles start; angles and start_m (F, 3) of firings; ranges; field of view.

        With a step of 0 heads stand still: there is one a phase, and `phase` (F,) says which each firing is of.
        """
    @property
    def phases(self) -> int:
        """Head n is of phase n % phases."""

class TargetShape:
    """An object in its own frame; it does not change."""

    def __init__(self, bvh: Bvh, low_m: ArrayLike, high_m: ArrayLike) -> None:
        """Its hierarchy and the corners (3,) of its bounding box."""

class KnownReturns:
    """The returns from objects at their places, of sensors at poses, rig after rig; threads share what each has found.

    A rig is S sensors, each of a scanner by number, at R (S, 3, 3), t (S, 3).
    """

    def __init__(
        self,
        scanners: Sequence[Scanner],
        objects: Sequence[TargetShape],
        places: Array,
        ends: NDArray[np.int64],
        obstacles: Obstacles,
    ) -> None:
        """Objects at places (P, 4), those of one after those of the other, which end at ends (objects,)."""
    def misses(
        self, scanners: NDArray[np.int64], R: Array, t: Array, weights: Array, enough: int, most: float
    ) -> float:
        """The weighted mean over objects of the share of places with fewer than `enough` returns.

        By the mean over phases; or, as soon as it is known to be at least `most`, any number that is.
        """
    def missed(self, scanners: NDArray[np.int64], R: Array, t: Array, object: int, enough: int, most: float) -> float:
        """In how many of its places an object is missed, by the mean over phases; or any number from `most` on."""
    def missed_among(
        self, scanners: NDArray[np.int64], R: Array, t: Array, object: int, enough: int, count: int
    ) -> float:
        """The same among so many of these places, the likeliest to be missed: no more than `missed`."""
    def probabilities(
        self,
        scanners: NDArray[np.int64],
        R: Array,
        t: Array,
        object: int,
        which: NDArray[np.int64],
        enough: int,
        missed: Array,
    ) -> None:
        """Write to missed (N,) how likely an object is missed at some, which (N,), of its places."""
    def lowest(
        self,
        scanners: NDArray[np.int64],
        R: Array,
        t: Array,
        object: int,
        which: NDArray[np.int64],
        cap: int,
        wanted: int,
        counts: NDArray[np.int32],
        phases: NDArray[np.int8],
    ) -> None:
        """Write the returns (N, S) in each sensor's worst phase at some places, at most `cap`, and that phase.

        At each place the nearest sensors come first; once `wanted` of them have `cap` the others are unknown: -1.
        """
    @property
    def memory_bytes(self) -> int:
        """What is known of sensors at poses takes no more memory."""
    @property
    def traced(self) -> int:
        """How many pairs of sensor and place were traced so far."""

def count_returns(
    places: Array,
    which: NDArray[np.int64],
    scanners: Sequence[Scanner],
    R: Array,
    t: Array,
    target: TargetShape,
    obstacles: Obstacles,
    counts: NDArray[np.int32],
) -> None:
    """Write to counts (P, S, phases) the returns from an object at some, which (N,), of places (P, 4)."""

def count_clusters(
    places: Array,
    which: NDArray[np.int64],
    scanners: Sequence[Scanner],
    R: Array,
    t: Array,
    target: TargetShape,
    obstacles: Obstacles,
    tolerance_m: float,
    above_m: float,
    lost: int,
    sensors: int,
    joint: bool,
    cap: int,
    counts: NDArray[np.int32],
    phases: NDArray[np.int8],
) -> None:
    """Write the points (P,) of the largest cluster in the worst case, and the phases (P, S) there; -1: lost.

    Neighbours in a cluster are within a tolerance, and one of its points is at least at the height `above_m`. With
    `lost` sensors gone; of all others together, or if `sensors` is not 0 of each of so many alone. Of all combinations
    of phases where `joint`, else with each sensor in that of its fewest returns. Values of `cap` or more are bounds.
    """

def largest_cluster(points: Array, tolerance_m: float, above_m: float) -> int:
    """The number of points of the largest cluster of points (N, 3) that has one at least at a height.

    Neighbours are within a tolerance: single linkage.
    """

def detection_probabilities(counts: NDArray[np.int32], phases: NDArray[np.int64], enough: int) -> Array:
    """(P,) the probability of at least so many returns of counts (P, S, phases), each sensor in any of its phases."""
