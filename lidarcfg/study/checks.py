"""What looks wrong with a study or a rig, though it may be meant: one line each, with file, line and key."""

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice, product
from pathlib import Path

import numpy as np

from lidarcfg.config.document import Key
from lidarcfg.config.models import all_errors_at, load
from lidarcfg.files import example
from lidarcfg.geometry import Array
from lidarcfg.requirements.file import entries_of
from lidarcfg.requirements.kind import Kind
from lidarcfg.returns.misses import SEARCH_PLACES
from lidarcfg.sensors.rig import MountFile, RigFile
from lidarcfg.study.file import GroupFile, PoseBound, StudyFile
from lidarcfg.study.return_counts import DetectionTarget, return_counts
from lidarcfg.study.slots import unused_prices
from lidarcfg.study.study import Study
from lidarcfg.study.terms.detection import DetectionTerm
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.metric import max_vsr
from lidarcfg.vsr.region import AXES, BoxFile, Region

Suspect = tuple[Key, str]  # where something looks wrong, and what
LINES = 10  # of one file
STEPS = 5  # places along each axis of a sensor's bounds that are tried
MANY = 0.1  # of these, inside the vehicle
SLOW = 100  # times the evaluation of max VSR
MANY_CUBOIDS = 5_000_000  # with more, an evaluation takes a tenth of a second or more
FEW_S = 0.01  # an evaluation this quick is never called slow
LONG_S = 20.0  # of processor time, to evaluate one rig
SAMPLES = (64, 512, 4096)  # of places of objects, by which that time is estimated
SURE_S = 0.5  # of them that took so long, no more are needed
HIGHEST_M = 40.0  # above the ground: no vehicle carries a sensor there
RIGHT_RAD = math.pi / 4  # whole multiples of it look like radians with two decimals, too
STEEPEST_RAD = 0.6  # no beam table is this narrow in degrees: such elevations look like radians


def study_warnings(path: str | Path, study: Study) -> Iterator[str]:
    """Warnings about a study that was loaded from a file."""
    path = example(path)
    yield from _lines(path, _of_study(load(path, StudyFile), study))
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
        yield from _elevations(("sensors", i), group)
        yield from _places(i, group, study, file.region.exclude)
    for i, box in enumerate(file.region.exclude):
        yield from _snapped(i, box, study.region)
    for model in unused_prices(file):
        yield ("prices", model), "is not used: no sensor of the study may be one"
    yield from _slow(study)
    yield from _many_returns(study)


def rig_warnings(path: str | Path, ground_m: float = 0.0) -> Iterator[str]:
    """Warnings about a rig's file; the ground is at this height of the vehicle frame."""
    path = example(path)
    yield from _lines(path, _of_rig(load(path, RigFile), ground_m))


def _lines(path: Path, found: Iterator[Suspect]) -> Iterator[str]:
    """The first warnings, a line each, and how many more there are."""
    yield from map(str, all_errors_at(path, list(islice(found, LINES))))
    if more := sum(1 for _ in found):
        yield f"{path}: {more:,} more warnings"


def _of_rig(file: RigFile, ground_m: float) -> Iterator[Suspect]:
    in_degrees = _are_in_degrees(file.sensors)
    for i, mount in enumerate(file.sensors):
        yield from _angles(("sensors", i), mount, in_degrees)
        yield from _height(("sensors", i, "position_m", 2), mount.position_m[2], ground_m, "")
        yield from _elevations(("sensors", i), mount)


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


def _elevations(at: Key, item: GroupFile | MountFile) -> Iterator[Suspect]:
    """Beams given in radians."""
    table = item.elevation_deg or ()
    if len(table) > 1 and 0 < max(map(abs, table)) < STEEPEST_RAD:
        what = f"all within {max(map(abs, table)):g}°; if these are radians, give degrees"
        yield (*at, "elevation_deg"), what


def _places(index: int, group: GroupFile, study: Study, excluded: tuple[BoxFile, ...]) -> Iterator[Suspect]:
    """Bounds that cut through a body, where no sensor may be, or that lie in an excluded part of the region."""
    if group.min is None or group.max is None:
        return
    axes = zip(group.min.position_m, group.max.position_m, strict=True)
    grid = np.array(list(product(*(np.unique(np.linspace(low, high, STEPS)) for low, high in axes))))
    if study.vehicle and not study.vehicle.allow_inside:
        count = int((study.vehicle.depth_m(grid) > 0).sum())
        if count >= MANY * len(grid):
            where = "inside the vehicle, where no sensor may be"
            what = f"{count / len(grid):.0%} of the places within its bounds are {where}"
            yield ("sensors", index), what
    for number, box in enumerate(excluded):
        inside = ((grid >= box.min_m) & (grid < box.max_m)).all(axis=1)
        if inside.any() and (study.vehicle or not inside.all()):  # the paper's sensors are inside an exclusion
            how = "are inside" if inside.all() else "reach into"
            what = f"its bounds {how} region.exclude[{number}], which blocks no beams"
            yield ("sensors", index), what


