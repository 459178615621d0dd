"""Strict YAML: a file becomes a checked model, or one line `file:line:column: key: what, what is allowed`.

YAML 1.2 core schema (so `1e-05` is a number and `on` is a text), read with PyYAML's composer, which keeps line
numbers. Errors: unknown or repeated keys, wrong types, NaN, infinities, and tags outside the core schema.
"""

import difflib
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError
from yaml.composer import Composer
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from lidarcfg.errors import ConfigError
from lidarcfg.inputs import read_any, too_large
from lidarcfg.kinds import OTHERS, kind_of

Key = tuple[str | int, ...]  # a path in the file: ("sensors", 0, "model")
Vec3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
NAME_MAX = 200  # characters: longer ones fit in no picture, and in no file's name
Name = Annotated[str, Field(min_length=1, max_length=NAME_MAX)]
COORDINATE_MAX_M = 1e8  # metres; UTM reaches 1e7
ANGLE_MAX = 1e8  # radians or degrees
Metres = Annotated[float, Field(ge=-COORDINATE_MAX_M, le=COORDINATE_MAX_M)]
Position = tuple[Metres, Metres, Metres]
Angle = Annotated[float, Field(ge=-ANGLE_MAX, le=ANGLE_MAX)]
Angles = tuple[Angle, Angle, Angle]
NODES_MAX = 500_000  # keys and values: beyond this it is an alias bomb, not a configuration
DEPTH_MAX = 50
TOO_MANY = f"has more than the {NODES_MAX:,} keys and values that are read of a file"
LARGE = 200_000  # characters, from which on a file is read by libyaml
NUMBER_MAX = 400  # characters of a number: no float needs more
FILE_MAX = 64_000_000  # bytes: a file without an end, such as /dev/zero, is larger


class Model(BaseModel):
    """A part of a file: frozen, only known keys, exact types, finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)
    renamed: ClassVar[dict[str, str]] = {}  # keys of earlier versions → their new names
    kind: ClassVar[str] = ""  # of the file that it is the whole of; empty: a part


M = TypeVar("M", bound=Model)

SENTENCES = {  # by pydantic's error type, with the limits of its context
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
    "none_required": "{got} is not allowed here; leave the key out",
    "greater_than": "{got} is too small; allowed: above {gt}",
    "greater_than_equal": "{got} is too small; allowed: at least {ge}",
    "less_than": "{got} is too large; allowed: below {lt}",
    "less_than_equal": "{got} is too large; allowed: at most {le}",
    "string_too_short": "{got} is too short; allowed: at least {min_length} characters",
    "string_too_long": "{got}… is too long; allowed: at most {max_length} characters",
    "string_pattern_mismatch": "{got} is not allowed; allowed: a text that matches {pattern}",
}


def fault(what: str, *at: str | int) -> PydanticCustomError:
    """The error that a model's validator raises: `what`, at the key `at` below the model."""
    return PydanticCustomError("fault", "{what}", {"what": what, "at": at})


def check_names(names: Iterable[str], what: str, *at: str | int) -> None:
    """A model's validator: each name stands once in the list `at`."""
    seen: set[str] = set()
    for i, name in enumerate(names):
        if name in seen:
            raise fault(f"{name!r} is {what} already; each name may stand once", *at, i, "name")
        seen.add(name)


class _Resolver(BaseResolver):
    """Plain scalars by the YAML 1.2 core schema."""


_TAG = "tag:yaml.org,2002:"
_PLAIN = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?(\.inf|\.Inf|\.INF)|\.nan|\.NaN|\.NAN",
        list("-+0123456789."),
    ),
}
for _kind, (_pattern, _first) in _PLAIN.items():
    _Resolver.add_implicit_resolver(_TAG + _kind, re.compile(rf"^(?:{_pattern})$"), _first)


class _Loader(Reader, Scanner, Parser, Composer, _Resolver):
    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        _Resolver.__init__(self)


_QuickLoader: type[Any] = _Loader
if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    class _LibraryLoader(CParser, _Resolver):
        """The same with libyaml: several times as fast, but without a limit on nesting, and with other messages."""

        def __init__(self, text: str) -> None:
            CParser.__init__(self, text)
            _Resolver.__init__(self)

    _QuickLoader = _LibraryLoader


