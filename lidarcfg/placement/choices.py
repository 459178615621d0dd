"""The models that a study lets one choose from, and their prices."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lidarcfg.config.models import error_at
from lidarcfg.placement.study_file import NONE, StudyFile
from lidarcfg.placement.surfaces import Surface
from lidarcfg.sensors.rig import resolve_sensor
from lidarcfg.sensors.sensor import Sensor, catalogue


@dataclass(frozen=True)
class Choice:
    """A model that may be chosen for a sensor."""

    model: str  # its name in files
    sensor: Sensor
    price: float
    surface: Surface | None = None  # the surface that it sits on, with its own base


Choices = tuple[Choice | None, ...]  # None: no sensor


def choices_of(file: StudyFile, path: Path) -> list[Choices]:
    """The models of each group: those to choose from, or the one that is given; empty if no group has a choice.

    Raises ConfigError for models that are not known, and for two names of one model.
    """
    if all(group.choose is None for group in file.sensors):
        return [() for _ in file.sensors]
    prices, found = file.prices or {}, []
    for i, group in enumerate(file.sensors):
        choices: list[Choice | None] = []
        for n, name in enumerate(group.choose or (group.model or "",)):
            if name == NONE:
                choices.append(None)
                continue
            at = ("choose", n) if group.choose else ()
            sensor, model = resolve_sensor(path, i, name, None, *at)
            if sensor in [choice.sensor for choice in choices if choice]:
                raise error_at(path, ("sensors", i, *at), f"{name!r} is a choice already under another name")
            choices.append(Choice(model or name, sensor, prices[name]))
        found.append(tuple(choices))
    return found


def model_name(name: str, folder: Path) -> str:
    """A model as resolved files name it: a name of the catalogue, or an absolute path."""
    path = folder / name
    return name if name in catalogue() or not path.exists() else os.path.realpath(path)


def resolved_prices(file: StudyFile, choices: list[Choices], path: Path) -> dict[str, Any]:
    """The prices, with models named as in resolved files."""
    names = [group.choose or (group.model,) for group in file.sensors]
    known = {
        name: choice.model
        for group, of_group in zip(names, choices, strict=True)
        for name, choice in zip(group, of_group, strict=False)
        if name and choice
    }
    return {known.get(name) or model_name(name, path.parent): price for name, price in (file.prices or {}).items()}


def unused_prices(file: StudyFile) -> list[str]:
    """The models that have a price but that no sensor may be of."""
    used = {model for group in file.sensors for model in group.choose or (group.model,)}
    return [model for model in file.prices or {} if model not in used]
