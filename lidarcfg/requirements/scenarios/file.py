"""Scenarios as files say them: a vehicle and a target on their way to an impact, past parked cars."""

import math
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from lidarcfg.config.models import Model, Name, check_names, errors_at, load
from lidarcfg.config.models import validation_error as fault
from lidarcfg.errors import ConfigError
from lidarcfg.files import example, shipped
from lidarcfg.geometry import Array
from lidarcfg.returns.target import ObjectFile, ObjectOrName, Size, Target, shipped_objects, target_of

SPEED_MAX_KM_H = 300.0
TARGET = "target"  # its name in a scene

Speed = Annotated[float, Field(gt=0, le=SPEED_MAX_KM_H)]
Speeds = Annotated[tuple[Speed, ...], Field(min_length=1, max_length=100)]
Walk = Annotated[float, Field(ge=0, le=SPEED_MAX_KM_H)]
Length = Annotated[float, Field(ge=0, le=1000)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Fractions = Annotated[tuple[Fraction, ...], Field(min_length=1, max_length=100)]
Side = Literal["right", "left"]


class PathFile(Model):
    """How the target moves: across the vehicle's path, or along it, the same way as the vehicle."""

    speed_km_h: Walk = 0.0  # 0: it stands
    crosses_from: Side | None = None  # of the vehicle; none: it moves along the vehicle's path
    start_m: Length | None = None  # beside the middle of the vehicle's path; none: it has been walking for long
    gain_m: Length = 0.0  # in which it gains its speed, evenly

    @model_validator(mode="after")
    def _check(self) -> "PathFile":
        for key in ("start_m", "gain_m"):
            if getattr(self, key) and self.crosses_from is None:
                raise fault("is for targets that cross; give crosses_from", key)
        if self.crosses_from and not self.speed_km_h:
            raise fault("missing; a target that crosses moves", "speed_km_h")
        if self.gain_m and self.start_m is None:
            raise fault("needs start_m, from which the target gains its speed", "gain_m")
        return self


class CarFile(Model):
    """A parked car, a box that faces the way that the vehicle drives."""

    name: Name
    size_m: tuple[Size, Size, Size]  # length, width, height
    beside_m: Length  # between the sides of the vehicle and of the car
    before_m: Annotated[float, Field(ge=-1000, le=1000)]  # from its front to the target's nearer side at the impact
    side: Side = "right"


class ScenarioFile(Model):
    """A scenario's file."""

    kind: ClassVar[str] = "scenario"
    name: Name
    about: str = ""
    source: str = ""  # of its figures, and which of them have been read there
    unverified: str = ""  # what has not
    speeds_km_h: Speeds | None = None  # of the vehicle; none: whoever uses it says
    backwards: bool = False  # the vehicle reverses
    before_impact_s: Annotated[float, Field(gt=0, le=120)] | None = None  # when a run starts; none: 6
    from_m: Annotated[float, Field(gt=0, le=5000)] | None = None  # or how far the vehicle then is from the impact
    target: ObjectOrName
    path: PathFile = PathFile()
    impacts: Fractions = (0.5,)  # where across the vehicle's front, as a fraction of its width from its right side
    cars: tuple[CarFile, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> "ScenarioFile":
        check_names((car.name for car in self.cars), "a car", "cars")
        if self.before_impact_s is not None and self.from_m is not None:
            raise fault("conflicts with before_impact_s; give only one of them", "from_m")
        for i, car in enumerate(self.cars):
            if car.name in (TARGET, "ground"):
                raise fault(f"{car.name!r} is taken; call the car otherwise", "cars", i, "name")
        return self


@dataclass(frozen=True)
class Scenario:
    """A scenario whose target has been read."""

    file: ScenarioFile
    target: Target
    mesh: str | None  # the whole path of the target's file; none: it is a box

    @property
    def name(self) -> str:
        """As the file has it."""
        return self.file.name

    @cached_property
    def ball(self) -> tuple[Array, float]:
        """A ball that holds the target: its middle (3,), relative to the target's place, and its radius in metres."""
        low, high = self.target.box_m
        return 0.5 * (low + high), 0.5 * math.dist(low, high)


def presets() -> dict[str, Path]:
    """The scenarios that come with the package: their files by name."""
    found = {path.stem: path for path in (shipped("data") / "scenarios").glob("*.yaml")}
    return dict(sorted(found.items()))


def load_scenario(name: str, folder: Path = Path()) -> Scenario:
    """A preset by its name, or the scenario in a file relative to a folder.

    Raises ConfigError and SceneError.
    """
    if Path(name).suffix:
        path = example(folder / name)
    else:
        known = presets()
        if name.lower() not in known:
            raise ConfigError(f"no scenario is called {name!r}; allowed: {', '.join(known)}, or the path of a .yaml")
        path = known[name.lower()]
    return scenario_in(path)


def scenario_in(path: Path) -> Scenario:
    """The scenario in a file. Raises ConfigError with file, line and key."""
    file = load(path, ScenarioFile)
    with errors_at(path, "target"):
        return scenario_of(file, file.target, path.parent)


def scenario_of(file: ScenarioFile, target: ObjectFile, folder: Path) -> Scenario:
    """The scenario of a file's values with a target that a file in a folder describes. Raises ConfigError."""
    found = target_of(target, folder)
    if target.size_m:
        return Scenario(file, found, None)
    path = shipped_objects()[target.name] if target.name else folder / str(target.mesh)
    return Scenario(file, found, os.path.realpath(path))
