"""What looks wrong with a study or a rig, though it may be meant: one line each, with file, line and key."""

import math
from collections.abc import Iterable, Iterator
from itertools import product
from pathlib import Path

import numpy as np

from lidarcfg.config.document import Key
from lidarcfg.config.models import all_errors_at, load
from lidarcfg.files import example
from lidarcfg.requirements.file import entries_of
from lidarcfg.requirements.kind import Kind
from lidarcfg.sensors.rig import MountFile, RigFile
from lidarcfg.study.file import GroupFile, PoseBound, StudyFile
from lidarcfg.study.mounting import unused_prices
from lidarcfg.study.study import Study

Suspect = tuple[Key, str]  # where something looks wrong, and what
STEPS = 5  # places along each axis of a sensor's bounds that are tried
MANY = 0.1  # of these, inside the vehicle
HIGHEST_M = 40.0  # above the ground: no vehicle carries a sensor there
RIGHT_RAD = math.pi / 4  # whole multiples of it look like radians with two decimals, too


def study_warnings(path: str | Path, study: Study) -> Iterator[str]:
    """Warnings about a study that was loaded from a file."""
    path = example(path)
    yield from map(str, all_errors_at(path, list(_of_study(load(path, StudyFile), study))))
    yield from requirement_warnings(path)


def requirement_warnings(path: str | Path) -> Iterator[str]:
    """Warnings about the requirements of a study's file."""
    path = example(path)
    for one in entries_of(load(path, StudyFile).requirements or (), path):
        for key, what in _turns(one.item):
            yield str(one.error(what, *key))


def _of_study(file: StudyFile, study: Study) -> Iterator[Suspect]:
    bounds = [bound for group in file.sensors for bound in (group.min, group.max) if bound]
    in_degrees = _are_in_degrees(bounds)
    for i, group in enumerate(file.sensors):
        for bound in ("min", "max"):
            yield from _angles(("sensors", i, bound), getattr(group, bound), in_degrees)
        yield from _heights(i, group, file.region.min_m[2])
        yield from _places(i, group, study)
    for model in unused_prices(file):
        yield ("prices", model), "is not used: no sensor of the study may be one"


def rig_warnings(path: str | Path, ground_m: float = 0.0) -> Iterator[str]:
    """Warnings about a rig's file; the ground is at this height of the vehicle frame."""
    path = example(path)
    yield from map(str, all_errors_at(path, list(_of_rig(load(path, RigFile), ground_m))))


def _of_rig(file: RigFile, ground_m: float) -> Iterator[Suspect]:
    in_degrees = _are_in_degrees(file.sensors)
    for i, mount in enumerate(file.sensors):
        yield from _angles(("sensors", i), mount, in_degrees)
        yield from _height(("sensors", i, "position_m", 2), mount.position_m[2], ground_m, "")


def _angles(at: Key, item: PoseBound | MountFile | None, in_degrees: bool) -> Iterator[Suspect]:
    """Degrees that look like radians, and the reverse; `in_degrees`: others of the file are degrees."""
    if item is None:
        return
    if item.rpy_rad and max(map(abs, item.rpy_rad)) > 2 * math.pi + 1e-6:
        yield (*at, "rpy_rad"), f"{list(item.rpy_rad)} is more than a turn; degrees go to rpy_deg"
    suspects = [angle for angle in item.rpy_deg or () if _is_in_radians(angle, in_degrees)]
    if not suspects:
        return
    what = f"{suspects[0]:g} looks like {math.degrees(suspects[0]):.0f}° in radians"
    if max(map(abs, item.rpy_deg or ())) <= math.pi + 1e-3:
        yield (*at, "rpy_deg"), f"{what}, which go to rpy_rad"
    else:
        yield (*at, "rpy_deg"), f"{what}, beside others that are degrees"


def _turns(item: Kind) -> Iterator[Suspect]:
    """Angles of a requirement that look like radians."""
    for key in type(item).model_fields:
        turns = (getattr(item, key) or ()) if key.endswith("_deg") else ()
        in_degrees = any(abs(angle) > 2 * math.pi for angle in turns)
        suspects = [angle for angle in turns if _is_in_radians(angle, in_degrees)]
        if suspects:
            yield (key,), f"{suspects[0]:g} looks like {math.degrees(suspects[0]):.0f}° in radians; give degrees"


def _are_in_degrees(items: Iterable[PoseBound | MountFile]) -> bool:
    """Whether any of these angles is too large to be in radians."""
    return any(abs(angle) > 2 * math.pi for item in items for angle in item.rpy_deg or ())


def _is_in_radians(angle: float, in_degrees: bool) -> bool:
    """Whether an angle is a multiple of 15° in radians, with three decimals or more.

    Beside others in degrees also one of 45°, with two.
    """
    if in_degrees and round(angle, 2) == angle and angle != round(angle, 1):
        steps = round(angle / RIGHT_RAD)
        return steps != 0 and angle == round(steps * RIGHT_RAD, 2)
    steps = round(angle / (math.pi / 12))
    return steps != 0 and abs(angle - steps * math.pi / 12) < 6e-4 and angle != round(angle, 2)


def _heights(index: int, group: GroupFile, ground_m: float) -> Iterator[Suspect]:
    """Bounds below the ground, which is the region's floor, or far above it."""
    if group.min and group.max:
        for bound, pose in (("min", group.min), ("max", group.max)):
            yield from _height(("sensors", index, bound, "position_m", 2), pose.position_m[2], ground_m, " bound")


def _height(at: Key, z_m: float, ground_m: float, what: str) -> Iterator[Suspect]:
    """A place below the ground, or so far above it that it is in another unit or frame."""
    if z_m < ground_m:
        yield at, f"this{what} is {ground_m - z_m:g} m below the ground, which is at z = {ground_m:g}"
    elif z_m - ground_m > HIGHEST_M:
        yield at, f"this{what} is {z_m - ground_m:g} m above the ground; are these metres?"


def _places(index: int, group: GroupFile, study: Study) -> Iterator[Suspect]:
    """Bounds that cut through a body, where no sensor may be."""
    if group.min is None or group.max is None or study.vehicle is None or study.vehicle.allow_inside:
        return
    axes = zip(group.min.position_m, group.max.position_m, strict=True)
    grid = np.array(list(product(*(np.unique(np.linspace(low, high, STEPS)) for low, high in axes))))
    count = int((study.vehicle.depth_m(grid) > 0).sum())
    if count >= MANY * len(grid):
        where = "inside the vehicle, where no sensor may be"
        yield ("sensors", index), f"{count / len(grid):.0%} of the places within its bounds are {where}"
