"""What looks wrong with a study or a rig, though it may be meant: one line each, with file, line and key."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from lidarcfg.config.document import Key
from lidarcfg.config.models import all_errors_at, load
from lidarcfg.files import example
from lidarcfg.geometry import Array
from lidarcfg.requirements.file import entries_of
from lidarcfg.requirements.kind import Kind
from lidarcfg.sensors.rig import MountFile, RigFile
from lidarcfg.study.file import GroupFile, PoseBound, StudyFile
from lidarcfg.study.mounting import unused_prices
from lidarcfg.study.study import Study
from lidarcfg.world.vehicle import Vehicle

Suspect = tuple[Key, str]  # where something looks wrong, and what
Box = tuple[Array, Array]  # its corners (3,)
STEPS = 5  # places along each axis of a sensor's bounds that are tried
MANY = 0.1  # of these, inside the vehicle
FAR_M = 10.0  # from the body: no vehicle carries a sensor there
FAR_FROM_ORIGIN_M = 40.0  # where no body is known
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
    box = _box_m(study.vehicle)
    for i, group in enumerate(file.sensors):
        for bound in ("min", "max"):
            yield from _angles(("sensors", i, bound), getattr(group, bound), in_degrees)
        yield from _bounds(i, group, file.region.min_m[2], box)
        yield from _places(i, group, study)
    for model in unused_prices(file):
        yield ("prices", model), "is not used: no sensor of the study may be one"


def rig_warnings(path: str | Path, ground_m: float = 0.0, vehicle: Vehicle | None = None) -> Iterator[str]:
    """Warnings about a rig's file; the ground is at this height of the vehicle frame."""
    path = example(path)
    yield from map(str, all_errors_at(path, list(_of_rig(load(path, RigFile), ground_m, vehicle))))


def _of_rig(file: RigFile, ground_m: float, vehicle: Vehicle | None) -> Iterator[Suspect]:
    in_degrees = _are_in_degrees(file.sensors)
    box = _box_m(vehicle)
    for i, mount in enumerate(file.sensors):
        yield from _angles(("sensors", i), mount, in_degrees)
        yield from _position(("sensors", i, "position_m"), mount.position_m, ground_m, box, mount.name)


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


def _box_m(vehicle: Vehicle | None) -> Box | None:
    """The corners (3,) of a box around a vehicle's body."""
    if vehicle is None:
        return None
    vertices_m = vehicle.scene.mesh()[0]
    return vertices_m.min(axis=0), vertices_m.max(axis=0)


def _bounds(index: int, group: GroupFile, ground_m: float, box: Box | None) -> Iterator[Suspect]:
    """Bounds below the ground, which is the region's floor, or far from the vehicle."""
    if group.min and group.max:
        for bound, pose in (("min", group.min), ("max", group.max)):
            yield from _position(("sensors", index, bound, "position_m"), pose.position_m, ground_m, box, "this bound")


def _position(at: Key, position_m: Sequence[float], ground_m: float, box: Box | None, what: str) -> Iterator[Suspect]:
    """A place below the ground, or so far from the vehicle that it is in another unit or frame."""
    low_m, high_m = box or (np.zeros(3), np.zeros(3))
    far_m = math.hypot(*np.maximum(np.maximum(low_m - position_m, position_m - high_m), 0.0))
    if far_m > (FAR_M if box else FAR_FROM_ORIGIN_M):
        origin = "the vehicle's body" if box else "the origin of the vehicle frame"
        yield at, f"{what} is {far_m:,.0f} m from {origin}; positions are in metres, in the vehicle frame"
    elif position_m[2] < ground_m:
        below_m = ground_m - position_m[2]
        yield (*at, 2), f"{what} is {below_m:g} m below the ground, which is at z = {ground_m:g}"


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
