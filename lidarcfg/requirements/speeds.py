"""A scenario's verdict speed by speed: how far before the impact its target is seen, and up to which speed in time."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Literal

Cause = Literal["in_sight_too_late", "seen_too_late", "lost_track", "never_seen"]


@dataclass(frozen=True)
class SpeedVerdict:
    """Whether a target is seen in time to brake at one speed: the worst of the runs. Ways are along the path."""

    speed_km_h: float
    impact: float  # where on the front, as a fraction of the vehicle's width from its right side
    sight_m: float | None  # before the impact, from the best place within the sensors' bounds; None: never in sight
    seen_m: float | None  # before the impact; None: never
    seen_s: float | None
    needed_m: float
    needed_s: float
    margin_m: float  # seen less needed; never seen: as if at the impact
    margin_s: float
    lost: tuple[str, ...] = ()  # sensors that fail in that run
    cause: Cause | None = None  # of a failure
    why: str = ""  # in words

    @property
    def passed(self) -> bool:
        """Whether it is seen in time."""
        return self.margin_s >= 0.0

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "speed_km_h": self.speed_km_h,
            "impact": self.impact,
            "sight_m": self.sight_m,
            "seen_m": self.seen_m,
            "seen_s": self.seen_s,
            "needed_m": self.needed_m,
            "needed_s": self.needed_s,
            "margin_m": self.margin_m,
            "margin_s": self.margin_s,
            "pass": self.passed,
            "lost": list(self.lost),
            "cause": self.cause,
            "why": self.why,
        }


@dataclass(frozen=True)
class SpeedVerdicts:
    """The verdicts at all speeds that are tested."""

    tested: tuple[SpeedVerdict, ...]  # by speed

    @property
    def up_to_km_h(self) -> float | None:
        """The highest speed up to which it passes at all tested speeds; None: it fails at the lowest."""
        passed = list(takewhile(lambda one: one.passed, self.tested))
        return passed[-1].speed_km_h if passed else None

    @property
    def failed(self) -> tuple[SpeedVerdict, ...]:
        """Those at which it fails."""
        return tuple(one for one in self.tested if not one.passed)

    @property
    def text(self) -> str:
        """Up to which speed it passes, and where it fails or passes above."""
        lowest, highest = self.tested[0], self.tested[-1]
        passed = [one for one in self.tested if one.passed]
        if len(self.tested) == 1:
            return f"{'in time' if passed else 'too late'} at {lowest.speed_km_h:g} km/h, the only speed tested"
        whole = f"at all {len(self.tested)} speeds tested, {lowest.speed_km_h:g} to {highest.speed_km_h:g} km/h"
        if not passed:
            return f"too late {whole}"
        if len(passed) == len(self.tested):
            return f"in time {whole}"
        late = _listed(self.failed)
        if self.up_to_km_h is None:
            return f"too late at {late}, from the lowest speed tested on; in time at {_listed(passed)}"
        said = f"in time up to {self.up_to_km_h:g} km/h, too late at {late}"
        again = [one for one in passed if one.speed_km_h > self.up_to_km_h]
        return f"{said}, in time again at {_listed(again)}" if again else said

    def to_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        return {
            "in_time_up_to_km_h": self.up_to_km_h,
            "text": self.text,
            "tested": [one.to_dict() for one in self.tested],
        }


def _listed(some: Iterable[SpeedVerdict]) -> str:
    return ", ".join(f"{one.speed_km_h:g}" for one in some) + " km/h"
