"""What a search minimises, as its file says it."""

from typing import Annotated

from pydantic import Field

from lidarcfg.config.models import COORDINATE_MAX_M, Model
from lidarcfg.placement.zones import Weight

SIGHT = ("blind_volume", "seen_by_two", "blind_spot_m")  # terms that tell rigs apart only where something limits sight


class BlindSpotObjective(Model):
    """How much the largest distance of the blind-spot contour weighs, in metres, and at what height."""

    height_m: Annotated[float, Field(ge=0, le=COORDINATE_MAX_M)] = 0.5  # above the region's floor
    weight: Weight = 1.0


class Objective(Model):
    """What is minimised: the weighted mean of these. By default the paper's max VSR alone."""

    max_vsr: Weight | None = None  # metres
    inscribed_radius: Weight | None = None  # metres: the largest sphere that no beam touches
    detection: dict[str, Weight] = Field(default_factory=dict)  # by object: 1 − its detection rate
    blind_volume: Weight | None = None  # the fraction of the region's volume that no LiDAR sees
    seen_by_two: Weight | None = None  # the fraction that fewer than two see
    blind_spot_m: BlindSpotObjective | None = None

    @property
    def is_max_vsr(self) -> bool:
        """Whether it is max VSR alone."""
        return not self.detection and all(getattr(self, key) is None for key in ("inscribed_radius", *SIGHT))