def _check_nodes(text: str, name: str) -> None:
    """Raises ConfigError for a large text of more nodes, or more within another, than are read."""
    nodes = depth = 0
    for event in yaml.parse(text, _QuickLoader):
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if (nodes > NODES_MAX or depth > DEPTH_MAX) and (mark := event.start_mark):
            what = "nested too deeply" if depth > DEPTH_MAX else TOO_MANY
            raise ConfigError(f"{name}:{mark.line + 1}:{mark.column + 1}: {what}")


class Document:
    """A YAML text as plain values, with the line and column of each key."""

    def __init__(self, text: str, name: str, own: bool = False) -> None:
        self.name = name
        self.places: dict[Key, tuple[int, int]] = {}
        self._others: dict[Key, tuple[Document, Key]] = {}  # where the values at some keys came from
        self._nodes = 0
        try:
            if large := len(text) > LARGE:
                _check_nodes(text, name)
            root = (_QuickLoader if own or large else _Loader)(text).get_single_node()
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
            what = " ".join(str(error.problem or error.context or "not YAML").split())
            raise ConfigError(f"{name}:{place}: not YAML: {what}") from None
        except (yaml.YAMLError, ValueError) as error:
            raise ConfigError(f"{name}:1:1: not YAML: {' '.join(str(error).split())}") from None
        except RecursionError:
            raise ConfigError(f"{name}:1:1: nested too deeply") from None
        if root is None:
            raise ConfigError(f"{name}:1:1: the file is empty")
        self.value = self._value(root, (), ())

    def error(self, key: Key, what: str) -> ConfigError:
        """The error `what` at `key`."""
        if other := self._other(key):
            return other[0].error(other[1], what)
        line, column = self.place(key)
        path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")
        error = ConfigError(f"{self.name}:{line}:{column}: {path + ': ' if path else ''}{what}")
        error.at = self.name, key, what
        return error

    def place(self, key: Key) -> tuple[int, int]:
        """Line and column of `key`, or of the nearest key above it that the file has."""
        if other := self._other(key):
            return other[0].place(other[1])
        while key and key not in self.places:
            key = key[:-1]
        return self.places.get(key, (1, 1))

    def at(self, key: Key) -> Any:
        """The value at `key`. Raises LookupError."""
        value = self.value
        for part in key:
            value = value[part]
        return value

    def replaced(self, key: Key, other: "Document", other_key: Key) -> "Document":
        """The document with another's value at `key`, without that key if it is null; errors are at their place there.

        Raises LookupError where a map or a list above `key` has no such place; missing maps are made.
        """
        out = copy(self)
        out.value = _with(self.value, key, other.at(other_key))
        out._others = self._others | {key: (other, other_key)}
        return out

    def checked(self, model: type[M]) -> M:
        """The values as a `model`. Raises ConfigError."""
        try:
            return model.model_validate(self.value)
        except ValidationError as error:
            found = kind_of(self.value)
            if model.kind and found and found != model.kind:
                raise self.error((), f"this is a {found}; a {model.kind} belongs here") from None
            raise _first_error(self, error, model) from None
        except (OverflowError, RecursionError) as error:
            raise ConfigError(f"{self.name}:1:1: {error}") from None

    def _other(self, key: Key) -> "tuple[Document, Key] | None":
        """The document and the key there that `key` came from, if it was replaced."""
        for above, (other, at) in reversed(self._others.items()):
            if key[: len(above)] == above:
                return other, (*at, *key[len(above) :])
        return None

    def _value(self, node: yaml.Node, key: Key, parents: tuple[int, ...]) -> Any:
        self._nodes += 1
        self.places.setdefault(key, (node.start_mark.line + 1, node.start_mark.column + 1))
        if id(node) in parents or self._nodes > NODES_MAX:
            raise self.error(key, "an alias inside itself, or too many of them")
        if len(parents) > DEPTH_MAX:
            raise self.error(key, "nested too deeply")
        parents = (*parents, id(node))
        if isinstance(node, yaml.MappingNode) and node.tag == _TAG + "map":
            return self._mapping(node, key, parents)
        if isinstance(node, yaml.SequenceNode) and node.tag == _TAG + "seq":
            return tuple(self._value(child, (*key, i), parents) for i, child in enumerate(node.value))
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, key)
        raise self.error(key, f"tag {node.tag!r} is not allowed; allowed are plain values, lists and maps")

    def _mapping(self, node: yaml.MappingNode, key: Key, parents: tuple[int, ...]) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            name = self._value(key_node, (*key, "(key)"), parents)
            self.places.pop((*key, "(key)"), None)
            place = key_node.start_mark.line + 1, key_node.start_mark.column + 1
            if not isinstance(name, str):
                self.places[(*key, str(name))] = place
                raise self.error((*key, str(name)), "is not a text; a key must be one")
            if name in out:
                first = self.places[(*key, name)][0]
                self.places[(*key, name)] = place
                raise self.error((*key, name), f"repeated key; it was given on line {first}")
            self.places[(*key, name)] = place
            out[name] = self._value(value_node, (*key, name), parents)
        return out

    def _scalar(self, node: yaml.ScalarNode, key: Key) -> Any:
        text, kind = node.value, node.tag.removeprefix(_TAG)
        if kind in ("int", "float") and len(text) > NUMBER_MAX:
            raise self.error(key, f"{text[:40]!r}… has {len(text)} characters; a number has {NUMBER_MAX} at most")
        try:
            if kind == "str":
                return text
            if kind == "null":
                return None
            if kind == "bool":
                return {"true": True, "false": False}[text.lower()]
            if kind == "int":
                return int(text, 8 if text.startswith("0o") else 16 if text.startswith("0x") else 10)
            if kind == "float":
                number = float(re.sub(r"\.(inf|nan)", r"\1", text.lower()))
                if not math.isfinite(number):
                    raise self.error(key, f"{text} is not a finite number")
                return number
        except (ValueError, KeyError):
            raise self.error(key, f"{text[:40]!r} is not a value of type {kind}") from None
        raise self.error(key, f"tag {node.tag!r} is not allowed; allowed are plain values, lists and maps")


