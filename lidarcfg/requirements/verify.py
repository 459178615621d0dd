"""Verifies rigs: judges each requirement of a study in turn, and collects the evidence.

Evidence shows a verdict: the counts on a map around the vehicle, and the worst place as each sensor sees it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.judges import judges
from lidarcfg.requirements.margins import MountMargins
from lidarcfg.requirements.objects import CAP_MAX, ObjectJudge, ObjectRequirement, PlaceCounts
from lidarcfg.requirements.posts import PostJudge, PostRequirement, PostVisibility
from lidarcfg.requirements.prices import PriceRequirement, SensorsRequirement
from lidarcfg.requirements.requirements import Requirements
from lidarcfg.requirements.scenario_requirement import ScenarioRequirement
from lidarcfg.requirements.scenario_run import ScenarioResult
from lidarcfg.requirements.shadow import STEP_M as SHADOW_STEP_M
from lidarcfg.requirements.shadow import ShadowJudge, ShadowRequirement
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from lidarcfg.returns.beams import PassingBeams, passing_beams
from lidarcfg.returns.known import lowest_at
from lidarcfg.returns.places import Zone
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.footprint import Footprint

OnProgress = Callable[[float, str], None]


def silent(fraction: float, name: str) -> None:
    """Ignore progress."""


class Verifier:
    """Verifies rigs, one after the other; counts are kept, so that only sensors that moved are cast again."""

    def __init__(self, requirements: Requirements) -> None:
        self.requirements = requirements
        self.judges, _ = judges(requirements)

    def check(self, mounts: Sequence[Mount]) -> None:
        """Raises ConfigError if a requirement loses all of a rig's mounts, or needs a price that one has not."""
        for item in self.requirements.items:
            if isinstance(item, PriceRequirement):
                item.price(mounts)
            elif not isinstance(item, SensorsRequirement) and item.lost >= len(mounts):
                what = f"{item.lost} of the rig's {len(mounts)} sensors lost leave none"
                raise ConfigError(f"{item.name}: {what}; allowed: at most {len(mounts) - 1}")

    def verify(self, mounts: Sequence[Mount], on_progress: OnProgress = silent) -> Verdict:
        """The verdict on a rig's mounts; `on_progress` is told the fraction done, and the requirement that is judged.

        Raises ConfigError as `check` does, and for sensors that cannot be simulated.
        """
        self.check(mounts)
        work = [judge.work for judge in self.judges]
        done = 0
        out = []
        for judge, item in zip(self.judges, self.requirements.items, strict=True):
            on_progress(done / sum(work), item.name)
            begun = done

            def on_places(count: int, name: str = item.name, most: int = begun + judge.work) -> None:
                nonlocal done
                done = min(done + count, most)
                on_progress(done / sum(work), name)

            out.append(judge.judge(mounts, on_places))
            done = begun + judge.work
        return Verdict(tuple(out))


@dataclass(frozen=True)
class HiddenColumns:
    """The height that the bodies hide from all sensors above N points of the ground."""

    at_m: Array  # (N, 2)
    height_m: Array  # (N,) that is hidden
    side_m: float  # between points


@dataclass(frozen=True)
class SensorView:
    """The object at the worst place as a sensor sees it, in the phase of its fewest returns."""

    name: str
    lost: bool  # in the worst case of failure
    beams: PassingBeams


@dataclass(frozen=True)
class Evidence:
    """The evidence for the verdict on a requirement; parts that its kind does not have are None."""

    verdict: RequirementVerdict
    body: Footprint | None
    zone: Zone | None = None
    counts: PlaceCounts | None = None
    posts: PostVisibility | None = None
    hidden: HiddenColumns | None = None
    scenario: ScenarioResult | None = None
    views: tuple[SensorView, ...] = ()
    margins: tuple[MountMargins, ...] = ()  # of each of its limits

    @property
    def has_map(self) -> bool:
        """Whether there is anything to draw from above."""
        return bool(self.counts or self.posts or self.hidden)


@dataclass(frozen=True)
class Verification:
    """A verdict on a rig, and the evidence for it."""

    verdict: Verdict
    evidence: tuple[Evidence, ...]  # of each requirement


def verification(verifier: Verifier, mounts: Sequence[Mount], on_progress: OnProgress = silent) -> Verification:
    """The verdict on a rig's mounts, with the evidence. Raises ConfigError as `Verifier.verify` does."""
    verdict = verifier.verify(mounts, on_progress)
    return Verification(verdict, evidence(verifier, mounts, verdict))


def evidence(verifier: Verifier, mounts: Sequence[Mount], found: Verdict) -> tuple[Evidence, ...]:
    """The evidence for each requirement of a verifier's verdict on mounts, without mounting errors."""
    body = verifier.requirements.site.body
    out = []
    for judge, one in zip(verifier.judges, found.requirements, strict=True):
        if isinstance(judge, ObjectJudge):
            stand = judge.item.stand
            out.append(
                Evidence(
                    one,
                    body,
                    zone=stand.zone,
                    counts=judge.counts(mounts),
                    views=_views(verifier, judge.item, mounts, one),
                    margins=(judge.margins(mounts),),
                )
            )
        elif isinstance(judge, PostJudge):
            out.append(
                Evidence(
                    one,
                    body,
                    posts=judge.visibility(mounts),
                    views=_views(verifier, judge.item, mounts, one),
                    margins=judge.margins(mounts),
                )
            )
        elif isinstance(judge, ShadowJudge):
            item = judge.item
            out.append(Evidence(one, body, hidden=_hidden(item, mounts), margins=(item.margins(mounts),)))
        elif isinstance(judge.item, ScenarioRequirement):
            out.append(Evidence(one, body, scenario=judge.item.check(mounts).result))
        else:
            out.append(Evidence(one, body))
    return tuple(out)


def _views(
    verifier: Verifier,
    item: ObjectRequirement | PostRequirement,
    mounts: Sequence[Mount],
    one: RequirementVerdict,
) -> tuple[SensorView, ...]:
    """The worst place as each sensor sees it."""
    if one.worst is None:
        return ()
    site = verifier.requirements.site
    target = item.target
    place = np.array([one.worst.x_m, one.worst.y_m, site.ground_m, np.radians(one.worst.heading_deg or 0.0)])
    if isinstance(item, ObjectRequirement) and item.cluster_m is not None and one.phases is not None:
        phases = one.phases
    else:
        lowest = lowest_at(place[None], target, mounts, site.obstacles, CAP_MAX, len(mounts) + 1)
        phases = tuple(lowest.phases[0].tolist())
    return tuple(
        SensorView(mount.name, mount.name in one.lost, passing_beams(place, target, mount, phase, site.obstacles))
        for mount, phase in zip(mounts, phases, strict=True)
    )


def _hidden(item: ShadowRequirement, mounts: Sequence[Mount]) -> HiddenColumns:
    """The hidden height above each point of the ground."""
    points = item.points_m
    at, column = np.unique(points[:, :2], axis=0, return_inverse=True)
    height_m = np.bincount(column.ravel(), item.hidden(mounts), len(at)) * item.layer_m
    return HiddenColumns(at, np.asarray(height_m), SHADOW_STEP_M)
