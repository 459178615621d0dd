"""Strict models of our files: a YAML file becomes a checked model, or one line `file:line:column: key: what, allowed`.

Unknown keys, missing keys, values of a wrong type and values outside their limits are errors.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, SerializationInfo, ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from lidarcfg.config.document import Document, Key, document, key_text, read_text
from lidarcfg.config.kinds import OTHERS, a_file_of, kind_of
from lidarcfg.errors import ConfigError, LidarcfgError, a_thing
from lidarcfg.files import example

Vec3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Weight = Annotated[float, Field(ge=1e-9, le=1e9)]
NAME_MAX = 200  # characters: a longer name fits neither into a picture nor into a file's name
Name = Annotated[str, Field(min_length=1, max_length=NAME_MAX)]
SHOWN_MAX = 60  # characters of a wrong value
COORDINATE_MAX_M = 1e8  # metres; UTM reaches 1e7
ANGLE_MAX = 1e8  # radians or degrees
Metres = Annotated[float, Field(ge=-COORDINATE_MAX_M, le=COORDINATE_MAX_M)]
Position = tuple[Metres, Metres, Metres]
Angle = Annotated[float, Field(ge=-ANGLE_MAX, le=ANGLE_MAX)]
Angles = tuple[Angle, Angle, Angle]


def path_from(name: str, info: SerializationInfo) -> str:
    """The absolute path of a file that a file in the context's folder names; without a folder, the name as it is."""
    folder: Path | None = info.context
    return name if folder is None else os.path.realpath(example(folder / name))


FileName = Annotated[str, Field(min_length=1), PlainSerializer(path_from)]  # of a file; see whole_values


class Model(BaseModel):
    """A part of a file: frozen, only known keys, exact types, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)
    renamed: ClassVar[dict[str, str]] = {}  # keys of earlier versions → their new names
    removed: ClassVar[dict[str, str]] = {}  # keys of earlier versions → what to do instead
    kind: ClassVar[str] = ""  # of file, such as `study`; empty for a part of a file


M = TypeVar("M", bound=Model)
Given = str | Path | Mapping[str, Any]  # a file by its path, or its keys and values


def whole_values(model: Model, folder: Path) -> dict[str, Any]:
    """The values of a model that was read in a folder, for a file anywhere: with defaults, and with absolute paths."""
    return model.model_dump(mode="json", exclude_none=True, context=folder)


def with_defaults(values: dict[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    """A model's values before they are checked, with defaults for keys that are missing or null."""
    return values | {key: default for key, default in defaults.items() if values.get(key) is None}


ERROR_MESSAGES = {  # by pydantic's error type, with the limits of its context
    "missing": "missing",
    "string_type": "{got} is not a text",
    "string_unicode": "{got} is not a text",
    "int_type": "{got} is not a whole number",
    "float_type": "{got} is not a number",
    "bool_type": "{got} is not true or false",
    "tuple_type": "{got} is not a list",
    "dict_type": "{got} is not a map of keys",
    "model_type": "{got} is not a map of keys",
    "literal_error": "{got} is not allowed; allowed: {expected}",
    "none_required": "{got} is not allowed here; remove the key",
    "greater_than": "{got} is too small; allowed: above {gt}",
    "greater_than_equal": "{got} is too small; allowed: at least {ge}",
    "less_than": "{got} is too large; allowed: below {lt}",
    "less_than_equal": "{got} is too large; allowed: at most {le}",
    "multiple_of": "{got} is not allowed; allowed: multiples of {multiple_of}",
    "string_too_short": "{got} is too short; allowed: at least {min_length} character{s}",
    "string_too_long": "{got} is too long; allowed: at most {max_length} characters",
    "string_pattern_mismatch": "{got} is not allowed; allowed: a text that matches {pattern}",
}


def validation_error(what: str, *at: str | int) -> PydanticCustomError:
    """The error that a model's validator raises: `what`, at the key `at` below the model."""
    return PydanticCustomError("fault", "{what}", {"what": what, "at": at})


def with_faults(faults: Sequence[PydanticCustomError], data: Any, handler: Callable[[Any], M]) -> M:
    """A model's wrap validator: raises the faults that it found itself, together with those of the model's fields."""
    details = [InitErrorDetails(type=fault, input=data) for fault in faults]
    try:
        made = handler(data)
    except ValidationError as error:
        details += [_details(item) for item in error.errors(include_url=False)]
    else:
        if not details:
            return made
    raise ValidationError.from_exception_data("", details)


def as_model(model: type[M], values: Any, faults: Sequence[PydanticCustomError] = ()) -> M:
    """A validator where one of several models belongs: the values as this one. Raises as `with_faults`.

    What is said of unknown keys names this model's.
    """

    def validate(values: Any) -> M:
        try:
            return model.model_validate(values)
        except ValidationError as error:
            found = [_details(item, model) for item in error.errors(include_url=False)]
            raise ValidationError.from_exception_data("", found) from None

    return with_faults(faults, values, validate)


