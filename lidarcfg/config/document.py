"""YAML, read strictly and up to a size limit, as plain values with lines and columns; and values written as YAML.

YAML 1.2 core schema (so `1e-05` is a number and `on` is a text), read with PyYAML's composer, which keeps line
numbers. Errors: repeated keys, NaN, infinities, and tags outside the core schema. PyYAML itself reads and writes YAML
1.1, so what is written here is quoted wherever one of the two would read something else than a text.
"""

import math
import re
from collections.abc import Mapping
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from yaml.composer import Composer
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

from lidarcfg.errors import ConfigError
from lidarcfg.inputs import read_any, too_large

Key = tuple[str | int, ...]  # a path in the file: ("sensors", 0, "model")
NODES_MAX = 500_000  # keys and values: beyond this it is an alias bomb, not a configuration
DEPTH_MAX = 50
TOO_MANY = f"has more than the {NODES_MAX:,} keys and values that are read of a file"
LARGE = 200_000  # characters; longer texts are read with libyaml
NUMBER_MAX = 400  # characters of a number: no float needs more
FILE_MAX = 64_000_000  # bytes: an endless file, such as /dev/zero, has more


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
BREAKS = re.compile("[\x85\u2028\u2029]")  # of lines, in YAML 1.1 only


class _Dumper(yaml.SafeDumper):
    """Texts that PyYAML reads as YAML 1.1 and we by the core schema; what occurs twice is written twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, text: str) -> yaml.ScalarNode:
        """Other breaks than a newline are escaped, so they need quotes that allow it."""
        return self.represent_scalar(_TAG + "str", text, '"' if BREAKS.search(text) else None)


_Dumper.add_representer(str, _Dumper.represent_text)
for _kind, (_pattern, _first) in _PLAIN.items():
    for _schema in (_Resolver, _Dumper):
        _schema.add_implicit_resolver(_TAG + _kind, re.compile(rf"^(?:{_pattern})$"), _first)


class _Loader(Reader, Scanner, Parser, Composer, _Resolver):
    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        _Resolver.__init__(self)


_QuickLoader: type[Any] = _Loader
if yaml.__with_libyaml__:

    class _LibraryLoader(_Resolver, yaml.CBaseLoader):
        """The same with libyaml: several times as fast, but it does not limit nesting and words errors differently."""

    _QuickLoader = _LibraryLoader


def _check_nodes(text: str, name: str) -> None:
    """Raises ConfigError for a large text with too many nodes, or nested too deeply."""
    nodes = depth = 0
    for event in yaml.parse(text, _QuickLoader):
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if (nodes > NODES_MAX or depth > DEPTH_MAX) and (mark := event.start_mark):
            what = "nested too deeply" if depth > DEPTH_MAX else TOO_MANY
            raise ConfigError(f"{name}:{mark.line + 1}:{mark.column + 1}: {what}")


class Document:
    """A YAML text as plain values, with the line and column of each key.

    `own`: the text is part of the package, so the faster parser may read it.
    """

    def __init__(self, text: str, name: str, own: bool = False) -> None:
        self.name = name
        self.places: dict[Key, tuple[int, int]] = {}
        self._others: dict[Key, tuple[Document, Key]] = {}  # values taken from other documents, by key
        self._nodes = 0
        try:
            if large := len(text) > LARGE:
                _check_nodes(text, name)
            root = (_QuickLoader if own or large else _Loader)(text).get_single_node()
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
            what = " ".join(str(error.problem or error.context or "not YAML").split())
            if "nesting depth" in what:  # some releases of libyaml have a limit of their own
                raise ConfigError(f"{name}:{place}: nested too deeply") from None
            raise ConfigError(f"{name}:{place}: not YAML: {what}") from None
        except (yaml.YAMLError, ValueError) as error:
            raise ConfigError(f"{name}:1:1: not YAML: {' '.join(str(error).split())}") from None
        except RecursionError:
            raise ConfigError(f"{name}:1:1: nested too deeply") from None
        if root is None:
            raise ConfigError(f"{name}:1:1: the file is empty")
        self.value = self._value(root, (), ())

    @classmethod
    def of(cls, values: Mapping[Any, Any], name: str) -> "Document":
        """Values that are in no text: what Python has for maps, lists and numbers. Errors say no line."""
        out = cls("{}", name)
        out.places = {}
        out.value = _plain_value(values)
        return out

    def error(self, key: Key, what: str) -> ConfigError:
        """The error `what` at `key`."""
        if other := self._other(key):
            return other[0].error(other[1], what)
        line, column = self.place(key)
        at = f"{self.name}:{line}:{column}" if self.places else self.name
        error = ConfigError(f"{at}: {key_text(key)}{what}")
        error.at = self.name, key, what
        return error

    def place(self, key: Key) -> tuple[int, int]:
        """Line and column of `key`, or of the nearest key above it that the file has."""
        if other := self._other(key):
            return other[0].place(other[1])
        return self.places.get(self.nearest(key), (1, 1))

    def nearest(self, key: Key) -> Key:
        """The key, or the nearest above it that the file has."""
        while key and key not in self.places:
            key = key[:-1]
        return key

    def at(self, key: Key) -> Any:
        """The value at `key`. Raises LookupError."""
        value = self.value
        for part in key:
            value = value[part]
        return value

    def replaced(self, key: Key, other: "Document", other_key: Key) -> "Document":
        """A copy with the value that `other` has at `other_key`; without the key if that value is null.

        Errors in the new value name its place in `other`. Missing maps above `key` are made. Raises LookupError where
        a list has no such item, or where `key` leads through something other than a map or a list.
        """
        out = copy(self)
        out.value = _with(self.value, key, other.at(other_key))
        out._others = self._others | {key: (other, other_key)}
        return out

    def _other(self, key: Key) -> "tuple[Document, Key] | None":
        """The document that the value at `key` was taken from, and its key there; None if it is our own."""
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
        text = node.value
        kind = node.tag.removeprefix(_TAG)
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


def key_text(key: Key) -> str:
    """A key as errors name it, with a colon; nothing for the whole file."""
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(".")
    return f"{path}: " if path else ""


def _plain_value(value: Any) -> Any:
    """A value as YAML has it: lists as tuples, numpy's numbers and arrays as Python's; anything else as it is."""
    if isinstance(value, Mapping):
        return {name: _plain_value(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return tuple(map(_plain_value, value))
    if isinstance(value, np.ndarray | np.generic):
        return _plain_value(value.tolist()) if value.ndim else value.item()
    return str(value) if isinstance(value, Path) else value


def _with(values: Any, key: Key, value: Any) -> Any:
    """A copy of the values with `value` at `key`; None removes the key."""
    if not key:
        return value
    first = key[0]
    below = key[1:]
    if isinstance(first, str) and isinstance(values, dict):
        if value is None and (not below or values.get(first) is None):
            return {name: kept for name, kept in values.items() if name != first}
        return values | {first: _with({} if values.get(first) is None and below else values.get(first), below, value)}
    if isinstance(first, int) and isinstance(values, tuple) and first < len(values):
        return *values[:first], _with(values[first], below, value), *values[first + 1 :]
    raise LookupError(first)


def document(path: str | Path) -> Document:
    """The YAML file at `path`. Raises ConfigError."""
    return Document(read_text(path), str(path))


def yaml_text(values: Any, blocks: bool = False) -> str:
    """The text of a file with these values, which are read back equal.

    Maps and lists that hold no others are in one line; with `blocks` every key and item has a line of its own.
    """
    flow = False if blocks else None
    return yaml.dump(values, Dumper=_Dumper, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=110)


def inline(text: str) -> str:
    """A text as it stands in a map or a list of one line: quoted if it must be."""
    if yaml_text([text]) == f"[{text}]\n":
        return text
    return yaml.dump(text, Dumper=_Dumper, default_style='"', allow_unicode=True, width=math.inf).rstrip("\n")


def read_text(path: str | Path) -> str:
    """The text of a file in UTF-8. Raises ConfigError."""
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
