"""Scenarios: a moving target is detected in time to brake."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, PlainSerializer, SerializationInfo

from lidarcfg.config.models import path_from
from lidarcfg.errors import ConfigError
from lidarcfg.requirements.allowed_rigs import Bounds
from lidarcfg.requirements.evidence import Evidence
from lidarcfg.requirements.judge import Judge, Requirement
from lidarcfg.requirements.kind import Clusters, Context, Entry, Kind, Lost, Returns
from lidarcfg.requirements.scenarios.approach import EMERGENCY, Braking, BrakingOrName, VehicleExtent, approach_of
from lidarcfg.requirements.scenarios.file import Scenario, Speeds, load_scenario, scenario_of
from lidarcfg.requirements.scenarios.run import (
    NO_SPEEDS,
    RETURNS,
    Rule,
    ScenarioCase,
    ScenarioResult,
    check_scenario,
)
from lidarcfg.requirements.speeds import Cause, SpeedVerdict, SpeedVerdicts
from lidarcfg.requirements.verdict import RequirementVerdict, WorstPlace
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.returns.known import Share
from lidarcfg.returns.target import ObjectOrName
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.vehicle import Vehicle

KEPT = 2  # rigs: one, and that which it is compared with
PLACES_PER_CASE = 2000  # whose returns take about as long to count as the runs at a speed and an impact


def _scenario_from(name: str, info: SerializationInfo) -> str:
    """A preset's name as it is, or the path of a file as of all that files name."""
    return path_from(name, info) if Path(name).suffix else name


class ScenarioKind(Kind):
    """A moving target is seen in time to brake."""

    key: ClassVar[str] = "scenario"
    scenario: Annotated[
        str,
        Field(min_length=1, description="a preset's name, or the file of a scenario"),
        PlainSerializer(_scenario_from),
    ]
    speeds_km_h: Annotated[
        Speeds | None, Field(description="of the vehicle; by default as the scenario's file says")
    ] = None
    target: Annotated[ObjectOrName | None, Field(description="an object that takes the place of the scenario's")] = None
    braking: Annotated[
        BrakingOrName | None, Field(description="`emergency`, `comfort`, or keys and values; `emergency` by default")
    ] = None
    returns: Annotated[Returns | None, Field(description="of the target in a frame; 10 by default")] = None
    cluster_m: Clusters = None
    lost: Lost = None

    def resolve(self, entry: Entry, context: Context) -> "ScenarioRequirement":
        """The requirement of a study. Raises ConfigError with file, line and key."""
        lost = entry.lost(self.lost, context)
        site = context.site
        vehicle, _ = entry.vehicle(site)
        folder = entry.path.parent
        with entry.errors_at("scenario"):
            scenario = load_scenario(self.scenario, folder)
            speeds_km_h = self.speeds_km_h or scenario.file.speeds_km_h
            if not speeds_km_h:
                raise ConfigError(f"{scenario.name}: {NO_SPEEDS}")
        if self.target:
            with entry.errors_at("target"):
                scenario = scenario_of(scenario.file, self.target, folder)
        braking = self.braking or EMERGENCY
        extent = VehicleExtent.of(vehicle)
        with entry.errors_at("speeds_km_h" if self.speeds_km_h else "scenario"):
            for speed_km_h, impact in product(speeds_km_h, scenario.file.impacts):
                approach_of(scenario, extent, speed_km_h, impact, site.ground_m, braking)
        return ScenarioRequirement(
            name=self.name,
            scenario=scenario,
            vehicle=vehicle,
            speeds_km_h=speeds_km_h,
            rule=Rule(self.returns or RETURNS, self.cluster_m),
            braking=braking,
            lost=lost,
            sensor_bounds=site.bounds,
            ground_m=site.ground_m,
        )


@dataclass(frozen=True)
class ScenarioRequirement(Requirement):
    """A scenario's target is detected in time to brake at all speeds."""

    name: str
    scenario: Scenario
    vehicle: Vehicle
    speeds_km_h: tuple[float, ...]
    rule: Rule
    braking: Braking = EMERGENCY
    lost: int = 0  # sensors that fail
    sensor_bounds: Bounds | None = None  # for the earliest line of sight; None: where they are
    ground_m: float = 0.0

    def judge_with(self, share: Share | None = None) -> "ScenarioJudge":
        """A judge."""
        return ScenarioJudge(self)

    def result(self, mounts: Sequence[Mount]) -> ScenarioResult:
        """The runs of a rig with as many sensors lost as the requirement says, and with all sensors."""
        return self.tried(mounts).with_lost(0, self.lost)

    def tried(
        self, mounts: Sequence[Mount], on_progress: Callable[[float], None] = lambda fraction: None
    ) -> ScenarioResult:
        """The runs of a rig, also with each single sensor lost, whether that is asked for or not."""
        return check_scenario(
            self.scenario,
            mounts,
            self.vehicle,
            speeds_km_h=self.speeds_km_h,
            rule=self.rule,
            braking=self.braking,
            losses=sorted({0, self.lost, min(1, len(mounts) - 1)}),
            bounds=self.sensor_bounds,
            ground_m=self.ground_m,
            on_progress=on_progress,
        )


