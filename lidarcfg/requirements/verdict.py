"""The verdict: whether a rig meets its requirements, by how much, and where it comes closest to missing each."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from lidarcfg.notebook import Shown
from lidarcfg.requirements.speeds import SpeedVerdicts


@dataclass(frozen=True)
class WorstPlace:
    """Where a requirement is closest to being missed, in the vehicle frame."""

    x_m: float
    y_m: float
    heading_deg: float | None = None  # of an object
    distance_m: float | None = None  # from the body; None without one

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        values = {
            "x_m": self.x_m,
            "y_m": self.y_m,
            "heading_deg": self.heading_deg,
            "distance_m": self.distance_m,
        }
        return {key: value for key, value in values.items() if value is not None}


@dataclass(frozen=True)
class Sampling:
    """How closely a requirement was looked at; nothing is known of what lies between."""

    places: int  # tried: positions times headings
    base_m: tuple[float, float]  # spacing of the base grid near the body, and farther out
    finest_m: float  # spacing around the lowest counts; that of the grid where nothing is refined
    finest_deg: float | None = None  # of headings there
    azimuths_deg: float | None = None  # between lines from the vehicle along which the places lie, if they do
    shadows: bool = False  # whether places in the middle of the bodies' narrow shadows are among them

    @property
    def text(self) -> str:
        """A sentence on what sampling cannot exclude."""
        near, far = (f"{step:.3g}" for step in self.base_m)
        base = f"{near} m apart near the body, {far} m farther out" if near != far else f"{near} m apart"
        if self.azimuths_deg:
            base += f" along azimuths {self.azimuths_deg:.3g}° apart"
        shadows = ", and in the middle of narrow shadows" if self.shadows else ""
        if self.base_m == (self.finest_m, self.finest_m):
            return f"{self.places:,} places, {base}{shadows}; nothing is known of what lies between"
        turn = "" if not self.finest_deg else f" and {self.finest_deg:.3g}°"
        what = f"{self.places:,} places, {base}, {self.finest_m:.3g} m{turn} around the lowest counts{shadows}"
        return f"{what}; between them lower counts cannot be excluded"

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "places": self.places,
            "near_spacing_m": self.base_m[0],
            "far_spacing_m": self.base_m[1],
            "finest_m": self.finest_m,
            **({} if self.finest_deg is None else {"finest_deg": self.finest_deg}),
            **({} if self.azimuths_deg is None else {"azimuths_deg": self.azimuths_deg}),
            "text": self.text,
        }


@dataclass(frozen=True)
class RequirementVerdict:
    """Whether a rig meets a requirement."""

    name: str
    kind: str  # its key in KINDS
    passed: bool
    unit: str  # of the figures: returns, m, m³, s, or empty
    demanded: float
    reached: float  # in the worst case; inf: never
    at_most: bool  # whether `demanded` is the most that is allowed, not the least
    shortfall: float  # 0 if it is met, else how much is missing, as a fraction of what is demanded
    worst: WorstPlace | None = None
    phases: tuple[int, ...] | None = None  # of each sensor, at the worst place: quarters of the step between firings
    lost: tuple[str, ...] = ()  # sensors that fail in the worst case
    breaking: tuple[str, ...] = ()  # sensors whose failure, each alone, breaks the requirement
    fraction: float | None = None  # of places at which the demand is met, where a fraction is asked for
    sampling: Sampling | None = None
    speeds: SpeedVerdicts | None = None  # of a scenario
    notes: tuple[str, ...] = ()
    not_achievable: str | None = None  # why no rig within the bounds can meet it

    @property
    def margin(self) -> float:
        """By how much it is met, in its unit; below 0 if it is not."""
        return self.demanded - self.reached if self.at_most else self.reached - self.demanded

    @property
    def relative_margin(self) -> float:
        """The margin as a fraction of what is demanded."""
        return self.margin / self.demanded if self.demanded else self.margin

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        values = {
            "name": self.name,
            "kind": self.kind,
            "pass": self.passed,
            "unit": self.unit,
            "demanded": self.demanded,
            "at_most": self.at_most,
            "reached": _finite(self.reached),
            "margin": _finite(self.margin),
            "shortfall": _finite(self.shortfall),
            "worst": self.worst and self.worst.to_dict(),
            "phases": self.phases and list(self.phases),
            "lost": list(self.lost),
            "breaking": list(self.breaking),
            "fraction": self.fraction,
            "sampling": self.sampling and self.sampling.to_dict(),
            "speeds": self.speeds and self.speeds.to_dict(),
            "notes": list(self.notes),
            "not_achievable": self.not_achievable,
        }
        return {key: value for key, value in values.items() if value is not None}


def at_most(name: str, kind: str, most: float, reached: float, unit: str = "") -> RequirementVerdict:
    """The verdict by a limit of one number, whatever the places."""
    return RequirementVerdict(
        name=name,
        kind=kind,
        passed=reached <= most,
        unit=unit,
        demanded=most,
        reached=reached,
        at_most=True,
        shortfall=max(reached / most - 1, 0.0),
    )


@dataclass(frozen=True)
class Verdict(Shown):
    """Whether a rig meets all requirements of a study."""

    requirements: tuple[RequirementVerdict, ...]

    def __repr__(self) -> str:
        met = sum(one.passed for one in self.requirements)
        return f"<Verdict {'PASS' if self.passed else 'FAIL'}: {met} of {len(self.requirements)} requirements are met>"

    @property
    def passed(self) -> bool:
        """Whether all are met."""
        return all(one.passed for one in self.requirements)

    @property
    def shortfall(self) -> float:
        """The sum of all shortfalls; 0 if all are met."""
        return sum(one.shortfall for one in self.requirements)

    @property
    def least_margin(self) -> float:
        """The least relative margin."""
        return min((one.relative_margin for one in self.requirements), default=math.inf)

    def explained(self, why: Mapping[str, str]) -> "Verdict":
        """The verdict with why no rig can meet some requirements, by name, where these are not met."""
        out = [one if one.passed else replace(one, not_achievable=why.get(one.name)) for one in self.requirements]
        return Verdict(tuple(out))

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "pass": self.passed,
            "shortfall": _finite(self.shortfall),
            "requirements": [one.to_dict() for one in self.requirements],
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
