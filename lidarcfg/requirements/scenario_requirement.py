"""Whether a scenario's target is detected in time to brake, as a requirement."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lidarcfg.requirements.braking import EMERGENCY, Braking
from lidarcfg.requirements.scenario import Scenario
from lidarcfg.requirements.scenario_run import Rule, ScenarioCase, ScenarioResult, check_scenario
from lidarcfg.requirements.sight import Bounds
from lidarcfg.requirements.verdict import RequirementVerdict, WorstPlace
from lidarcfg.sensors.rig import Mount
from lidarcfg.world.vehicle import Vehicle

PLACES_PER_CASE = 2000  # whose returns take about as long to count as the runs at a speed and an impact


@dataclass(frozen=True)
class ScenarioRequirement:
    """A scenario's target is detected in time to brake at all speeds."""

    name: str
    scenario: Scenario
    vehicle: Vehicle
    speeds_km_h: tuple[float, ...]
    rule: Rule
    braking: Braking = EMERGENCY
    lost: int = 0  # sensors that fail
    bounds: Bounds | None = None  # of the sensors, for the earliest line of sight; None: where they are
    ground_m: float = 0.0

    @property
    def work(self) -> int:
        """About the number of places that would take as long, for progress."""
        return PLACES_PER_CASE * len(self.speeds_km_h) * len(self.scenario.file.impacts)

    def check(
        self, mounts: Sequence[Mount], on_progress: Callable[[float], None] = lambda fraction: None
    ) -> "ScenarioOutcome":
        """The outcome for a rig. Raises ConfigError."""
        return ScenarioOutcome(
            self,
            check_scenario(
                self.scenario,
                mounts,
                self.vehicle,
                speeds_km_h=self.speeds_km_h,
                rule=self.rule,
                braking=self.braking,
                losses=sorted({0, self.lost, min(1, len(mounts) - 1)}),
                bounds=self.bounds,
                ground_m=self.ground_m,
                on_progress=on_progress,
            ),
        )

    def judge(
        self, mounts: Sequence[Mount], on_places: Callable[[int], None] = lambda count: None
    ) -> RequirementVerdict:
        """The verdict on a rig; `on_places` is told how much more of `work` is done. Raises ConfigError."""
        done = 0

        def on_progress(fraction: float) -> None:
            nonlocal done
            now = round(fraction * self.work)
            on_places(now - done)
            done = now

        return self.check(mounts, on_progress).verdict


@dataclass(frozen=True)
class ScenarioOutcome:
    """The outcome of a scenario requirement for a rig."""

    requirement: ScenarioRequirement
    tried: ScenarioResult  # also with each single sensor lost, whether that is asked for or not

    @cached_property
    def result(self) -> ScenarioResult:
        """The result of the runs with as many sensors lost as the requirement says, and with all sensors."""
        return self.tried.with_lost(0, self.requirement.lost)

    @property
    def breaking(self) -> tuple[str, ...]:
        """The sensors whose failure, each alone, breaks the requirement."""
        out = []
        for n, name in enumerate(self.tried.sensor_names):
            runs = [run for case in self.tried.cases for run in case.runs if run.lost == (n,)]
            if any(run.margin_s < 0.0 for run in runs):
                out.append(name)
        return tuple(out)

    @property
    def verdict(self) -> RequirementVerdict:
        """The verdict, in seconds before the last moment to brake."""
        found = self.result
        case = found.worst
        worst = case.worst
        return RequirementVerdict(
            name=self.requirement.name,
            kind="scenario",
            passed=found.met,
            unit="s",
            demanded=0.0,
            reached=worst.margin_s,
            at_most=False,
            shortfall=found.shortfall,
            worst=_place(case),
            lost=tuple(found.sensor_names[n] for n in worst.lost),
            breaking=self.breaking,
            notes=_notes(found, case),
        )


def _place(case: ScenarioCase) -> WorstPlace:
    """The target in the vehicle frame at the last moment to brake."""
    worst = case.worst
    x, y = (worst.approach.target_m(worst.last_s) - worst.approach.velocity_m_s * worst.last_s).tolist()
    return WorstPlace(x, y, worst.approach.heading_deg)


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
