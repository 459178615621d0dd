"""The judges of a study's requirements: one each, for verdicts and for searches alike.

A verdict judges at all places of the base grid and at refined ones. A search's trials are judged at fewer places, and
as soon as a bound of the shortfall says that a trial has lost, no further.
"""

from collections.abc import Mapping, Sequence

from lidarcfg.geometry import Array
from lidarcfg.requirements.kind import NO_PLACES, Judge
from lidarcfg.requirements.resolved import Requirements
from lidarcfg.returns.known import KnownReturns, shares
from lidarcfg.sensors.rig import Mount


def judges(
    requirements: Requirements, mounts: Sequence[Mount] = (), more_in_trials: Mapping[int, Array] | None = None
) -> tuple[tuple[Judge, ...], KnownReturns | None]:
    """A judge for each requirement, and the returns that they know together; None if none of them counts returns.

    `mounts`, if given, are those of later rigs. With `more_in_trials` they judge where trials are judged; it has places
    (n, 4) that joined these, by number of the requirement. Raises ConfigError if a mount cannot be simulated.
    """
    standing = {}
    for number, item in enumerate(requirements.items):
        one = item.standing
        if more_in_trials is not None:
            one = item.standing_in_trials(more_in_trials.get(number, NO_PLACES))
        if one is not None:
            standing[number] = one
    known = shares(list(standing.values()), requirements.site.obstacles, mounts) if standing else []
    of_item = dict(zip(standing, known, strict=True))
    found = tuple(item.judge_with(of_item.get(number)) for number, item in enumerate(requirements.items))
    return found, known[0].known if known else None
