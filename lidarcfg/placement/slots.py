"""The sensors that a study places: one slot each, in the order of its groups, and the bounds of their poses."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lidarcfg.config.models import NAME_MAX, error_at
from lidarcfg.geometry import Array
from lidarcfg.placement.choices import Choices
from lidarcfg.placement.cones import Lidar, sensor_lidar
from lidarcfg.placement.study_file import NONE, GroupFile, StudyFile
from lidarcfg.placement.surfaces import Surface, on_surface
from lidarcfg.sensors.rig import HOSTS, resolve_sensor
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.world.vehicle import Vehicle

BETWEEN_DEG = 10.0  # by so much a sensor may tilt less between the places of its surface that were tried


@dataclass(frozen=True)
class Slot:
    """One sensor to place."""

    name: str
    sensor: Sensor
    model: str | None  # its name in files; None: its beams are given inline
    range_m: tuple[float, float] | None = None  # least, greatest; None: the sensor's
    azimuth_fov_deg: tuple[float, float] | None = None  # from, to, clockwise; None: all around
    surface: Surface | None = None  # that it sits on; None: it may be anywhere within its bounds
    choices: Choices = ()  # in a study with choices the models it may be of; its own stands for them

    @cached_property
    def lidar(self) -> Lidar:
        """Its LiDAR at the vehicle's origin."""
        return sensor_lidar(self.sensor, self.range_m, self.azimuth_fov_deg)


@dataclass(frozen=True)
class Slots:
    """All slots of a study."""

    slots: tuple[Slot, ...]
    group: tuple[int, ...]  # the group of each
    lower: Array  # (slots, 6), see Study
    upper: Array  # (slots, 6)
    mirror: Array  # (slots,)

    @property
    def boxes_m(self) -> list[tuple[Array, Array]] | None:
        """The lower and the upper corner (3,) of the box in which each may be; None if some sit on a surface."""
        if any(slot.surface for slot in self.slots):
            return None
        out = []
        for low, high, y_m in zip(self.lower[:, :3], self.upper[:, :3], self.mirror, strict=True):
            corners = np.stack([low, high])
            if not math.isnan(y_m):
                corners[:, 1] = 2 * y_m - corners[::-1, 1]
            out.append((corners[0], corners[1]))
        return out


def slots_of(file: StudyFile, choices: list[Choices], bodies: Vehicle | None, path: Path) -> Slots:
    """The slots of a file's groups; `choices` by group. Raises ConfigError."""
    found: list[Slot] = []
    lower, upper, mirror, member = [], [], [], []
    for i, (group, models) in enumerate(zip(file.sensors, choices, strict=True)):
        offered = tuple(
            choice and replace(choice, surface=_surface(file, bodies, choice.sensor, path, i)) for choice in models
        )
        one = next((choice for choice in offered if choice), None)
        sensor, model = (one.sensor, one.model) if one else resolve_sensor(path, i, group.model, group.elevation_deg)
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
            seat = surface.image if surface and image else surface
            found.append(Slot(name, sensor, model, group.range_m, fov_deg, seat, offered))
            member.append(i)
            lower.append(group.bounds[0])
            upper.append(group.bounds[1])
            mirror.append(group.mirror_y_m if image else math.nan)
    if len(found) > HOSTS:
        raise error_at(path, ("sensors",), f"has {len(found)} sensors; allowed: at most {HOSTS}")
    low, high, plane = (np.array(values, np.float64) for values in (lower, upper, mirror))
    return Slots(tuple(found), tuple(member), low, high, plane)


def _surface(file: StudyFile, bodies: Vehicle | None, sensor: Sensor, path: Path, i: int) -> Surface | None:
    """The surface that group i's sensors sit on, if any. Raises ConfigError, also if they tilt too much everywhere."""
    group = file.sensors[i]
    if not (group.on and bodies):
        return None
    surface = on_surface(group.on, bodies, sensor, group.mirror_y_m, path, ("sensors", i, "on"))
    limit_deg, least_deg = file.constraints.max_tilt_deg, math.degrees(surface.patch.least_tilt_rad)
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
        name = None if bodies.allow_inside or group.on else bodies.holds(low, high)
        if name:
            what = (
                f"every place within its bounds is inside the vehicle's {name!r}; move them, or set allow_inside: true"
            )
            raise error_at(path, ("sensors", i), what)
