"""Loading a study: its file's values, with defaults filled in and all files that it names."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from lidarcfg.config.models import Given, error_at, errors_at, load_or_check, whole_values
from lidarcfg.errors import ConfigError
from lidarcfg.requirements.file import entries_of
from lidarcfg.requirements.kind import Context, Entry, VehicleSite
from lidarcfg.requirements.resolved import Requirements, resolved
from lidarcfg.returns.misses import Misses, MissesFile
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.study.file import NONE, StudyFile, VisibilityFile
from lidarcfg.study.mounting import (
    Choices,
    Slot,
    all_sensors,
    boxes_m,
    check_bounds,
    choices_of,
    model_name,
    resolved_prices,
    slots_of,
)
from lidarcfg.study.objective import Objective, without_cones
from lidarcfg.study.return_counts import DetectionTarget, detection_target, target
from lidarcfg.study.study import Study
from lidarcfg.study.terms.misses import MissesTerm
from lidarcfg.study.zones import Zone, zone
from lidarcfg.vsr.detection import check_places
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.visibility import Visibility
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import NO_OBSTACLES, Obstacles
from lidarcfg.world.vehicle import Vehicle, vehicle


def load_study(given: Given) -> Study:
    """The study in a YAML file, or of a dict with its keys. Raises ConfigError with file, line and key."""
    return study_of(*load_or_check(given, StudyFile))


def study_of(file: StudyFile, path: Path) -> Study:
    """The study of a file's values. Errors name `path`, and paths in the file are relative to it."""
    choices = choices_of(file, path)
    bodies = vehicle(file.vehicle, path) if file.vehicle else None
    slots = slots_of(file, choices, bodies, path)
    region = Region.from_file(file.region)
    if not region.included.any():
        raise error_at(path, ("region", "exclude"), "leaves no cuboid in the region")
    if bodies:
        region = region.without(bodies)
        if not region.included.any():
            whole = error_at(path, ("vehicle",), "leaves no cuboid in the region")
            raise ConfigError.all_of([whole, *map(ConfigError, bodies.warnings)])
        check_bounds(file, path, bodies)
    surroundings = _surroundings(file, path)
    zones = _zones(file, region, path)
    if file.robust:
        with errors_at(path, "robust", "lost"):
            file.robust.check(len(slots))
    detection_targets = _detection_targets(file, region, path)
    found = entries_of(file.requirements or (), path)
    seen = _visibility(file, region, bodies, surroundings)
    only_required = False
    if "objective" not in file.model_fields_set:
        if bodies:
            file = file.model_copy(update={"objective": Objective({MissesTerm.key: MissesFile()})})
        else:
            only_required = bool(found)
    if fault := without_cones(file.objective, file.detection, only_required, all_sensors(slots)):
        raise error_at(path, *fault)
    required = _requirements(file, found, slots, region, bodies, seen, path)
    study = Study(
        name=path.stem,
        region=region,
        slots=slots,
        solver=file.solver,
        objective=file.objective,
        constraints=file.constraints,
        detection=file.detection,
        vehicle=bodies,
        surroundings=surroundings,
        visibility=seen,
        robust=file.robust,
        requirements=required,
        only_required=only_required,
        zones=zones,
        detection_targets=detection_targets,
        misses=_misses(file, bodies, seen, region, path),
        file=_resolved(file, found, slots, choices, path),
    )
    if detection_targets:
        check_firing(study, path)
    return study


def check_firing(study: Study, path: Path) -> None:
    """Raises ConfigError for sensors of a study's file of which it is not known how they fire, if that counts."""
    if not (study.detection_targets or study.requirements or study.objective.misses):
        return
    only_misses = not (study.detection_targets or study.requirements)
    groups = [number for number, group in enumerate(study.file["sensors"]) for _ in range(group["count"])]
    for mount, slot, number in zip(study.rig(study.space.lower).mounts, study.slots, groups, strict=True):
        for sensor in [choice.sensor for choice in slot.choices if choice] or [slot.sensor]:
            try:
                scanners_of([replace(mount, sensor=sensor)])
            except ConfigError as error:
                what = f"{error}{'; or give the study objective: {max_vsr: 1}' * only_misses}"
                raise error_at(path, ("sensors", number), what) from None


