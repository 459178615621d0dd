"""Which imperfections of a real sensor are simulated: none unless the rig says so, and then by a seed."""

from typing import Annotated

from pydantic import Field

from lidarcfg.config import Model, Positive


class Realism(Model):
    """All off by default, so that a capture is exact; `capture/returns.py` says what each does and by whom."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    range_noise_m: Annotated[float, Field(ge=0, le=10)] = 0.0  # one sigma of a normal distribution
    dropout_share: Annotated[float, Field(ge=0, le=1)] = 0.0  # of firings, lost by chance
    range_10_percent_m: Positive | None = None  # a target of 10 per cent, met head on in clear air, is seen so far
    divergence: bool = False  # the beam has the width that the sensor's optics say
