"""The user's mistakes: each error is one line that says where, what, and what is allowed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Self

MESSAGE_MAX = 200  # characters of a library's message
MANY = 50  # errors of a file that are told; of more, the number


def one_line(text: str) -> str:
    """The text with control characters, which names may contain, written as escapes."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def a_thing(value: object) -> str:
    """The class of a value of Python's with its article."""
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"


def reason(error: OSError) -> str:
    """Why the operating system refused, such as `no such file or directory`."""
    return (error.strerror or str(error)).lower()


class LidarcfgError(Exception):
    """A mistake of the user's, in one line. The command line prints it and exits with 2."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))

    @classmethod
    def from_os(cls, path: str | Path, error: OSError) -> Self:
        """The error for a file that the operating system does not let us read or write."""
        return cls(f"{path}: {reason(error)}")

    @classmethod
    def damaged(cls, path: Path, error: object, kind: str = "") -> Self:
        """The error for a file that a library cannot read or memory cannot hold; `kind` is by default the suffix."""
        what = " ".join(str(error).split())[:MESSAGE_MAX] or type(error).__name__
        large = ", or more than memory holds" * isinstance(error, MemoryError)
        return cls(f"{path}: not a whole {kind or path.suffix[1:].lower()} file{large}: {what}")


class ConfigError(LidarcfgError):
    """A sensor, rig, study or scene file contains something that is not allowed.

    If the error is at a key, `at` holds the file's name, the key, and what is wrong with it. `others` are errors that
    were found with it; as text, each has a line.
    """

    at: tuple[str, tuple[str | int, ...], str] | None = None
    others: "tuple[ConfigError, ...]" = ()

    def __str__(self) -> str:
        return "\n".join([super().__str__(), *map(str, self.others)])

    @classmethod
    def all_of(cls, errors: "Sequence[ConfigError]") -> "ConfigError":
        """The first of some errors, with the others."""
        flat = [one for error in errors for one in (error, *error.others)]
        first = flat[0]
        rest = flat[1:MANY]
        for one in flat:
            one.others = ()
        if len(flat) > MANY:
            rest.append(cls(f"and {len(flat) - MANY:,} more mistakes"))
        first.others = tuple(rest)
        return first

    def of(self, name: str) -> "ConfigError":
        """The error with the name of the sensor in front, unless it names a place in a file already."""
        return self if self.at else ConfigError(f"{name}: {self}")


class SceneError(LidarcfgError):
    """A scene cannot be built, for example because it is empty."""


class PacketError(LidarcfgError):
    """A capture cannot be used: not a pcap, no LiDAR packets, another model."""


class CloudError(LidarcfgError):
    """A point cloud cannot be read, written or shown."""


class ConversionError(LidarcfgError):
    """The format cannot hold the input, or the output cannot be written."""


def missing(library: str) -> ConversionError:
    """The error for a `library` of an extra that is not installed."""
    return ConversionError(f"{library} is not installed; pip install 'lidarcfg[convert]'")
