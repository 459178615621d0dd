"""Prices: what a rig costs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from lidarcfg.errors import ConfigError
from lidarcfg.requirements.allowed_rigs import AllowedRigs, total_price
from lidarcfg.requirements.judge import PlainRequirement
from lidarcfg.requirements.kind import Context, Entry, Kind
from lidarcfg.requirements.verdict import RequirementVerdict, at_most
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.sensors.rig import Mount

PRICE_MAX = 1e12


class PriceKind(Kind):
    """The sensors cost no more than a price, by the study's `prices`."""

    key: ClassVar[str] = "price_at_most"
    price_at_most: Annotated[float, Field(gt=0, le=PRICE_MAX, description="what the sensors cost, at most")]

    def resolve(self, entry: Entry, context: Context) -> "PriceRequirement":
        """The requirement of a study. Raises ConfigError with file, line and key."""
        if not context.prices:
            raise entry.error("needs the study's prices, and there are none; give a price for each model", self.key)
        for model in context.models:
            if model not in context.prices:
                raise entry.error(f"{model!r} has no price; give it one in the study's prices", self.key)
        return PriceRequirement(self.name, self.price_at_most, dict(context.prices))


@dataclass(frozen=True)
class PriceRequirement(PlainRequirement):
    """The sensors cost at most this."""

    name: str
    at_most: float
    prices: Mapping[str, float]  # by model

    def price(self, mounts: Sequence[Mount]) -> float:
        """What the sensors cost. Raises ConfigError for one without a price."""
        each = []
        for mount in mounts:
            if mount.model is None or mount.model not in self.prices:
                what = f"{mount.model!r} has" if mount.model else "beams of its own have"
                known = ", ".join(sorted(self.prices))
                raise ConfigError(f"{mount.name}: {what} no price, which {self.name!r} needs; prices has {known}")
            each.append(self.prices[mount.model])
        return total_price(each)

    def check_mounts(self, mounts: Sequence[Mount]) -> None:
        """Raises ConfigError for a rig with a sensor without a price."""
        self.price(mounts)

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        return at_most(self.name, PriceKind.key, self.at_most, self.price(mounts))

    def is_exceeded(self, price: float, sensors: int) -> bool:
        """Whether rigs of that price fail."""
        return price > self.at_most

    def out_of_reach(self, rigs: AllowedRigs) -> str | None:
        """Why no rig can meet it, if that is certain."""
        least = rigs.least_price(self.prices)
        return f"the cheapest rig costs {least:,.6g}" if least > self.at_most else None
