"""Which sensors a study mounts, and within which bounds: a slot for each sensor, in the order of the file's groups.

Where a study lets one choose models, a slot has them with their prices.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg.config.models import NAME_MAX, error_at
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import FIRST_HOST, HOSTS, RETURN_MODE, Mount, default_rpm, ports, resolve_sensor
from lidarcfg.sensors.sensor import Sensor, catalogue
from lidarcfg.study.file import NONE, GroupFile, StudyFile
from lidarcfg.study.surfaces import Surface, on_surface
from lidarcfg.vsr.cones import Lidar, placed, sensor_lidar
from lidarcfg.world.vehicle import Vehicle

BETWEEN_DEG = 10.0  # how much less a sensor may tilt between the places of its surface that were tried


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
    prices = file.prices or {}
    found = []
    errors: list[ConfigError] = []
    for i, group in enumerate(file.sensors):
        choices: list[Choice | None] = []
        for n, name in enumerate(group.choose or (group.model or "",)):
            if name == NONE:
                choices.append(None)
                continue
            at = ("choose", n) if group.choose else ()
            try:
                sensor, model = resolve_sensor(path, i, name, None, *at)
            except ConfigError as error:
                errors.append(error)
                continue
            if sensor in [choice.sensor for choice in choices if choice]:
                raise error_at(path, ("sensors", i, *at), f"{name!r} is a choice already under another name")
            choices.append(Choice(model or name, sensor, prices[name]))
        found.append(tuple(choices))
    if errors:
        raise ConfigError.all_of(errors)
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


@dataclass(frozen=True)
class Slot:
    """A sensor to mount, and where it may be."""

    name: str
    sensor: Sensor
    model: str | None  # its name in files; None: its beams are given inline
    lower: tuple[float, ...]  # x, y, z, roll, pitch, yaw, in metres and radians; on a surface those of its box
    upper: tuple[float, ...]  # equal to lower: a fixed value
    image_y_m: float | None = None  # the plane that mirrors the sensor before into this one
    range_m: tuple[float, float] | None = None  # least, greatest; None: the sensor's
    azimuth_fov_deg: tuple[float, float] | None = None  # from, to, clockwise; None: all around
    surface: Surface | None = None  # that it sits on; None: it may be anywhere within its bounds
    choices: Choices = ()  # in a study with choices the models it may be of; its own stands for them

    @cached_property
    def lidar(self) -> Lidar:
        """The slot's LiDAR at the vehicle's origin."""
        return sensor_lidar(self.sensor, self.range_m, self.azimuth_fov_deg)

    def mount(self, number: int, x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> Mount:
        """Its sensor at a pose; the addresses of sensors differ by their numbers."""
        data_port, telemetry_port = ports(self.sensor)
        return Mount(
            name=self.name,
            sensor=self.sensor,
            position_m=(x, y, z),
            rpy_rad=(roll, pitch, yaw),
            model=self.model,
            host=str(FIRST_HOST + number),
            data_port=data_port + number,
            telemetry_port=telemetry_port + number,
            rpm=default_rpm(self.sensor),
            return_mode=RETURN_MODE,
            azimuth_fov_deg=self.azimuth_fov_deg,
            range_m=self.range_m,
        )


def lidars_at(slots: Sequence[Slot], poses: Array) -> tuple[Lidar, ...]:
    """The LiDARs of slots at poses (slots, 6)."""
    return tuple(placed(slot.lidar, row[:3], row[3:]) for row, slot in zip(poses, slots, strict=True))


def mounts_at(slots: Sequence[Slot], poses: Array) -> tuple[Mount, ...]:
    """The mounts of slots at poses (slots, 6); every sensor with an address and ports of its own."""
    return tuple(slot.mount(i, *row) for i, (row, slot) in enumerate(zip(poses.tolist(), slots, strict=True)))


def all_sensors(slots: Sequence[Slot]) -> list[Sensor]:
    """The sensors of slots, and all models to choose from."""
    chosen = [choice.sensor for slot in slots for choice in slot.choices if choice]
    return [slot.sensor for slot in slots] + chosen


def boxes_m(slots: Sequence[Slot]) -> list[tuple[Array, Array]] | None:
    """The lower and the upper corner (3,) of the box in which each may be; None if some sit on a surface."""
    if any(slot.surface for slot in slots):
        return None
    out = []
    for slot in slots:
        corners = np.array([slot.lower[:3], slot.upper[:3]])
        if slot.image_y_m is not None:
            corners[:, 1] = 2 * slot.image_y_m - corners[::-1, 1]
        out.append((corners[0], corners[1]))
    return out


def _given_sensors(file: StudyFile, choices: list[Choices], path: Path) -> dict[int, tuple[Sensor, str | None]]:
    """The sensors, and their models in files, of the groups without choices, by group. Raises ConfigError."""
    found: dict[int, tuple[Sensor, str | None]] = {}
    errors: list[ConfigError] = []
    for i, (group, models) in enumerate(zip(file.sensors, choices, strict=True)):
        if not any(models):
            try:
                found[i] = resolve_sensor(path, i, group.model, group.elevation_deg)
            except ConfigError as error:
                errors.append(error)
    if errors:
        raise ConfigError.all_of(errors)
    return found


def slots_of(file: StudyFile, choices: list[Choices], bodies: Vehicle | None, path: Path) -> tuple[Slot, ...]:
    """The slots of a file's groups; `choices` by group. Raises ConfigError."""
    found: list[Slot] = []
    given = _given_sensors(file, choices, path)
    for i, (group, models) in enumerate(zip(file.sensors, choices, strict=True)):
        offered = tuple(
            choice and replace(choice, surface=_surface(file, bodies, choice.sensor, path, i)) for choice in models
        )
        one = next((choice for choice in offered if choice), None)
        sensor, model = (one.sensor, one.model) if one else given[i]
        surface = one.surface if one else _surface(file, bodies, sensor, path, i)
        for choice in filter(None, offered):
            _fov_deg(choice.sensor, group, path, i)
        fov_deg = _fov_deg(sensor, group, path, i)
        for number in range(group.count):
            name = slot_name(group.name, group.count, number, len(found))
            if name in [slot.name for slot in found]:
                raise error_at(path, ("sensors", i), f"two are called {name!r}; give each group its own name")
            if len(name) > NAME_MAX:
                what = f"makes a sensor's name of {len(name)} characters; allowed: at most {NAME_MAX}"
                raise error_at(path, ("sensors", i, "name"), what)
            image = group.mirror_y_m is not None and number % 2 == 1
            own_surface = surface.image if surface and image else surface
            found.append(
                Slot(
                    name=name,
                    sensor=sensor,
                    model=model,
                    lower=group.bounds[0],
                    upper=group.bounds[1],
                    image_y_m=group.mirror_y_m if image else None,
                    range_m=group.range_m,
                    azimuth_fov_deg=fov_deg,
                    surface=own_surface,
                    choices=offered,
                )
            )
    if len(found) > HOSTS:
        raise error_at(path, ("sensors",), f"has {len(found)} sensors; allowed: at most {HOSTS}")
    return tuple(found)


