"""Which imperfections of a real sensor are simulated: none unless the rig asks for them; all from a seed."""

from typing import Annotated, ClassVar

from pydantic import Field

from lidarcfg.config import Model, Positive


class Realism(Model):
    """All off by default, so that a capture is exact; simulate/echoes.py has the model of each and its source."""

    renamed: ClassVar = {"dropout_share": "dropout_fraction"}

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    range_noise_m: Annotated[float, Field(ge=0, le=10)] = 0.0  # one sigma of a normal distribution
    dropout_fraction: Annotated[float, Field(ge=0, le=1)] = 0.0  # of firings, lost at random
    range_10_percent_m: Positive | None = None  # a target of 10 %, hit head on in clear air, is seen this far
    divergence: bool = False  # beams are as wide as the sensor's optics say
