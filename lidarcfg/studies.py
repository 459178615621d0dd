"""Studies and plans, with what the families of packets know of when their sensors fire; from files, or loaded."""

from collections.abc import Callable
from pathlib import Path

from lidarcfg.files import loaded
from lidarcfg.packets.families import pattern
from lidarcfg.placement import evaluation, plan
from lidarcfg.placement import optimize as search
from lidarcfg.placement import study as studies
from lidarcfg.placement.evaluation import Evaluation
from lidarcfg.placement.optimize import Cycle, Log, Placement
from lidarcfg.placement.plan import Plan
from lidarcfg.placement.study import Study
from lidarcfg.rig import Rig, load_rig


def load_study(path: str | Path) -> Study:
    """The study in a YAML file. Raises ConfigError with file, line and key."""
    return studies.load_study(path, pattern)


def load_plan(path: str | Path, on_checked: Callable[[int, int], None] | None = None) -> Plan:
    """The plan in a YAML file. Every study of it is read; `on_checked` is told how many of how many runs are.

    Raises ConfigError with file, line and key.
    """
    return plan.load_plan(path, pattern, on_checked)


def evaluate(study: Study | str | Path, rig: Rig | str | Path, tolerance: float | None = None) -> Evaluation:
    """A rig's max VSR, worst subspaces and detection rates; the study's bounds are not enforced.

    Study and rig are files, or what is loaded from them. With a relative tolerance also the analytic max VSR, to that
    tolerance. Raises ConfigError, also where the tolerance is not above 0, where the region has too many cuboids to
    refine, and where a sensor is inside the study's vehicle.
    """
    return evaluation.evaluate(loaded(study, load_study), loaded(rig, load_rig), tolerance)


def optimize(
    study: Study | str | Path,
    threads: int | None = None,
    on_cycle: Callable[[Cycle, Rig, Log], None] | None = None,
    log: Log | None = None,
) -> Placement:
    """Search for the rig with the least objective. The result depends on the seed, not on the number of threads.

    The study is a file, or what is loaded from it. `on_cycle` gets the state of the search, the best rig and the log
    at the end of each cycle; `log` is that of an earlier search to resume: the search ends where an unbroken one would
    (budgets in seconds aside). An interrupt (Ctrl-C) ends the search and keeps the best so far. Raises ConfigError,
    also if nothing is free to move, and if no rig was found that meets the constraints.
    """
    return search.optimize(loaded(study, load_study), threads, on_cycle, log)
