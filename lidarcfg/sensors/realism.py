"""The imperfections of a real sensor that can be simulated: all are off by default, and repeatable from a seed."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from lidarcfg.config.models import Model, Positive, validation_error

Sigma = Annotated[float, Field(ge=0, le=10)]
Fraction = Annotated[float, Field(ge=0, le=1)]
PRESET = "measured"


class Realism(Model):
    """All are off by default: captures are exact. simulate/echoes.py names the models' sources."""

    renamed: ClassVar = {"dropout_share": "dropout_fraction"}

    preset: Literal["measured"] | None = None  # take what is not given here from the sensor's file
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    range_noise_m: Sigma = 0.0  # one sigma of a normal distribution
    dark_noise_m: Sigma | None = None  # instead of it, where the reflectivity is below 2; none: the same
    laser_error_m: Sigma = 0.0  # standard deviation over the lasers of each one's constant error
    intensity_noise: Annotated[float, Field(ge=0, le=255)] = 0.0  # one sigma, in levels of 255
    dropout_fraction: Fraction = 0.0  # probability that a firing is lost
    last_alone_fraction: Fraction = 0.0  # probability that of dual returns only the last is sent
    strongest_alone_fraction: Fraction = 0.0  # and that only the other one is
    range_10_percent_m: Positive | None = None  # range of a 10 % target at normal incidence in clear air
    divergence: bool | tuple[Positive, Positive] = False  # true: as wide as the sensor's optics facts say; else mrad


class MeasuredRealism(Realism):
    """The measured values of a sensor model, which a rig selects with `realism: measured`."""

    source: str


def _named(value: Any) -> Any:
    if value == PRESET:
        return {"preset": PRESET}
    if isinstance(value, str):
        raise validation_error(f"{value!r} is not allowed; allowed: {PRESET}, or keys and values")
    return value


RealismOrName = Annotated[Realism, BeforeValidator(_named, json_schema_input_type=Realism | Literal["measured"])]


def resolved(given: Realism, measured: MeasuredRealism) -> Realism:
    """The given values, completed by the measured ones."""
    said = {key: getattr(given, key) for key in given.model_fields_set - {"preset"}}
    known = {key: getattr(measured, key) for key in measured.model_fields_set - {"source", "seed", "preset"}}
    return Realism(**known | said)
