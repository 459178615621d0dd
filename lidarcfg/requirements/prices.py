"""What a rig costs, and how many sensors it has."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

from lidarcfg.errors import ConfigError
from lidarcfg.requirements.verdict import RequirementVerdict
from lidarcfg.returns.counts import OnPlaces, no_progress
from lidarcfg.sensors.rig import Mount


def total_price(prices: Iterable[float]) -> float:
    """What several cost together: the sum of the decimals that they are written as, so that 0.1 thrice is 0.3."""
    return float(sum(Decimal(str(price)) for price in prices))


@dataclass(frozen=True)
class PriceRequirement:
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

    @property
    def work(self) -> int:
        """For progress: next to nothing."""
        return 1

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        return _at_most(self.name, "price_at_most", self.at_most, self.price(mounts))


@dataclass(frozen=True)
class SensorsRequirement:
    """The rig has at most this many sensors."""

    name: str
    at_most: int

    @property
    def work(self) -> int:
        """For progress: next to nothing."""
        return 1

    def judge(self, mounts: Sequence[Mount], on_places: OnPlaces = no_progress) -> RequirementVerdict:
        """The verdict on a rig."""
        return _at_most(self.name, "sensors_at_most", self.at_most, len(mounts))


def _at_most(name: str, kind: str, most: float, reached: float) -> RequirementVerdict:
    return RequirementVerdict(
        name=name,
        kind=kind,
        passed=reached <= most,
        unit="sensors" if kind == "sensors_at_most" else "",
        demanded=most,
        reached=reached,
        at_most=True,
        shortfall=max(reached / most - 1, 0.0),
    )
