"""The evidence for a verdict: a map around the vehicle, the worst place as each sensor sees it, margins, frames."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.requirements.robustness import misplaced
from lidarcfg.requirements.scenarios.run import ScenarioResult
from lidarcfg.requirements.verdict import RequirementVerdict
from lidarcfg.returns.beams import PassingBeams, passing_beams
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.places import StandZone
from lidarcfg.returns.target import Target
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import Obstacles

OFF_M = 0.05  # of one coordinate of a mount
OFF_RAD = math.radians(0.5)
VIEW_CAP = 1 << 23  # returns of a sensor; more than any has


class Mapped(Protocol):
    """What a map shows from above; a report has a drawing of each type."""

    @property
    def at_m(self) -> Array:
        """(N, 2) where there is something to see."""


@dataclass(frozen=True)
class SensorView:
    """The object at the worst place as a sensor sees it, in the phase of its fewest returns."""

    name: str
    lost: bool  # in the worst case of failure
    beams: PassingBeams


@dataclass(frozen=True)
class MountMargins:
    """What a requirement reaches with one sensor lost, and with one coordinate of one mount off."""

    what: str  # is reached
    unit: str  # as a verdict has it
    demanded: float
    at_most: bool  # whether `demanded` is the most that is allowed, not the least
    whole: float  # with all mounts in place; inf: never, as below
    without: Array  # (mounts,) NaN: no sensor is left
    off: Array  # (mounts, 6) the worse of both ways
    where_lost: str = ""  # the places that `without` is of, if not of all
    where_off: str = ""  # and those of `off`
    cap: float = math.inf  # from which on values are lower bounds

    def meets(self, value: float) -> bool:
        """Whether a value is enough; NaN is not too little."""
        return not (value > self.demanded + 1e-9 if self.at_most else value < self.demanded)


@dataclass(frozen=True)
class Evidence:
    """The evidence for the verdict on a requirement; it has the parts that its kind has."""

    verdict: RequirementVerdict
    body: Footprint | None = None
    zone: StandZone | None = None
    map: Mapped | None = None
    frames: ScenarioResult | None = None  # what is seen in each
    views: tuple[SensorView, ...] = ()
    margins: tuple[MountMargins, ...] = ()  # of each of its limits


def sensor_views(
    found: RequirementVerdict,
    target: Target,
    ground_m: float,
    mounts: Sequence[Mount],
    obstacles: Obstacles,
    phases: Sequence[int] | None = None,
) -> tuple[SensorView, ...]:
    """The object at a verdict's worst place as each sensor sees it, in the phase of its fewest returns or in others."""
    if found.worst is None:
        return ()
    place = np.array([found.worst.x_m, found.worst.y_m, ground_m, np.radians(found.worst.heading_deg or 0.0)])
    if phases is None:
        phases = lowest_at(place[None], target, mounts, obstacles, VIEW_CAP, len(mounts) + 1).phases[0].tolist()
    return tuple(
        SensorView(mount.name, mount.name in found.lost, passing_beams(place, target, mount, phase, obstacles))
        for mount, phase in zip(mounts, phases, strict=True)
    )


def with_one_off(mounts: Sequence[Mount]) -> Iterator[tuple[int, int, tuple[Mount, ...]]]:
    """The rig with one coordinate of one mount off, either way, and the numbers of the mount and the coordinate."""
    for number, axis, way in product(range(len(mounts)), range(6), (-1, 1)):
        errors = np.zeros((len(mounts), 6))
        errors[number, axis] = way * (OFF_M if axis < 3 else OFF_RAD)
        yield number, axis, misplaced(mounts, errors)
