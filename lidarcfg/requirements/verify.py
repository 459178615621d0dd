"""Verifying rigs: each requirement of a study is judged in turn."""

from collections.abc import Callable, Sequence

from lidarcfg.errors import ConfigError
from lidarcfg.requirements.objects import ObjectJudge, ObjectRequirement
from lidarcfg.requirements.requirements import Requirements
from lidarcfg.requirements.scenarios import ScenarioRequirement
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from lidarcfg.sensors.rig import Mount

OnProgress = Callable[[float, str], None]


def _silent(fraction: float, name: str) -> None:
    """Nobody wants to know."""


class Verifier:
    """Verifies rig after rig; what is known of sensors is kept, so that only those that moved are cast again."""

    def __init__(self, requirements: Requirements) -> None:
        self.requirements = requirements
        site = requirements.site
        self.judges = tuple(
            ObjectJudge(item, site.obstacles, requirements.robust) if isinstance(item, ObjectRequirement) else item
            for item in requirements.items
        )

    def verify(self, mounts: Sequence[Mount], on_progress: OnProgress = _silent) -> Verdict:
        """The verdict on a rig's mounts; `on_progress` is told the fraction done, and the requirement that is judged.

        Raises ConfigError for sensors that cannot be simulated or have no price, and if none would be left.
        """
        work = [judge.work if isinstance(judge, ObjectJudge | ScenarioRequirement) else 1 for judge in self.judges]
        total = sum(work)
        done = 0
        out: list[RequirementVerdict] = []
        for judge, own, item in zip(self.judges, work, self.requirements.items, strict=True):

            def on_fraction(fraction: float, done: int = done, own: int = own, name: str = item.name) -> None:
                on_progress((done + own * fraction) / total, name)

            on_fraction(0.0)
            if isinstance(item, ObjectRequirement | ScenarioRequirement) and item.lost >= len(mounts):
                what = f"{item.lost} of the rig's {len(mounts)} sensors lost leave none"
                raise ConfigError(f"{item.name}: {what}; allowed: at most {len(mounts) - 1}")
            if isinstance(judge, ObjectJudge | ScenarioRequirement):
                out.append(judge.judge(mounts, on_fraction))
            else:
                out.append(judge.judge(mounts))
            done += own
        return Verdict(tuple(out))
