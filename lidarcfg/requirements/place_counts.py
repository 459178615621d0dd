"""What an object reaches at places, by what each sensor gets there."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.returns.counts import Lowest

LOWEST = 256  # places, around which others are tried

Counts = NDArray[np.int64]


@dataclass(frozen=True)
class PlaceCounts:
    """What an object reaches at N positions of the base grid, each at its worst heading."""

    at_m: Array  # (N, 2)
    values: Counts  # (N,) in the worst case; lower bounds from the cap on
    side_m: Array  # (N,) of squares that cover the zone; the largest come first, as they lie below the others
    demanded: int
    cap: int


@dataclass(frozen=True)
class Measured:
    """The returns at P places that count, in the worst phases, with the sensors lost whose loss is the worst."""

    places: Array  # (P, 4)
    values: Counts  # (P,) exact where below the cap
    lowest: Lowest  # each sensor's counts; for clusters no counts

    def joined(self, other: "Measured") -> "Measured":
        """These and the measurements at other places."""
        return Measured(
            np.concatenate([self.places, other.places]),
            np.concatenate([self.values, other.values]),
            Lowest(
                np.concatenate([self.lowest.counts, other.lowest.counts]),
                np.concatenate([self.lowest.phases, other.lowest.phases]),
            ),
        )

    def lost(self, at: int, count: int, clusters: bool) -> list[int]:
        """The sensors, `count` of them, that are lost in the worst case at a place."""
        if clusters:
            return np.flatnonzero(self.lowest.phases[at] < 0).tolist()
        counts = self.lowest.counts[at]
        gone = np.argsort(-counts, kind="stable")[:count]
        return sorted(gone[counts[gone] > 0].tolist())  # to lose one that sees nothing changes nothing


def reached(counts: NDArray[np.int32], lost: int, sensors: int | None) -> Counts:
    """(P,) the sum of counts (P, S) without the `lost` largest; or, of those left, the `sensors`-th largest."""
    ordered = -np.sort(-np.maximum(counts, 0).astype(np.int64), axis=1)
    if sensors is None:
        return np.asarray(ordered[:, lost:].sum(axis=1))
    return ordered[:, lost + sensors - 1] if lost + sensors <= counts.shape[1] else np.zeros(len(counts), np.int64)


def positions(places: Array, values: Counts) -> tuple[NDArray[np.intp], Counts]:
    """(n,) each: the place of the lowest value at each position, over headings, and that value."""
    order = np.lexsort((values, places[:, 1], places[:, 0]))
    at = places[order, :2]
    first = np.ones(len(at), np.bool_)
    first[1:] = (at[1:] != at[:-1]).any(axis=1)
    return order[first], values[order[first]]


def lowest_of(values: Counts, most: int = LOWEST) -> NDArray[np.intp]:
    """The numbers of the lowest values."""
    count = min(most, len(values))
    return np.argpartition(values, count - 1)[:count] if count else np.empty(0, np.intp)
