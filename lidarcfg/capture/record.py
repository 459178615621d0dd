"""What a capture was made of, in a file beside it, so that nothing has to be said again to decode it."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import yaml

import lidarcfg
from lidarcfg.config import Model, Positive, error_at, load
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, replacing
from lidarcfg.rig import ReturnMode

SUFFIX = ".yaml"  # behind the capture's name: a rig may be called as the capture is
READ = 1 << 20  # bytes of a file at once


class Input(Model):
    """A file that went into a capture."""

    file: str  # relative to the record
    sha256: str

    @classmethod
    def of(cls, path: Path, record: Path) -> "Input":
        """The file at `path`, as a record names it. Raises OSError."""
        digest, path = hashlib.sha256(), example(path)
        with open(path, "rb") as file:
            while part := file.read(READ):
                digest.update(part)
        return cls(file=os.path.relpath(path.resolve(), record.parent.resolve()), sha256=digest.hexdigest())


class Record(Model):
    """What a capture was made of."""

    kind: ClassVar[str] = "record of a capture"
    version: str = lidarcfg.__version__
    rig: Input
    scene: Input
    trajectory: Input | None = None
    vehicle: Input | None = None
    at: str  # X,Y,YAW_DEG: where the vehicle starts
    start: str  # ISO 8601; UTC unless it names a zone
    return_mode: ReturnMode | None = None  # none: the rig's
    duration_s: Positive

    def path(self, key: str, record: Path) -> Path | None:
        """Where one of the inputs is. Raises ConfigError if it has changed since."""
        given: Input | None = getattr(self, key)
        if given is None:
            return None
        path = record.parent / given.file
        try:
            changed = Input.of(path, record).sha256 != given.sha256
        except OSError as error:
            raise error_at(record, (key, "file"), f"{path}: {(error.strerror or str(error)).lower()}") from None
        if changed:
            raise error_at(record, (key, "file"), f"{path} has changed since the export; name what fits it: --{key}")
        return path


def record_path(capture: Path) -> Path:
    """Where the record of a capture is."""
    return capture.with_name(capture.name + SUFFIX)


def save_record(capture: Path, files: Mapping[str, Path | None], values: Mapping[str, Any]) -> None:
    """Write the record beside a capture: its input files, those that there are, and the other keys of `Record`."""
    path = record_path(capture)
    inputs = {key: Input.of(file, path) for key, file in files.items() if file}
    record = Record.model_validate({**inputs, **{key: value for key, value in values.items() if value is not None}})
    with replacing(path) as file:
        yaml.safe_dump(record.model_dump(mode="json", exclude_none=True), file, sort_keys=False, allow_unicode=True)


def load_record(capture: Path) -> Record:
    """The record beside a capture. Raises ConfigError."""
    path = record_path(capture)
    if not path.exists():
        raise ConfigError(f"{path}: there is no record of the capture; give --rig and --trajectory")
    return load(path, Record)
