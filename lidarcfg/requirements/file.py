"""Requirements in files: those of a study, or of a file of their own that studies share.

A requirement is of the kind whose key it has. A kind is a module, and a line in `KINDS`.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from lidarcfg.config.document import Key
from lidarcfg.config.models import FileName, Model, as_model, check_names, error_at, errors_at, load, validation_error
from lidarcfg.files import example
from lidarcfg.requirements.kind import Entry, Item, Kind
from lidarcfg.requirements.object import ObjectKind
from lidarcfg.requirements.post import PostKind
from lidarcfg.requirements.price import PriceKind
from lidarcfg.requirements.scenarios.requirement import ScenarioKind
from lidarcfg.requirements.sensor_count import SensorCountKind
from lidarcfg.requirements.shadow import ShadowKind

KINDS: dict[str, type[Kind]] = {  # by the key that only they have
    ObjectKind.key: ObjectKind,
    PostKind.key: PostKind,
    ShadowKind.key: ShadowKind,
    ScenarioKind.key: ScenarioKind,
    PriceKind.key: PriceKind,
    SensorCountKind.key: SensorCountKind,
}


class SharedFile(Item):
    """The name of a file with requirements."""

    file: FileName

    def entries(self, path: Path, at: Key) -> tuple[Entry, ...]:
        """Those in the file."""
        with errors_at(path, *at):
            return _in_file(example(path.parent / self.file))


def _kind(values: Any) -> Kind:
    """A validator: the requirement, of the kind whose key its values have."""
    if not isinstance(values, Mapping):
        raise PydanticKnownError("model_type", {"class_name": "requirement"})
    given = {key: value for key, value in values.items() if value is not None}
    if "file" in given:
        raise validation_error("is for studies; write the requirements here", "file")
    keys = [key for key in KINDS if key in given] or [_meant(given)]
    if len(keys) > 1:
        raise validation_error(f"conflicts with {keys[0]}; make it a requirement of its own", keys[1])
    kind = KINDS[keys[0]]
    own = {name: value for name, value in given.items() if name in kind.model_fields or not _owners(name)}
    goes = [(name, " or ".join(_owners(name))) for name in given if name not in own]
    faults = [validation_error(f"does not go with {keys[0]}; it goes with {owners}", name) for name, owners in goes]
    return as_model(kind, own, faults)


def _owners(name: str) -> list[str]:
    """The kinds that have a key."""
    return [key for key, kind in KINDS.items() if name in kind.model_fields]


def _meant(given: Mapping[str, Any]) -> str:
    """The key of the kind that values without one are meant to be of. Raises a fault if that is not clear."""
    unknown = [name for name in given if not _owners(name)]
    for name in unknown:
        if close := difflib.get_close_matches(name, KINDS, 1):
            return close[0]
    if unknown:
        raise validation_error(f"unknown key; a requirement has one of {', '.join(KINDS)}", unknown[0])
    raise validation_error(f"asks for nothing; give one of {', '.join(KINDS)}")


def _item(values: Any) -> Item:
    """A validator: a requirement, or a file with some; a text is its name."""
    if isinstance(values, str):
        values = {"file": values}
    if not isinstance(values, Mapping) or values.get("file") is None:
        return _kind(values)
    others = [name for name, value in values.items() if value is not None and name != "file"]
    if others:
        raise validation_error("conflicts with file; a file has all keys of its requirements", others[0])
    return as_model(SharedFile, {"file": values["file"]})


@dataclass(frozen=True)
class _ByKey:
    """How pydantic reads an item: of the kinds that the table has then, by its key."""

    takes_files: bool

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(_item if self.takes_files else _kind)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        types = [*KINDS.values(), *((SharedFile, str) if self.takes_files else ())]
        return {"anyOf": [handler(TypeAdapter(one).core_schema) for one in types]}


AnyRequirement = Annotated[Kind, _ByKey(takes_files=False)]
RequirementOrFile = Annotated[Item, _ByKey(takes_files=True)]


class RequirementsFile(Model):
    """Requirements that several studies share."""

    kind: ClassVar[str] = "requirements"
    requirements: Annotated[tuple[AnyRequirement, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> "RequirementsFile":
        check_names((item.name for item in self.requirements), "a requirement", "requirements")
        return self


def entries_of(items: Sequence[Item], path: Path) -> tuple[Entry, ...]:
    """The requirements of a study's file, with those of the files that it names. Raises ConfigError."""
    out: list[Entry] = []
    for i, item in enumerate(items):
        at: Key = "requirements", i
        for one in item.entries(path, at):
            if one.item.name in (other.item.name for other in out):
                what = f"{one.item.name!r} is a requirement already; each name may be given once"
                raise error_at(path, (*at, "name"), what)
            out.append(one)
    return tuple(out)


def load_requirements(path: str | Path) -> tuple[Entry, ...]:
    """The requirements in a file of their own; what they name is read. Raises ConfigError with file, line and key."""
    found = _in_file(example(path))
    for one in found:
        one.item.read(one)
    return found


def _in_file(path: Path) -> tuple[Entry, ...]:
    return entries_of(load(path, RequirementsFile).requirements, path)
