"""What a study's file says is minimised: a weighted mean of terms, those of `terms.TERMS`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, SerializationInfo, TypeAdapter, create_model
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from lidarcfg.config.models import Model, as_model
from lidarcfg.returns.misses import MissesFile
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.study.terms import TERMS
from lidarcfg.study.terms.max_vsr import MaxVsr
from lidarcfg.study.terms.misses import MissesTerm
from lidarcfg.study.terms.term import Term, TermContext
from lidarcfg.vsr.detection import DetectionObject


class ObjectiveKeys(Model):
    """What is minimised: the weighted mean of these.

    By default misses alone, or where there is no vehicle the paper's max VSR.
    """

    removed: ClassVar[dict[str, str]] = {"blind_spot_m": "ask for posts or a shadow under `requirements` instead"}


@cache
def _keys_of(terms: tuple[type[Term], ...]) -> type[ObjectiveKeys]:
    fields: dict[str, Any] = {term.key: term.field for term in terms}
    return create_model("Objective", __base__=ObjectiveKeys, __doc__=ObjectiveKeys.__doc__, **fields)


def _keys() -> type[ObjectiveKeys]:
    """The keys of an objective in a file: those of the terms that the table has now."""
    return _keys_of(tuple(TERMS.values()))


@dataclass(frozen=True)
class Objective:
    """What is minimised: the weighted mean of the terms that a file gives, by their keys; without any, max VSR."""

    given: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, values: Any) -> "Objective":
        """A validator: the objective of a file's values."""
        if isinstance(values, Objective):
            return values
        if not isinstance(values, Mapping):
            raise PydanticKnownError("model_type", {"class_name": "Objective"})
        keys = as_model(_keys(), values)
        found = {key: getattr(keys, key) for key in TERMS}
        return cls({key: one for key, one in found.items() if one is not None and one != {}})

    def _written(self, info: SerializationInfo) -> dict[str, Any]:
        keys = _keys().model_construct(**self.given)
        written: dict[str, Any] = keys.model_dump(mode=info.mode, exclude_none=info.exclude_none, context=info.context)
        return written

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        written = core_schema.plain_serializer_function_ser_schema(cls._written, info_arg=True)
        return core_schema.no_info_plain_validator_function(cls.read, serialization=written)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(_keys()).core_schema)

    @property
    def misses(self) -> MissesFile | None:
        """What its misses are of, if it has any."""
        return self.given.get(MissesTerm.key)

    @property
    def is_misses(self) -> bool:
        """Whether it is misses alone."""
        return list(self.given) == [MissesTerm.key]

    @property
    def is_max_vsr(self) -> bool:
        """Whether it is max VSR alone."""
        return list(self.given or MAX_VSR) == [MaxVsr.key]

    def cuts(self, objects: Sequence[DetectionObject]) -> bool:
        """Whether it needs the subspaces."""
        return any(TERMS[key].cuts(given, objects) for key, given in (self.given or MAX_VSR).items())

    def terms(self, context: TermContext) -> list[Term]:
        """Its terms, for a study and rigs."""
        asked = self.given or MAX_VSR
        return [one for key, term in TERMS.items() if key in asked for one in term.of(asked[key], context)]


MAX_VSR = {MaxVsr.key: 1.0}


def without_cones(
    objective: Objective, detection: Sequence[DetectionObject], only_required: bool, sensors: Sequence[Sensor]
) -> tuple[tuple[str | int, ...], str] | None:
    """The key of a study that only cones of beams can answer, and why some sensor's cannot; None if all is well."""
    keys: list[tuple[str | int, ...]] = [("detection", i) for i, item in enumerate(detection) if item.returns is None]
    keys += [("objective", key) for key in objective.given if TERMS[key].of_cones]
    if objective.is_max_vsr and not only_required:
        keys.append(("objective",))
    scans = [sensor.name for sensor in sensors if sensor.scan_pattern]
    if not scans or not keys:
        return None
    what = "counts subspaces" if keys[0][0] == "detection" else "is max_vsr" if keys[0] == ("objective",) else "is"
    return keys[0], (
        f"{what} of cones of beams, and {scans[0]} has a scan pattern; "
        "instead, detect objects by returns (detection: returns), give a vehicle, or give requirements"
    )