def _surface(file: StudyFile, bodies: Vehicle | None, sensor: Sensor, path: Path, i: int) -> Surface | None:
    """The surface that group i's sensors sit on, if any. Raises ConfigError, also if they tilt too much everywhere."""
    group = file.sensors[i]
    if not (group.on and bodies):
        return None
    surface = on_surface(group.on, bodies, sensor, group.mirror_y_m, path, ("sensors", i, "on"))
    limit_deg = file.constraints.max_tilt_deg
    least_deg = math.degrees(surface.patch.least_tilt_rad)
    if not group.on.upright and NONE not in (group.choose or ()) and least_deg > limit_deg + BETWEEN_DEG:
        what = f"{limit_deg:g} is impossible: sensors[{i}] tilts by {least_deg:.4g} or more wherever its base was tried"
        raise error_at(path, ("constraints", "max_tilt_deg"), what)
    return surface


def _fov_deg(sensor: Sensor, group: GroupFile, path: Path, i: int) -> tuple[float, float] | None:
    """The horizontal field of view of a sensor of the group; None: all around."""
    try:
        return sensor.field_of_view_deg(group.azimuth_fov_deg)
    except ValueError as error:
        raise error_at(path, ("sensors", i, "azimuth_fov_deg"), str(error)) from None


def slot_name(group: str | None, count: int, number: int, before: int) -> str:
    """The name of a group's sensor, by its number in the group and in the study."""
    if group is None:
        return f"lidar_{before}"
    return f"{group}_{number}" if count > 1 else group


def check_bounds(file: StudyFile, path: Path, bodies: Vehicle) -> None:
    """Raises ConfigError where a sensor could only be placed inside a body."""
    for i, group in enumerate(file.sensors):
        low, high = (np.array(bound[:3]) for bound in group.bounds)
        name = None if bodies.allow_inside or group.on else bodies.body_containing(low, high)
        if name:
            what = (
                f"every place within its bounds is inside the vehicle's {name!r}; move them, or set allow_inside: true"
            )
            raise error_at(path, ("sensors", i), what)
