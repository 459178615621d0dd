"""Verifies rigs: judges each requirement of a study in turn, and collects the evidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lidarcfg.requirements.evidence import Evidence
from lidarcfg.requirements.resolved import Requirements
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.sensors.rig import Mount

OnProgress = Callable[[float, str], None]


def silent(fraction: float, name: str) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class Verification:
    """A verdict on a rig, and the evidence for it."""

    verdict: Verdict
    evidence: tuple[Evidence, ...]  # of each requirement


class Verifier:
    """Verifies rigs, one after the other; counts are kept, so that only sensors that moved are cast again."""

    def __init__(self, requirements: Requirements) -> None:
        self.requirements = requirements
        self.judges, _ = requirements.judges()

    def check(self, mounts: Sequence[Mount]) -> None:
        """Raises ConfigError for a rig's mounts that cannot be judged: all are lost, or one needs a price."""
        for item in self.requirements.items:
            item.check_mounts(mounts)

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

    def verification(self, mounts: Sequence[Mount], found: Verdict) -> Verification:
        """A verdict on a rig's mounts with the evidence for it, which is without mounting errors."""
        parts = zip(self.judges, found.requirements, strict=True)
        return Verification(found, tuple(judge.evidence(mounts, one) for judge, one in parts))
