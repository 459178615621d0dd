"""What a rig must see, as files say it: the requirements of a study, or of a file of their own that studies share."""

import os
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, SerializationInfo, model_validator

from lidarcfg.config.models import (
    COORDINATE_MAX_M,
    FileName,
    Model,
    Name,
    Position,
    check_names,
    validation_error,
)
from lidarcfg.files import example
from lidarcfg.requirements.braking import BrakingOrName
from lidarcfg.returns.places import Distances, Heading, Sector, ascending
from lidarcfg.returns.target import SIZE_MAX_M, ObjectOrName
from lidarcfg.sensors.rig import SENSORS_MAX, Distance, one_of

HEADINGS_DEG = tuple(float(heading) for heading in range(0, 360, 45))
SPEED_MAX_KM_H = 300.0
PRICE_MAX = 1e12

Speed = Annotated[float, Field(gt=0, le=SPEED_MAX_KM_H)]
Height = Annotated[float, Field(gt=0, le=SIZE_MAX_M)]


Heights = Annotated[
    tuple[Annotated[float, Field(ge=0, le=SIZE_MAX_M)], Height], AfterValidator(ascending)
]  # least, greatest


class BoxFile(Model):
    """A box in the vehicle frame that wholly contains the object."""

    min_m: Position
    max_m: Position

    @model_validator(mode="after")
    def _check(self) -> "BoxFile":
        for axis, (low, high) in enumerate(zip(self.min_m, self.max_m, strict=True)):
            if not low < high:
                raise validation_error(f"{high:g} is not above min_m's {low:g}", "max_m", axis)
        return self


def _scenario_from(name: str, info: SerializationInfo) -> str:
    """A scenario's name as it is, or the absolute path of its file, which a file in the context's folder names."""
    folder: Path | None = info.context
    return name if folder is None or not Path(name).suffix else os.path.realpath(example(folder / name))


ScenarioName = Annotated[str, Field(min_length=1), PlainSerializer(_scenario_from)]  # a preset, or a file's path


def _of_file(value: Any) -> Any:
    return {"file": value} if isinstance(value, str) else value


KINDS = {  # of requirements, by the key that only they have: the other keys that go with it
    "object": (
        *("returns", "cluster_m", "sensors", "within_m", "sector_deg", "region", "headings_deg", "at_least"),
        *("step_m", "lost"),
    ),
    "post_height_m": ("first_seen_at_most_m", "gap_at_most_m", "within_m", "sector_deg", "lost"),
    "shadow_at_most_m3": ("height_m", "within_m", "lost"),
    "scenario": ("speeds_km_h", "target", "returns", "cluster_m", "braking", "lost"),
    "price_at_most": (),
    "sensors_at_most": (),
}


class RequirementFile(Model):
    """A requirement, of the kind that its key in KINDS says; or the name of a file with a list of them."""

    file: FileName | None = None  # instead of all other keys
    name: Name = ""
    # An object gets its returns wherever it stands in a zone.
    object: ObjectOrName | None = None
    returns: Annotated[int, Field(ge=1, le=1_000_000)] | None = None  # in one revolution, in the worst phase
    cluster_m: Annotated[float, Field(gt=0, le=10)] | None = None  # they are of one cluster with this tolerance
    sensors: Annotated[int, Field(ge=1, le=SENSORS_MAX)] | None = None  # the number that get them, each alone
    within_m: Distances | None = None  # between the object and the body
    sector_deg: Sector | None = None  # from, to, counter-clockwise from ahead
    region: BoxFile | None = None  # instead of within_m
    headings_deg: Annotated[tuple[Heading, ...], Field(min_length=1, max_length=360)] | None = None
    at_least: Annotated[float, Field(gt=0, le=1)] | None = None  # fraction of places
    step_m: Annotated[float, Field(ge=0.02, le=COORDINATE_MAX_M)] | None = None  # of places, at most
    # A post is seen near the body, and beyond that without long gaps.
    post_height_m: Height | None = None
    first_seen_at_most_m: Distance | None = None  # from the body
    gap_at_most_m: Distance | None = None
    # The bodies hide little from all sensors.
    shadow_at_most_m3: Annotated[float, Field(ge=0)] | None = None
    height_m: Heights | None = None  # above the ground
    # A moving target is seen in time to brake.
    scenario: ScenarioName | None = None
    speeds_km_h: Annotated[tuple[Speed, ...], Field(min_length=1, max_length=100)] | None = None
    target: ObjectOrName | None = None  # instead of the scenario's
    braking: BrakingOrName | None = None  # none: an emergency's
    # What a rig costs.
    price_at_most: Annotated[float, Field(gt=0, le=PRICE_MAX)] | None = None
    sensors_at_most: Annotated[int, Field(ge=1, le=SENSORS_MAX)] | None = None

    lost: Annotated[int, Field(ge=0, le=SENSORS_MAX)] | None = None  # sensors that fail; none: as `robust` says

    @model_validator(mode="after")
    def _check(self) -> "RequirementFile":
        given = [key for key in type(self).model_fields if getattr(self, key) not in (None, "")]
        if self.file is not None:
            if len(given) > 1:
                raise validation_error("conflicts with file; a file has all keys of its requirements", given[1])
            return self
        kinds = [key for key in KINDS if key in given]
        if not kinds:
            raise validation_error(f"asks for nothing; give one of {', '.join(KINDS)}")
        if len(kinds) > 1:
            raise validation_error(f"conflicts with {kinds[0]}; make it a requirement of its own", kinds[1])
        for key in given:
            if key not in ("name", *kinds, *KINDS[kinds[0]]):
                owners = [kind for kind, keys in KINDS.items() if key in keys]
                raise validation_error(f"does not go with {kinds[0]}; it goes with {' or '.join(owners)}", key)
        if not self.name:
            raise validation_error("missing", "name")
        {"object": self._check_object, "post_height_m": self._check_post}.get(kinds[0], lambda: None)()
        return self

    def _check_object(self) -> None:
        if self.returns is None:
            raise validation_error("missing", "returns")
        one_of(self, "within_m", "region")
        if self.sector_deg and not self.within_m:
            raise validation_error("goes with within_m, not with region", "sector_deg")

    def _check_post(self) -> None:
        if self.first_seen_at_most_m is None and self.gap_at_most_m is None:
            raise validation_error("asks for nothing; give first_seen_at_most_m, gap_at_most_m, or both")

    @property
    def marker(self) -> str:
        """The key in KINDS that says of which kind it is."""
        return next(key for key in KINDS if getattr(self, key) is not None)


RequirementOrFile = Annotated[
    RequirementFile, BeforeValidator(_of_file, json_schema_input_type=RequirementFile | str)
]  # a text: a file


class RequirementsFile(Model):
    """Requirements that several studies share."""

    kind: ClassVar[str] = "requirements"
    requirements: Annotated[tuple[RequirementFile, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> "RequirementsFile":
        check_names((item.name for item in self.requirements), "a requirement", "requirements")
        for i, item in enumerate(self.requirements):
            if item.file is not None:
                raise validation_error("is for studies; write the requirements here", "requirements", i, "file")
        return self