def _surroundings(file: StudyFile, path: Path) -> Scene | None:
    """The study's surroundings."""
    scene = None
    if file.surroundings is not None:
        with errors_at(path, "surroundings"):
            scene = load_scene(path.parent / file.surroundings)
    return scene


def _zones(file: StudyFile, region: Region, path: Path) -> tuple[Zone, ...]:
    found = []
    for i, given in enumerate(file.zones):
        with errors_at(path, "zones", i):
            found.append(zone(given, region))
    return tuple(found)


def _detection_targets(file: StudyFile, region: Region, path: Path) -> tuple[DetectionTarget, ...]:
    """The objects that are detected by returns. Raises ConfigError for any object that the region does not hold."""
    found: dict[tuple[object, ...], DetectionTarget] = {}  # of those that look alike, the first
    every = []
    for i, item in enumerate(file.detection):
        with errors_at(path, "detection", i, *(("mesh",) if item.mesh else ())):
            if item.returns:
                if item.appearance not in found:
                    found[item.appearance] = detection_target(region, item, target(item, region, path.parent))
                every.append(replace(found[item.appearance], item=item))
            else:
                check_places(item, region)
    return tuple(every)


def _visibility(file: StudyFile, region: Region, bodies: Vehicle | None, scene: Scene | None) -> Visibility | None:
    """What limits the sensors' sight, if anything does."""
    if not file.limits_sight:
        return None
    given = file.visibility or VisibilityFile()
    scenes = [*([bodies.scene] if bodies else []), *([scene] if scene else [])]
    return Visibility.of(scenes if given.occlusion else [], region, given.range, given.field_of_view)


def _ground(seen: Visibility | None, region: Region) -> tuple[Obstacles, float]:
    """What blocks beams, and the height on which objects stand: the surroundings' ground, or the region's floor."""
    obstacles = seen.obstacles if seen else NO_OBSTACLES
    return obstacles, obstacles.ground_m if math.isfinite(obstacles.ground_m) else float(region.min_m[2])


def _misses(
    file: StudyFile, bodies: Vehicle | None, seen: Visibility | None, region: Region, path: Path
) -> Misses | None:
    """What a rig may miss around the vehicle: as the objective says it, or as by default."""
    if bodies is None:
        return None
    with errors_at(path, "objective", "misses"):
        asked = file.objective.misses or MissesFile()
        return Misses.of(asked, bodies.footprint, *_ground(seen, region), path.parent)


def _requirements(
    file: StudyFile,
    found: Sequence[Entry],
    slots: Sequence[Slot],
    region: Region,
    bodies: Vehicle | None,
    seen: Visibility | None,
    path: Path,
) -> Requirements | None:
    """The study's requirements. Objects stand on the surroundings' ground, or else on the region's floor."""
    if not found:
        return None
    prices = {model_name(name, path.parent): price for name, price in (file.prices or {}).items()}
    obstacles, ground_m = _ground(seen, region)
    models = [choice.model for slot in slots for choice in slot.choices if choice] or [
        slot.model or "" for slot in slots
    ]
    site = VehicleSite.of(bodies, obstacles, ground_m, boxes_m(slots))
    return resolved(found, Context(site, file.robust, prices, len(slots), models))


def _resolved(
    file: StudyFile, found: Sequence[Entry], slots: tuple[Slot, ...], choices: list[Choices], path: Path
) -> dict[str, Any]:
    """The file's values with defaults filled in, and with the paths of models and other files resolved."""
    values = whole_values(file, path.parent)
    models = iter(slots)
    for group in values["sensors"]:
        for slot in islice(models, group["count"]):
            if "choose" in group:
                group["choose"] = [choice.model if choice else NONE for choice in slot.choices]
            elif slot.model is not None:
                group["model"] = slot.model
    if found and "objective" not in file.model_fields_set:
        del values["objective"]  # nothing but requirements counts
    if found:
        values["requirements"] = [whole_values(one.item, one.path.parent) for one in found]
    if file.prices:
        values["prices"] = resolved_prices(file, choices, path)
    return values
