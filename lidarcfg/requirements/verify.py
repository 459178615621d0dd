"""Verifying rigs: each requirement of a study is judged in turn."""

from collections.abc import Callable, Sequence

from lidarcfg.errors import ConfigError
from lidarcfg.requirements.objects import ObjectRequirement, object_judges
from lidarcfg.requirements.prices import PriceRequirement, SensorsRequirement
from lidarcfg.requirements.requirements import Requirements
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.sensors.rig import Mount

OnProgress = Callable[[float, str], None]


def silent(fraction: float, name: str) -> None:
    """Nobody wants to know."""


class Verifier:
    """Verifies rig after rig; what is known of sensors is kept, so that only those that moved are cast again."""

    def __init__(self, requirements: Requirements) -> None:
        self.requirements = requirements
        site = requirements.site
        objects = [item for item in requirements.items if isinstance(item, ObjectRequirement)]
        judges = iter(object_judges(objects, site.obstacles, requirements.robust))
        self.judges = tuple(
            next(judges) if isinstance(item, ObjectRequirement) else item for item in requirements.items
        )

    def verify(self, mounts: Sequence[Mount], on_progress: OnProgress = silent) -> Verdict:
        """The verdict on a rig's mounts; `on_progress` is told the fraction done, and the requirement that is judged.

        Raises ConfigError for sensors that cannot be simulated or have no price, and if none would be left.
        """
        work = [judge.work for judge in self.judges]
        done = 0
        out = []
        for judge, item in zip(self.judges, self.requirements.items, strict=True):
            lost = 0 if isinstance(item, PriceRequirement | SensorsRequirement) else item.lost
            if lost >= len(mounts):
                what = f"{lost} of the rig's {len(mounts)} sensors lost leave none"
                raise ConfigError(f"{item.name}: {what}; allowed: at most {len(mounts) - 1}")
            on_progress(done / sum(work), item.name)
            begun = done

            def on_places(count: int, name: str = item.name, most: int = begun + judge.work) -> None:
                nonlocal done
                done = min(done + count, most)
                on_progress(done / sum(work), name)

            out.append(judge.judge(mounts, on_places))
            done = begun + judge.work
        return Verdict(tuple(out))