def _details(item: ErrorDetails, model: type[Model] | None = None) -> InitErrorDetails:
    """An error, to be raised again; of an unknown key with what is said of it, if its model is given."""
    context = item.get("ctx", {})
    kind: str | PydanticCustomError = item["type"]
    if kind == "fault":
        kind = validation_error(context["what"], *context["at"])
    elif kind == "extra_forbidden" and model:
        kind = validation_error(_message(item, model))
    return InitErrorDetails(type=kind, loc=item["loc"], input=item["input"], ctx=context)


def check_names(names: Iterable[str], what: str, *at: str | int) -> None:
    """A model's validator: each name stands once in the list `at`."""
    seen: set[str] = set()
    for i, name in enumerate(names):
        if name in seen:
            raise validation_error(f"{name!r} is {what} already; each name may be given once", *at, i, "name")
        seen.add(name)


def load(path: str | Path, model: type[M], own: bool = False) -> M:
    """Read the file at `path` as a `model`; `own`: it is part of the package, so it can be read faster.

    Raises ConfigError with file, line, column and key.
    """
    if what := OTHERS.get(Path(path).suffix.lower()):
        raise ConfigError(f"{path}: {what}")
    return loads(read_text(path), model, str(path), own)


def load_or_check(given: Given, model: type[M]) -> tuple[M, Path]:
    """A file, or a dict with its keys, as a `model`; and the path that errors name and that other paths start from.

    Of a dict this is the kind of file, in the working folder. Raises ConfigError, also for anything else.
    """
    if isinstance(given, Mapping):
        return checked(Document.of(given, model.kind), model), Path(model.kind)
    if isinstance(given, str | Path):
        path = example(given)
        return load(path, model), path
    what = f"{a_thing(given)} is no {model.kind}"
    raise ConfigError(f"{what}; allowed: the path of its file, a dict with the file's keys, or what is loaded of them")


class _Keys(Model):
    """A file of any kind."""

    model_config = ConfigDict(extra="allow")


def load_keys(path: str | Path) -> dict[str, Any]:
    """The keys and values of the file at `path`, whatever its kind. Raises ConfigError."""
    return load(path, _Keys).model_extra or {}


def error_at(path: str | Path, key: Key, what: object) -> ConfigError:
    """The error `what` at a key of a loaded file, for checks across several models."""
    return all_errors_at(path, [(key, what)])[0]


def all_errors_at(path: str | Path, found: Sequence[tuple[Key, object]]) -> list[ConfigError]:
    """Errors at several keys of a loaded file, which is read once."""
    try:
        read = document(path)
    except ConfigError:  # a pipe cannot be read twice
        return [ConfigError(f"{path}: {key_text(key)}{what}") for key, what in found]
    return [read.error(key, str(what)) for key, what in found]


@contextmanager
def errors_at(path: str | Path, *key: str | int) -> Iterator[None]:
    """Report errors that occur inside at a key of the loaded file at `path`."""
    try:
        yield
    except LidarcfgError as error:
        raise error_at(path, key, "; ".join(str(error).splitlines())) from None


@dataclass(frozen=True)
class Section:
    """A part of a file that its owner checks later: its values, and where they came from."""

    values: Mapping[str, Any]
    path: str = field(default="", compare=False)  # of the file; empty: made in Python
    at: Key = field(default=(), compare=False)

    def checked(self, model: type[M]) -> M:
        """The values as a `model`. Raises ConfigError with file, line, column and key."""
        try:
            return model.model_validate(dict(self.values))
        except ValidationError as error:
            raise self._placed(_all_errors(self._document(), error, model, self.at)) from None

    def error(self, key: Key, what: object) -> ConfigError:
        """The error `what` at a key of the section."""
        return self._placed(self._document().error((*self.at, *key), str(what)))

    def _placed(self, error: ConfigError) -> ConfigError:
        if self.path:
            return error
        return ConfigError.all_of([ConfigError(line.removeprefix(":1:1: ")) for line in str(error).split("\n")])

    def _document(self) -> Document:
        try:
            return document(self.path)
        except ConfigError:  # made in Python, or gone since
            return Document("{}", self.path)


def loads(text: str, model: type[M], name: str, own: bool = False) -> M:
    """Read the text of a file called `name` as a `model`. Raises ConfigError."""
    return checked(Document(text, name, own), model)