def _with(values: Any, key: Key, value: Any) -> Any:
    """The values with another at `key`; with None as if that key was not there."""
    if not key:
        return value
    first, below = key[0], key[1:]
    if isinstance(first, str) and isinstance(values, dict):
        if value is None and (not below or values.get(first) is None):
            return {name: kept for name, kept in values.items() if name != first}
        return values | {first: _with({} if values.get(first) is None and below else values.get(first), below, value)}
    if isinstance(first, int) and isinstance(values, tuple) and first < len(values):
        return *values[:first], _with(values[first], below, value), *values[first + 1 :]
    raise LookupError(first)


def document(path: str | Path) -> Document:
    """The YAML file at `path`. Raises ConfigError."""
    return Document(_read(path), str(path))


def load(path: str | Path, model: type[M], own: bool = False) -> M:
    """Read the file at `path` as a `model`; `own` if it is part of the package.

    Raises ConfigError with file, line, column and key.
    """
    if what := OTHERS.get(Path(path).suffix.lower()):
        raise ConfigError(f"{path}: {what}")
    return loads(_read(path), model, str(path), own)


def error_at(path: str | Path, key: Key, what: object) -> ConfigError:
    """The error `what` at a key of a loaded file, for checks that need more than one part of it."""
    try:
        return Document(_read(path), str(path)).error(key, str(what))
    except ConfigError:  # a pipe cannot be read twice
        return ConfigError(f"{path}: {what}")


@dataclass(frozen=True)
class Section:
    """A part of a file that is checked when its owner needs it: its values, and where they came from."""

    values: Mapping[str, Any]
    path: str = field(default="", compare=False)  # of the file; empty: made in Python
    at: Key = field(default=(), compare=False)

    def checked(self, model: type[M]) -> M:
        """The values as a `model`. Raises ConfigError with file, line, column and key."""
        try:
            return model.model_validate(dict(self.values))
        except ValidationError as error:
            raise self._placed(_first_error(self._document(), error, model, self.at)) from None

    def error(self, key: Key, what: object) -> ConfigError:
        """The error `what` at a key of the section."""
        return self._placed(self._document().error((*self.at, *key), str(what)))

    def _placed(self, error: ConfigError) -> ConfigError:
        return error if self.path else ConfigError(str(error).removeprefix(":1:1: "))

    def _document(self) -> "Document":
        try:
            return Document(_read(self.path), self.path)
        except ConfigError:  # made in Python, or gone since
            return Document("{}", self.path)


