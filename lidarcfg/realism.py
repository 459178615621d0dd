"""The imperfections of a real sensor to simulate: none unless the rig asks for them, all repeatable from a seed."""

from typing import Annotated, ClassVar

from pydantic import Field

from lidarcfg.config import Model, Positive


class Realism(Model):
    """All off by default: captures are exact. simulate/echoes.py has each model and its source."""

    renamed: ClassVar = {"dropout_share": "dropout_fraction"}

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    range_noise_m: Annotated[float, Field(ge=0, le=10)] = 0.0  # one sigma of a normal distribution
    dropout_fraction: Annotated[float, Field(ge=0, le=1)] = 0.0  # probability that a firing is lost
    range_10_percent_m: Positive | None = None  # range of a 10 % target at normal incidence in clear air
    divergence: bool = False  # beams are as wide as the sensor's optics facts say