def checked(document: Document, model: type[M]) -> M:
    """The values of a document as a `model`. Raises ConfigError with file, line, column and key."""
    try:
        return model.model_validate(document.value)
    except ValidationError as error:
        found = kind_of(document.value)
        if model.kind and found and found != model.kind:
            raise document.error((), f"this is {a_file_of(found)}; {a_file_of(model.kind)} belongs here") from None
        raise _all_errors(document, error, model) from None
    except (OverflowError, RecursionError) as error:
        raise ConfigError(f"{document.name}:1:1: {error}") from None


def _all_errors(document: Document, error: ValidationError, model: type[Model], above: Key = ()) -> ConfigError:
    """The errors in the file, sorted by place, missing keys last; `above` is the model's key in the file."""
    errors = error.errors(include_url=False)
    keys = [_key(item) for item in errors]
    # pydantic also calls a list too short if one of its items is wrong: report the item only
    items = [
        item
        for item, key in zip(errors, keys, strict=True)
        if item["type"] != "too_short" or not any(len(k) > len(key) and k[: len(key)] == key for k in keys)
    ]
    items.sort(key=lambda item: (item["type"] == "missing", document.place((*above, *_key(item)))))
    found: dict[Key, ConfigError] = {}
    for item in items:
        key = (*above, *_key(item))
        there = document.nearest(key)
        # of the alternatives that a value may be, each has an error there: report the first
        missing = item["type"] == "missing"
        where = key if missing and there not in found else there or key
        if where not in found and not (missing and _is_misspelled(key, found)):
            found[where] = document.error(key, _message(item, model))
    return ConfigError.all_of(list(found.values()))


def _is_misspelled(missing: Key, found: Mapping[Key, ConfigError]) -> bool:
    """Whether the error of an unknown key beside a missing one says that the missing one is meant."""
    beside = (error.at[2] for key, error in found.items() if key[:-1] == missing[:-1] and error.at)
    return any(f"did you mean {missing[-1]}?" in what or f"unit; allowed: {missing[-1]}" in what for what in beside)


def _key(item: Any) -> Key:
    return (*item["loc"], *item.get("ctx", {}).get("at", ()))


def _message(item: Any, model: type[Model]) -> str:
    kind = item["type"]
    context = item.get("ctx", {})
    if kind == "fault":
        return str(context["what"])
    if kind == "extra_forbidden":
        return unknown_key(str(item["loc"][-1]), _model_at(model, item["loc"][:-1]))
    if kind in ("too_short", "too_long"):
        least = context.get("min_length")
        most = context.get("max_length")
        allowed = f"exactly {least}" if least == most else f"at least {least}" if least else f"at most {most}"
        count = context["actual_length"]
        return f"has {count} {'value' if count == 1 else 'values'}; allowed: {allowed}"
    limits = {key: shown(value) for key, value in context.items() if key != "expected"}
    plural = "s" * (context.get("min_length") != 1)
    return ERROR_MESSAGES.get(kind, "{got} is not allowed").format_map(
        limits | {"expected": context.get("expected"), "got": shown(item["input"]), "s": plural}
    )


def shown(value: Any) -> str:
    """A value as YAML writes it; of a map or a list, and of what YAML does not have, only its kind."""
    if isinstance(value, dict | tuple):
        return "a map" if isinstance(value, dict) else f"a list of {len(value)}"
    if not isinstance(value, str | int | float | None):
        return a_thing(value)
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str) and len(value) > SHOWN_MAX:
        return f"{value[:SHOWN_MAX]!r}…"
    return format(value, ".15g") if isinstance(value, float) else repr(value)[:SHOWN_MAX]


def unknown_key(name: str, model: type[Model]) -> str:
    """The message for a key that the model does not have."""
    if name in model.renamed:
        return f"renamed; it is now {model.renamed[name]}"
    if name in model.removed:
        return f"no longer a key; {model.removed[name]}"
    allowed = [field.alias or key for key, field in model.model_fields.items()]
    unit = [known for known in allowed if known.startswith(name + "_")]
    if unit:
        return f"unknown key without a unit; allowed: {', '.join(unit)}"
    import difflib  # slow to load, and only for mistakes

    close = difflib.get_close_matches(name, allowed, 1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"unknown key; {hint}allowed: {', '.join(allowed)}"


def _model_at(model: type[Model], loc: Key) -> type[Model]:
    """The model at `loc` inside `model`, found by walking the annotations."""
    found: Any = model
    for part in loc:
        if isinstance(found, type) and issubclass(found, Model):  # else a place in a list, or one of several models
            found = found.model_fields[part].annotation if part in found.model_fields else found
        found = next(nested_models(found), found)
    return found if isinstance(found, type) and issubclass(found, Model) else model


def nested_models(annotation: Any) -> Iterator[type[Model]]:
    """The models in the type of a field."""
    if isinstance(annotation, type) and issubclass(annotation, Model):
        yield annotation
    for argument in getattr(annotation, "__args__", ()):
        yield from nested_models(argument)