def _read(path: str | Path) -> str:
    try:
        content = read_any(path, FILE_MAX)
        if len(content) > FILE_MAX:
            raise ConfigError(f"{path}: {too_large(FILE_MAX)}")
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}:1:1: not text in UTF-8 (byte {error.start})") from None
    except OSError as error:
        raise ConfigError.from_os(path, error) from None
    except ValueError as error:
        raise ConfigError(f"{str(path)!r}: {error}") from None


def loads(text: str, model: type[M], name: str, own: bool = False) -> M:
    """Read the text of a file called `name` as a `model`. Raises ConfigError."""
    return Document(text, name, own).checked(model)


def _first_error(document: Document, error: ValidationError, model: type[Model], above: Key = ()) -> ConfigError:
    """The first error in the file, with a count of the others; `above` is the model's key in it."""
    errors = error.errors(include_url=False)
    keys = [_key(item) for item in errors]
    # pydantic also calls a list too short if one of its items is wrong: report the item only
    items = [
        item
        for item, key in zip(errors, keys, strict=True)
        if item["type"] != "too_short" or not any(len(k) > len(key) and k[: len(key)] == key for k in keys)
    ]
    items.sort(key=lambda item: (item["type"] == "missing", document.place((*above, *_key(item)))))
    more = f" (and {len(items) - 1} more)" if len(items) > 1 else ""
    return document.error((*above, *_key(items[0])), _message(items[0], model) + more)


def _key(item: Any) -> Key:
    return (*item["loc"], *item.get("ctx", {}).get("at", ()))


def _message(item: Any, model: type[Model]) -> str:
    kind, context = item["type"], item.get("ctx", {})
    if kind == "fault":
        return str(context["what"])
    if kind == "extra_forbidden":
        return unknown_key(str(item["loc"][-1]), _model_at(model, item["loc"][:-1]))
    if kind in ("too_short", "too_long"):
        least, most = context.get("min_length"), context.get("max_length")
        allowed = f"exactly {least}" if least == most else f"at least {least}" if least else f"at most {most}"
        return f"has {context['actual_length']} values; allowed: {allowed}"
    limits = {key: _shown(value) for key, value in context.items() if key != "expected"}
    return SENTENCES.get(kind, "{got} is not allowed").format_map(
        limits | {"expected": context.get("expected"), "got": _shown(item["input"])}
    )


def _shown(value: Any) -> str:
    """A value as YAML writes it; of a map or a list only what it is."""
    if isinstance(value, dict | tuple):
        return "a map" if isinstance(value, dict) else f"a list of {len(value)}"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return format(value, ".15g") if isinstance(value, float) else repr(value)[:60]


def unknown_key(name: str, model: type[Model]) -> str:
    """The message for a key that the model does not have."""
    if name in model.renamed:
        return f"renamed; it is now {model.renamed[name]}"
    allowed = [field.alias or key for key, field in model.model_fields.items()]
    unit = [known for known in allowed if known.startswith(name + "_")]
    if unit:
        return f"unknown key without a unit; allowed: {', '.join(unit)}"
    close = difflib.get_close_matches(name, allowed, 1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"unknown key; {hint}allowed: {', '.join(allowed)}"


def _model_at(model: type[Model], loc: Key) -> type[Model]:
    """The model at `loc` inside `model`, found by walking the annotations."""
    found: Any = model
    for part in loc:
        if isinstance(part, str) and isinstance(found, type) and issubclass(found, Model):
            found = found.model_fields[part].annotation
        found = next(nested_models(found), found)
    return found if isinstance(found, type) and issubclass(found, Model) else model


def nested_models(annotation: Any) -> Iterator[type[Model]]:
    """The models in the type of a field."""
    if isinstance(annotation, type) and issubclass(annotation, Model):
        yield annotation
    for argument in getattr(annotation, "__args__", ()):
        yield from nested_models(argument)
