"""The requirements of a study, resolved: objects read, zones around the vehicle, limits in numbers; and their judges.

A verdict judges at all places of the base grid and at refined ones. A search's trials are judged at fewer places, and
as soon as a bound of the shortfall says that a trial has lost, no further.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.judge import NO_PLACES, Judge, Requirement
from lidarcfg.requirements.kind import Context, Entry, VehicleSite
from lidarcfg.requirements.robustness import Robust
from lidarcfg.returns.known import KnownReturns, shares
from lidarcfg.sensors.rig import Mount


@dataclass(frozen=True)
class Requirements:
    """What a rig must see, and what it has to withstand."""

    items: tuple[Requirement, ...]
    site: VehicleSite
    robust: Robust | None = None

    @property
    def lost(self) -> int:
        """The most sensors that fail in any of them."""
        return max((item.lost for item in self.items), default=0)

    def of_slots(self, numbers: Sequence[int]) -> "Requirements":
        """The requirements for a study with only some of the sensors."""
        if not self.site.bounds:
            return self
        return replace(self, site=replace(self.site, bounds=[self.site.bounds[n] for n in numbers]))

    def too_dear(self, price: float, sensors: int) -> bool:
        """Whether rigs of that price and number of sensors exceed what is allowed, wherever their sensors are."""
        return any(item.is_exceeded(price, sensors) for item in self.items)

    def judges(
        self, mounts: Sequence[Mount] = (), more_in_trials: Mapping[int, Array] | None = None
    ) -> tuple[tuple[Judge, ...], KnownReturns | None]:
        """A judge for each, and the returns that they know together; None if none of them counts returns.

        `mounts`, if given, are those of later rigs. With `more_in_trials` they judge where trials are judged; it has
        places (n, 4) that joined these, by number of the requirement. Raises ConfigError if a mount cannot be
        simulated.
        """
        standing = {}
        for number, item in enumerate(self.items):
            one = item.standing
            if more_in_trials is not None:
                one = item.standing_in_trials(more_in_trials.get(number, NO_PLACES))
            if one is not None:
                standing[number] = one
        known = shares(list(standing.values()), self.site.obstacles, mounts) if standing else []
        of_item = dict(zip(standing, known, strict=True))
        found = tuple(item.judge_with(of_item.get(number)) for number, item in enumerate(self.items))
        return found, known[0].known if known else None


def resolved(entries: Sequence[Entry], context: Context) -> Requirements:
    """The requirements of a study. Raises ConfigError with file, line and key, for all that are wrong at once."""
    items = []
    errors = []
    for one in entries:
        try:
            items.append(one.item.resolve(one, context))
        except ConfigError as error:
            errors.append(error)
    if errors:
        raise ConfigError.all_of(errors)
    return Requirements(tuple(items), context.site, context.robust)
