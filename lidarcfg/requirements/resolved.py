"""The requirements of a study, resolved: objects read, zones around the vehicle, limits in numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lidarcfg.errors import ConfigError
from lidarcfg.requirements.context import Context, VehicleSite
from lidarcfg.requirements.kind import Entry, Requirement
from lidarcfg.requirements.robustness import Robust


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
