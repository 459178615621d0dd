"""The best rig of a study, in one call: `place` is the plain loop; `optimize` also logs, resumes and evaluates."""

from collections.abc import Callable, Sequence

import numpy as np

from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.search.log import Log
from lidarcfg.search.misses_search import MissesRun
from lidarcfg.search.plain_rigs import plain_points
from lidarcfg.search.requirements_search import RequirementsRun
from lidarcfg.search.run import Budget, Cycle, Placement, SearchRun
from lidarcfg.search.screening import Screening
from lidarcfg.search.seeded import SeededSearch
from lidarcfg.search.start_rigs import points_of
from lidarcfg.sensors.rig import Rig, rigs_of
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study, with_solver


def optimize(
    study: Study | Given,
    threads: int | None = None,
    on_cycle: Callable[[Cycle, Rig, Log], None] | None = None,
    log: Log | None = None,
    skip: bool = True,
    on_evaluations: Callable[[int], None] | None = None,
    plain: bool | None = None,
    starts: Sequence[Rig | Given] = (),
    *,
    solver: str | None = None,
    seed: int | None = None,
    cycles: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
) -> Placement:
    """Search for the rig with the least objective. The result depends on the seed, not on the number of threads.

    Study and `starts` are files, dicts with their keys, or loaded. `solver`, `seed`, and a budget of `cycles`,
    `evaluations` or `seconds` replace those of the study. `on_cycle` gets the state of the search, the best rig and the
    log at the end of each cycle. `on_evaluations` is called from time to time, also within a cycle, with the number
    of evaluations so far. `log` resumes an earlier search, which ends where an uninterrupted one would (unless its
    budget is in seconds). Without `skip` every trial is evaluated in full, which changes only the time. An
    interrupt (Ctrl-C) ends the search and keeps the best rig so far. If misses are minimised, if the study has
    requirements, or with `plain`, the plain rigs that an engineer would try are the first trials, so that no result is
    worse than the best of them; nor is it worse than any of the rigs in `starts`, which come before. Raises ConfigError
    if nothing is free to move, if a start is outside the bounds or has other sensors, or if no rig meets the
    constraints.
    """
    study = loaded(study, load_study, Study)
    study = with_solver(study, method=solver, seed=seed, cycles=cycles, evaluations=evaluations, seconds=seconds)
    if study.to_choose:
        instead = "`front` searches for the best rig of each price"
        if study.requirements:
            instead = "`cheapest` searches for the cheapest rig that meets the requirements"
        raise ConfigError(f"the study has models to choose; {instead}")
    dimensions = study.space.dimensions
    if dimensions == 0:
        raise ConfigError("nothing to optimise: every bound is equal; evaluate the rig instead")
    budget = Budget.of(study.solver)
    run = search_run(study, log, plain, rigs_of(starts))
    interrupted = False
    with run.evaluator(threads, skip, on_evaluations) as evaluator:
        try:
            while not run.is_over(budget):
                if run.step(evaluator, budget) and on_cycle:
                    on_cycle(run.history[-1], run.rig(), run.log())
        except KeyboardInterrupt:
            interrupted = True
    return run.placement(interrupted)


def search_run(
    study: Study, log: Log | None = None, plain: bool | None = None, starts: Sequence[Rig] = ()
) -> SearchRun:
    """A search that has not begun, or that replays a log; `plain` and `starts` as in optimize."""
    begins_plain = bool(study.requirements or study.objective.misses) if plain is None else plain
    if log is None:
        points = [points_of(study, starts)] + ([_plain_points(study)] if begins_plain else [])
        log = Log.empty(np.concatenate(points) if starts or begins_plain else None, len(starts))
    elif starts:
        raise ConfigError("a search that is resumed has begun: it takes no more rigs to start with")
    if study.requirements:
        return RequirementsRun(study, log)
    if study.objective.misses:
        _check_firing(study)
        return MissesRun(study, log)
    first = study.solver.begin(study.space.coordinates) if log.points is None else SeededSearch(study, log.points)
    return SearchRun(study, first, log)


def _plain_points(study: Study) -> Array:
    """(n, free coordinates) the plain rigs; those that come closest to the requirements first."""
    points = plain_points(study)
    return Screening(study.requirements).ranked(study, points).points if study.requirements else points


def _check_firing(study: Study) -> None:
    """Check that it is known when the sensors fire. Raises ConfigError."""
    try:
        scanners_of(study.rig(study.space.midpoint).mounts)
    except ConfigError as error:
        raise ConfigError(f"{error}; or give the study objective: {{max_vsr: 1}}") from None


def place(study: Study, threads: int | None = None) -> Rig:
    """The rig of a study that costs least, by the bare loop.

    It is the one that `optimize` finds where max VSR alone is minimised. Searches by misses and requirements add plain
    rigs, more places and verdicts.
    """
    solver = study.solver.begin(study.space.coordinates)  # minimises over the unit cube, and knows no LiDARs
    search = SearchRun(study, solver)  # keeps the best trial
    budget = Budget.of(study.solver)
    with search.evaluator(threads) as evaluator:
        while not search.is_over(budget):
            trials = search.ask()  # points of the unit cube
            cost = search.costs(trials, evaluator, budget)  # max VSR of the rigs there, or what the study asks for
            search.tell(trials, cost, budget)  # the solver learns
    return search.rig()