def _snapped(index: int, box: BoxFile, region: Region) -> Iterator[Suspect]:
    """Excluded boxes whose faces do not coincide with those of cuboids, and the box that each is taken for."""
    at = ("region", "exclude", index)
    taken = []
    for axis, (low, high, centres) in enumerate(zip(box.min_m, box.max_m, region.centres(), strict=True)):
        inside = centres[(centres >= low) & (centres < high)]
        if not len(inside):
            yield at, f"excludes nothing: no cuboid has its centre in it along {AXES[axis]}"
            return
        half = region.cuboid_m[axis] / 2
        given = max(low, float(region.min_m[axis])), min(high, float(region.max_m[axis]))
        if max(abs(inside[0] - half - given[0]), abs(inside[-1] + half - given[1])) > 1e-6:
            taken.append(f"{AXES[axis]} {inside[0] - half:.6g} to {inside[-1] + half:.6g}")
    if taken:
        yield at, f"excludes whole cuboids: {', '.join(taken)} m"


def _slow(study: Study) -> Iterator[Suspect]:
    """A region of which one evaluation takes long, or an objective that takes a hundred times as long as max VSR."""
    if (cuboids := study.region.included.size) > MANY_CUBOIDS:
        what = f"{cuboids:,} cuboids: a search evaluates thousands of rigs, each in a tenth of a second or more"
        yield ("region", "cuboid_m"), f"{what}; search with larger cuboids, and evaluate with these"
        return
    if study.is_max_vsr or study.objective.is_misses:
        return
    poses: Array = study.poses(np.full((1, int(study.free.sum())), 0.5))[0]
    lidars = study.lidars(poses)
    few = study.misses.known(SEARCH_PLACES) if study.objective.misses and study.misses else None
    criterion = study.criterion(known=few)

    def seconds(what: str) -> float:
        began = time.perf_counter()
        if what == "max VSR":
            max_vsr(study.region, lidars, study.visibility)
        else:
            criterion.of(Trial(study.region, lidars, study.visibility))
        return time.perf_counter() - began

    usual = seconds("max VSR")
    own = seconds("objective") * study.rigs[0]
    if own > FEW_S and own > SLOW * usual:
        takes_s = f"{own:.2g}" if own < 10 else f"{own:,.0f}"
        what = f"one evaluation takes {takes_s} s, {own / usual:.0f} times that of max_vsr"
        cheaper = _cheaper(study)
        key = "robust" if study.objective.is_max_vsr else "objective"
        yield (key,), f"{what}; {cheaper} cost less"


def _cheaper(study: Study) -> str:
    """What would make an evaluation faster: where returns are counted, fewer places; elsewhere cuboids."""
    if any(one.item.name in study.objective.given.get(DetectionTerm.key, {}) for one in study.detection_targets):
        return "a larger step_m or fewer headings_deg" + " or fewer samples" * bool(study.robust)
    return "coarser cuboids or fewer, larger objects" + " or fewer samples" * bool(study.robust)


def _many_returns(study: Study) -> Iterator[Suspect]:
    """Objects with too many places to count a rig's returns quickly, estimated from a part of the places."""
    unlike = {one.item.appearance: one for one in study.detection_targets}.values()
    if not unlike:
        return
    rig = study.rig(study.midpoint)
    total = sum(len(one.places) for one in unlike)
    scanners = study.scanners(rig.mounts)
    lidars = rig_lidars(rig)

    def seconds(objects: list[DetectionTarget]) -> float:
        began = time.process_time()
        return_counts(objects, scanners, lidars, study.obstacles)
        return time.process_time() - began

    for count in SAMPLES:
        some = [_thinned(one, -(-total // count)) for one in unlike]
        took_s = seconds(some)
        if took_s > SURE_S:
            break
    all_s = took_s * total / sum(len(one.places) for one in some)
    if all_s > LONG_S:
        objects = f"{len(study.detection_targets)} object{'s' * (len(study.detection_targets) > 1)} at {total:,} places"
        what = f"{objects}: their returns to {len(lidars)} LiDAR{'s' * (len(lidars) > 1)} take"
        cheaper = "a larger step_m, and fewer headings_deg or samples, cost less"
        yield ("detection",), f"{what} about {all_s:,.0f} s of processor time for each rig evaluated; {cheaper}"


def _thinned(one: DetectionTarget, every: int) -> DetectionTarget:
    """The object at each `every`-th of its places."""
    return replace(one, places=np.ascontiguousarray(one.places[::every]), part=one.part[::every])
