from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray

import lidarcfg.core.world

class Scanner:
    """
    A sensor's firing pattern, whatever its pose: H heads of all phases, F firings a cycle; it does not change.
    """

    def __init__(
        self,
        cos_head: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        sin_head: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        start_rad: float,
        step_rad: float,
        phases: int,
        lag_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        gating_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        offset_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        elevation_rad: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        start_m: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        phase: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
        range_m: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(2))],
        fov_rad: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(2))],
    ) -> None:
        """
        Heads (H,) when cycles start; angles and start_m (F, 3) of firings; ranges; field of view.

        With a step of 0 heads stand still: there is one a phase, and `phase` (F,) says which each firing is of.
        """

    @property
    def phases(self) -> int:
        """Head n is of phase n % phases."""

class TargetShape:
    """An object in its own frame; it does not change."""

    def __init__(
        self,
        bvh: lidarcfg.core.world.Bvh,
        low_m: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
        high_m: Sequence[float] | Annotated[NDArray[numpy.float64], dict(shape=(3))],
    ) -> None:
        """Its hierarchy and the corners (3,) of its bounding box."""

class KnownReturns:
    """
    The returns from objects at their places, of sensors at poses, rig after rig; threads share what each has found.

    A rig is S sensors, each of a scanner by number, at R (S, 3, 3), t (S, 3).
    """

    def __init__(
        self,
        scanners: Sequence[Scanner],
        objects: Sequence[TargetShape],
        places: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
        ends: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        obstacles: lidarcfg.core.world.Obstacles,
    ) -> None:
        """
        Objects at places (P, 4), those of one after those of the other, which end at ends (objects,).
        """

    def misses(
        self,
        scanners: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
        t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        weights: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
        enough: int,
        most: float,
    ) -> float:
        """
        The weighted mean over objects of the share of places with fewer than `enough` returns.

        By the mean over phases; or, as soon as it is known to be at least `most`, any number that is.
        """

    def missed(
        self,
        scanners: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
        t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        object: int,
        enough: int,
        most: float,
    ) -> float:
        """
        In how many of its places an object is missed, by the mean over phases; or any number from `most` on.
        """

    def missed_among(
        self,
        scanners: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
        t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        object: int,
        enough: int,
        count: int,
    ) -> float:
        """
        The same among so many of these places, the likeliest to be missed: no more than `missed`.
        """

    def probabilities(
        self,
        scanners: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
        t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        object: int,
        which: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        enough: int,
        missed: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    ) -> None:
        """
        Write to missed (N,) how likely an object is missed at some, which (N,), of its places.
        """

    def lowest(
        self,
        scanners: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
        t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
        object: int,
        which: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
        cap: int,
        wanted: int,
        counts: Annotated[NDArray[numpy.int32], dict(shape=(None, None))],
        phases: Annotated[NDArray[numpy.int8], dict(shape=(None, None))],
    ) -> None:
        """
        Write the returns (N, S) in each sensor's worst phase at some places, at most `cap`, and that phase.

        At each place the nearest sensors come first; once `wanted` of them have `cap` the others are unknown: -1.
        """

    @property
    def memory_bytes(self) -> int:
        """What is known of sensors at poses takes no more memory."""

    @property
    def traced(self) -> int:
        """How many pairs of sensor and place were traced so far."""

def count_returns(
    places: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
    which: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    scanners: Sequence[Scanner],
    R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
    t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    target: TargetShape,
    obstacles: lidarcfg.core.world.Obstacles,
    counts: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
) -> None:
    """
    Write to counts (P, S, phases) the returns from an object at some, which (N,), of places (P, 4).
    """

def count_clusters(
    places: Annotated[NDArray[numpy.float64], dict(shape=(None, 4))],
    which: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    scanners: Sequence[Scanner],
    R: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
    t: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    target: TargetShape,
    obstacles: lidarcfg.core.world.Obstacles,
    tolerance_m: float,
    above_m: float,
    lost: int,
    sensors: int,
    joint: bool,
    cap: int,
    counts: Annotated[NDArray[numpy.int32], dict(shape=(None,))],
    phases: Annotated[NDArray[numpy.int8], dict(shape=(None, None))],
) -> None:
    """
    Write the points (P,) of the largest cluster in the worst case, and the phases (P, S) there; -1: lost.

    Neighbours in a cluster are within a tolerance, and one of its points is at least at the height `above_m`.
    With `lost` sensors gone; of all others together, or if `sensors` is not 0 of each of so many alone. Of all
    combinations of phases where `joint`, else with each sensor in that of its fewest returns. Values of `cap` or
    more are bounds.
    """

def largest_cluster(
    points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))], tolerance_m: float, above_m: float
) -> int:
    """
    The number of points of the largest cluster of points (N, 3) that has one at least at a height.

    Neighbours are within a tolerance: single linkage.
    """

def detection_probabilities(
    counts: Annotated[NDArray[numpy.int32], dict(shape=(None, None, None))],
    phases: Annotated[NDArray[numpy.int64], dict(shape=(None,))],
    enough: int,
) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
    """
    (P,) the probability of at least so many returns of counts (P, S, phases), each sensor in any of its phases.
    """
