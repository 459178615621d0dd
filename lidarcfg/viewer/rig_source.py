"""The file that a rig came from: changed poses are written into its text; everything else stays as it is."""

import math
import os
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import lidarcfg
from lidarcfg.config.models import loads
from lidarcfg.errors import ConfigError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import RigFile, angles_rad

EXACT = 1e-12  # metres and radians, to which written poses read back
ELSE = "download the rig instead"
Edit = tuple[int, int, str]  # from, to, the text between them


@dataclass(frozen=True)
class RigSource:
    """A rig's file as it was when it was read."""

    path: Path
    text: str

    @classmethod
    def read(cls, path: Path) -> "RigSource | None":
        """The source at a path; None unless it is a regular file. Raises OSError."""
        return cls(path, path.read_bytes().decode("utf-8", "replace")) if path.is_file() else None

    def save(self, poses: Array) -> "RigSource":
        """Write the file with other poses (mounts, 6) in metres and radians, in its place; returns the new source.

        Raises ConfigError if the file has changed since it was read, or its text cannot take them, and OSError.
        """
        real = Path(os.path.realpath(self.path))
        if real.is_relative_to(Path(lidarcfg.__file__).parent):
            raise ConfigError(f"{self.path}: comes with lidarcfg and is not changed; {ELSE}")
        if not self._is_unchanged():
            raise ConfigError(f"{self.path}: has changed on disk since it was opened; nothing is written; {ELSE}")
        changed = replace(self, text=self._text_with(poses))
        with replacing(self.path, "wb") as file:
            file.write(changed.text.encode())
        return changed

    def _is_unchanged(self) -> bool:
        """Whether the file is unchanged; a file of another size is not read."""
        text = self.text.encode()
        return self.path.is_file() and self.path.stat().st_size == len(text) and self.path.read_bytes() == text

    def _text_with(self, poses: Array) -> str:
        """The text with other poses. Raises ConfigError."""
        before = _poses(self.text, self.path)
        root = yaml.compose(self.text, yaml.SafeLoader)
        uses = Counter(_uses(root))
        edits = list[Edit]()
        for i, (old, new) in enumerate(zip(before, poses.tolist(), strict=True)):
            mapping = _value(root, "sensors").value[i]
            edits += self._edits(_value(mapping, "position_m"), old[:3], new[:3], uses)
            if old[3:] != new[3:]:
                name = next((key for key in ("rpy_deg", "rpy_rad") if _has_list(mapping, key)), None)
                numbers = [_degrees(angle) for angle in new[3:]] if name != "rpy_rad" else new[3:]
                if name:
                    shown = [_degrees(angle) for angle in old[3:]] if name == "rpy_deg" else old[3:]
                    edits += self._edits(_value(mapping, name), shown, numbers, uses)
                else:
                    edits.append(self._inserted(mapping, numbers))
        text = self.text
        for first, last, instead in sorted(edits, reverse=True):
            text = text[:first] + instead + text[last:]
        try:
            if np.allclose(_poses(text, self.path), poses, rtol=0, atol=EXACT):
                return text
        except ConfigError:
            pass
        raise ConfigError(f"{self.path}: its text cannot take other poses; {ELSE}")

    def _edits(self, numbers: Any, old: list[float], new: list[float], uses: Counter[int]) -> list[Edit]:
        """The edits of the numbers that change in a list. Raises ConfigError for a number that an alias shares."""
        edits = []
        for node, before, after in zip(numbers.value, old, new, strict=True):
            if before != after:
                if uses[id(node)] > 1:
                    where = f"{self.path}:{node.start_mark.line + 1}"
                    raise ConfigError(f"{where}: an anchor, which other keys refer to, is not changed; {ELSE}")
                edits.append((node.start_mark.index, node.end_mark.index, repr(after)))
        return edits

    def _inserted(self, mapping: Any, angles_deg: list[float]) -> Edit:
        """The edit that inserts angles before the position of a sensor without angles."""
        key = next(key for key, _ in mapping.value if key.value == "position_m")
        at = key.start_mark.index
        quote = '"' if key.style else ""
        end = ", " if mapping.flow_style else ("\r\n" if "\r\n" in self.text else "\n") + " " * key.start_mark.column
        return at, at, f"{quote}rpy_deg{quote}: [{', '.join(map(repr, angles_deg))}]{end}"


def _poses(text: str, path: Path) -> list[list[float]]:
    """x, y, z, roll, pitch, yaw of each sensor, as the text says them. Raises ConfigError."""
    sensors = loads(text.removeprefix("\ufeff"), RigFile, str(path)).sensors
    return [[*one.position_m, *angles_rad(one.rpy_rad, one.rpy_deg)] for one in sensors]


def _uses(node: Any) -> list[int]:
    """The ids of all nodes, each as often as it is used."""
    found = [id(node)]
    if isinstance(node, yaml.MappingNode):
        return found + [one for pair in node.value for part in pair for one in _uses(part)]
    return found + [one for part in node.value for one in _uses(part)] if isinstance(node, yaml.SequenceNode) else found


def _has_list(mapping: Any, key: str) -> bool:
    return any(name.value == key and isinstance(value, yaml.SequenceNode) for name, value in mapping.value)


def _value(mapping: Any, key: str) -> Any:
    return next(value for name, value in mapping.value if name.value == key)


def _degrees(angle_rad: float) -> float:
    """The shortest number of degrees that is read as this angle, or the nearest."""
    exact = math.degrees(angle_rad)
    near = [round(exact, digits) for digits in range(16)] + [
        math.nextafter(exact, side) for side in (-math.inf, math.inf)
    ]
    return next((one for one in near if math.radians(one) == angle_rad), exact)
