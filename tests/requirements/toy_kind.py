"""A kind of requirement that the package does not have: sensors stand apart from each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from lidarcfg.requirements.judge import PlainRequirement
from lidarcfg.requirements.kind import Context, Entry, Kind
from lidarcfg.requirements.verdict import RequirementVerdict, WorstPlace
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.sensors.rig import Mount


class ApartKind(Kind):
    """No two sensors are nearer to each other than a distance."""

    key: ClassVar[str] = "apart_at_least_m"
    apart_at_least_m: Annotated[float, Field(gt=0, le=100, description="the distance of any two sensors, at least")]

    def resolve(self, entry: Entry, context: Context) -> "ApartRequirement":
        if context.sensors == 1:
            raise entry.error("needs two sensors, and the study has one", self.key)
        return ApartRequirement(self.name, self.apart_at_least_m)


@dataclass(frozen=True)
class ApartRequirement(PlainRequirement):
    """Sensors stand at least this far apart."""

    name: str
    least_m: float

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        pairs = list(combinations([np.array(mount.position_m) for mount in mounts], 2))
        apart_m = [float(np.linalg.norm(one - other)) for one, other in pairs]
        nearest = int(np.argmin(apart_m))
        x, y, _ = np.mean(pairs[nearest], axis=0).tolist()
        return RequirementVerdict(
            name=self.name,
            kind=ApartKind.key,
            passed=apart_m[nearest] >= self.least_m,
            unit="m",
            demanded=self.least_m,
            reached=apart_m[nearest],
            at_most=False,
            shortfall=max(1 - apart_m[nearest] / self.least_m, 0.0),
            worst=WorstPlace(x, y),
        )