class ScenarioJudge(Judge):
    """Judges rigs by a scenario; the runs of the last ones are kept for their evidence."""

    is_slow: ClassVar[bool] = True

    def __init__(self, requirement: ScenarioRequirement) -> None:
        self.requirement = requirement
        self._kept: deque[tuple[Sequence[Mount], ScenarioResult]] = deque(maxlen=KEPT)

    @property
    def work(self) -> int:
        """About the number of places that would take as long, for progress."""
        return PLACES_PER_CASE * len(self.requirement.speeds_km_h) * len(self.requirement.scenario.file.impacts)

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig, in seconds before the last moment to brake. Raises ConfigError."""
        done = 0

        def on_progress(fraction: float) -> None:
            nonlocal done
            now = round(fraction * self.work)
            on_places(now - done)
            done = now

        tried = self.requirement.tried(mounts, on_progress)
        self._kept.append((mounts, tried))
        found = tried.with_lost(0, self.requirement.lost)
        case = found.worst
        worst = case.worst
        return RequirementVerdict(
            name=self.requirement.name,
            kind=ScenarioKind.key,
            passed=found.met,
            unit="s",
            demanded=0.0,
            reached=worst.margin_s,
            at_most=False,
            shortfall=found.shortfall,
            worst=_place(case),
            lost=tuple(mounts[n].name for n in worst.lost),
            breaking=tuple(mount.name for n, mount in enumerate(mounts) if tried.fails_without(n)),
            speeds=by_speed(found),
            notes=_notes(found, case),
        )

    def evidence(self, mounts: Sequence[Mount], found: RequirementVerdict) -> Evidence:
        """The evidence for a verdict on a rig."""
        known = next((tried for kept, tried in self._kept if kept is mounts), None)
        tried = known or self.requirement.tried(mounts)
        return Evidence(found, frames=tried.with_lost(0, self.requirement.lost))


def _place(case: ScenarioCase) -> WorstPlace:
    """The target in the vehicle frame at the last moment to brake."""
    worst = case.worst
    x, y = (worst.approach.target_m(worst.last_s) - worst.approach.velocity_m_s * worst.last_s).tolist()
    return WorstPlace(x, y, worst.approach.heading_deg)


def by_speed(found: ScenarioResult) -> SpeedVerdicts:
    """The worst case at each speed."""
    worst: dict[float, ScenarioCase] = {}
    for case in sorted(found.cases, key=lambda one: (one.speed_km_h, one.worst.margin_s)):
        worst.setdefault(case.speed_km_h, case)
    return SpeedVerdicts(tuple(_at_speed(case, found.sensor_names) for case in worst.values()))


def _at_speed(case: ScenarioCase, names: Sequence[str]) -> SpeedVerdict:
    run = case.worst
    sight_s, seen_s = case.sight.seconds, run.detected_s
    cause, why = _failure(case) if run.margin_s < 0.0 else (None, "")
    return SpeedVerdict(
        speed_km_h=case.speed_km_h,
        impact=case.impact,
        sight_m=None if sight_s is None else case.runs[0].approach.gap_m(sight_s),
        seen_m=None if seen_s is None else run.approach.gap_m(seen_s),
        seen_s=None if seen_s is None else run.approach.lead_s - seen_s,
        needed_m=run.approach.gap_m(run.last_s),
        needed_s=run.needed_s,
        margin_m=run.approach.closing_m_s * run.margin_s,
        margin_s=run.margin_s,
        lost=tuple(names[n] for n in run.lost),
        cause=cause,
        why=why,
    )


def _failure(case: ScenarioCase) -> tuple[Cause, str]:
    """Why a target is not seen in time."""
    run = case.worst
    if (frame := run.lost_frame) is not None:
        lost_m = run.approach.gap_m(float(run.frame_end_s[frame]))
        return "lost_track", f"lost track at {lost_m:.1f} m: {run.returns[frame]} of {run.demanded} returns"
    if not case.is_seen_in_time:
        return "in_sight_too_late", "in sight too late"
    if run.detected_s is None:
        return "never_seen", f"never seen: at most {run.returns.max()} of {run.demanded} returns"
    return "seen_too_late", "first seen too late"


def _notes(found: ScenarioResult, case: ScenarioCase) -> tuple[str, ...]:
    """When the target is detected in the worst case, and when it could be."""
    worst = case.worst
    at = f"at {case.speed_km_h:g} km/h"
    at += f" and {case.impact:.0%} of the width" if len(found.scenario.file.impacts) > 1 else ""
    last = f"the last moment to brake {at} is {worst.needed_s:.2f} s and {worst.approach.gap_m(worst.last_s):.1f} m"
    seen = "is not detected before the impact" if worst.detected_s is None else _relative(worst.margin_s, "is detected")
    notes = [f"{last} before the impact; the target {seen}"]
    sight_s = case.sight_margin_s
    sight = "is never in sight" if sight_s is None else _relative(sight_s, "comes into sight")
    places = f"{case.sight.places:,} place{'s' if case.sight.places > 1 else ''}"
    notes.append(f"of {places} tried within the sensors' bounds, from the best one it {sight}")
    late = [one.speed_km_h for one in found.cases if not one.is_seen_in_time and one.worst.margin_s < 0.0]
    if late:
        speeds = ", ".join(f"{speed:g}" for speed in np.unique(late).tolist())
        notes.append(f"at {speeds} km/h that is too late for a frame before the last moment to brake")
    if found.scenario.file.unverified:
        notes.append(f"not verified: {found.scenario.file.unverified}")
    return tuple(notes)


def _relative(margin_s: float, what: str) -> str:
    return f"{what} {abs(margin_s):.2f} s {'before' if margin_s >= 0 else 'after'} that"
