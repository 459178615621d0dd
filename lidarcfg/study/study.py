"""A study: which sensors may be placed where, what is minimised, and how to search."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import core, maths
from lidarcfg.config.models import NAME_MAX, Given, error_at, errors_at, load_or_check, whole_values
from lidarcfg.geometry import Array, up
from lidarcfg.requirements.file import entries_of
from lidarcfg.requirements.kind import Context, Entry, VehicleSite
from lidarcfg.requirements.resolved import Requirements, resolved
from lidarcfg.requirements.robustness import Robust, mounted
from lidarcfg.returns.known import KnownReturns
from lidarcfg.returns.misses import Misses, MissesFile
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.returns.target import box_target
from lidarcfg.sensors.rig import FIRST_HOST, RETURN_MODE, RPM, Mount, Rig, ports
from lidarcfg.solvers.search import Coordinates
from lidarcfg.solvers.solver import Solver
from lidarcfg.study.file import NONE, Constraints, StudyFile, VisibilityFile, changed
from lidarcfg.study.objective import (
    EVERY_CASE,
    Criterion,
    Objective,
    without_cones,
)
from lidarcfg.study.return_counts import DetectionTarget, detection_target, target
from lidarcfg.study.slots import (
    Choices,
    Slot,
    Slots,
    center_on_upright,
    check_bounds,
    choices_of,
    freely_tilted,
    model_name,
    resolved_prices,
    slots_of,
)
from lidarcfg.study.surfaces import mirrored, violation
from lidarcfg.study.terms.misses import MissesTerm
from lidarcfg.study.terms.term import TermContext
from lidarcfg.study.trial import Trial
from lidarcfg.vsr.cones import Lidar, placed, rig_lidars
from lidarcfg.vsr.detection import DetectionObject, Distances, check_fits, from_point
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from lidarcfg.vsr.visibility import Visibility
from lidarcfg.vsr.zones import Zone, weights, zone
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.tracer import NO_OBSTACLES, Obstacles
from lidarcfg.world.vehicle import Vehicle, vehicle


@dataclass(frozen=True)
class Study:
    """A study, resolved: poses are rows of x, y, z, roll, pitch, yaw in metres and radians."""

    name: str
    region: Region
    slots: tuple[Slot, ...]
    lower: Array  # (slots, 6); on a surface those of its box, and of the angles
    upper: Array  # (slots, 6); equal to lower: a fixed value
    mirror: Array  # (slots,) the y of the plane that mirrors the sensor before into this one; else NaN
    solver: Solver
    objective: Objective = field(default_factory=Objective)
    constraints: Constraints = field(default_factory=Constraints)
    detection: tuple[DetectionObject, ...] = ()
    vehicle: Vehicle | None = None
    surroundings: Scene | None = None  # in the vehicle frame
    visibility: Visibility | None = None  # None: every LiDAR sees everything, as in the paper
    robust: Robust | None = None  # what a rig has to withstand
    requirements: Requirements | None = None  # what a rig must see
    only_required: bool = False  # whether nothing but requirements counts: there is neither an objective nor a vehicle
    zones: tuple[Zone, ...] = ()
    detection_targets: tuple[DetectionTarget, ...] = ()  # the objects that are detected by returns
    misses: Misses | None = None  # what a rig may miss around the vehicle; None: there is none
    file: dict[str, Any] = field(default_factory=dict)  # the file with its defaults filled in

    @property
    def is_max_vsr(self) -> bool:
        """Whether max VSR of the whole rig, and nothing else, is what a search minimises."""
        return self.objective.is_max_vsr and self.robust is None and not self.zones and not self.only_required

    @property
    def is_misses(self) -> bool:
        """Whether misses of the whole rig, and nothing else, are what a search minimises."""
        return self.objective.is_misses and self.robust is None and not self.only_required

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """(slots, 6) which coordinates vary independently."""
        free = (self.lower < self.upper) & np.isnan(self.mirror)[:, None]
        for i, slot in enumerate(self.slots):
            if slot.surface:
                free[i, slot.surface.axis] = False
        return free

    @property
    def groups(self) -> NDArray[np.int64]:
        """(free coordinates,) the slot of each."""
        slot: NDArray[np.int64] = np.nonzero(self.free)[0]
        return slot

    @property
    def coordinates(self) -> Coordinates:
        """The free coordinates, grouped by slot. Those of one axis with equal bounds are of one kind."""
        free = self.free
        bounds = np.stack([np.nonzero(free)[1], self.lower[free], self.upper[free]], axis=1)
        return Coordinates(self.groups, np.unique(bounds, axis=0, return_inverse=True)[1].ravel())

    def poses(self, unit: Array) -> Array:
        """Poses (n, slots, 6) of points (n, free coordinates) of the unit cube.

        1 is exactly `upper`, except for the angles that `slots.center_on_upright` rearranges.
        """
        return self._repaired(self._coordinates(center_on_upright(unit, self.freely_tilted)))

    @cached_property
    def midpoint(self) -> Array:
        """(slots, 6) poses at the midpoint of the bounds; on a surface where bases fit nearest to that."""
        found = self._coordinates(np.full((1, int(self.free.sum())), 0.5))
        for i, slot in enumerate(self.slots):
            if slot.surface and np.isnan(self.mirror[i]):
                found[0, i, :3] = slot.surface.patch.nearest_m(found[0, i, :3], slot.surface.across)
        poses: Array = self._repaired(found)[0]
        return poses

    @cached_property
    def freely_tilted(self) -> NDArray[np.int64]:
        """(n, 2) as `slots.freely_tilted`; none where the solver wants the paper's coordinates."""
        free = self.free & self.solver.is_upright_central
        return freely_tilted([slot.lidar for slot in self.slots], self.lower, self.upper, free)

    def _coordinates(self, unit: Array) -> Array:
        """(n, slots, 6) points (n, free coordinates) of the unit cube, scaled to the bounds."""
        out = np.repeat(self.lower[None], len(unit), axis=0)
        free = self.free
        low, high = self.lower[free], self.upper[free]
        out[:, free] = np.where(unit == 1.0, high, np.clip(low + unit * (high - low), low, high))
        return out

    def _repaired(self, coordinates: Array) -> Array:
        """Coordinates as poses: mirrored sensors get their images' poses, others are placed on their surfaces."""
        images = np.flatnonzero(~np.isnan(self.mirror))
        coordinates[:, images] = mirrored(coordinates[:, images - 1], self.mirror[images])
        for i, slot in enumerate(self.slots):
            if slot.surface:
                coordinates[:, i] = slot.surface.poses(coordinates[:, i])
        return coordinates

    def violation(self, poses: Array) -> Array:
        """(n,) by how much poses (n, slots, 6) violate the constraints, radians and metres added; 0 if they do not.

        Sensors off their surface violate them, and sensors inside a closed body unless the vehicle allows that.
        """
        limit_deg = self.constraints.max_tilt_deg
        least_m = self.constraints.min_distance_m
        total = np.zeros(len(poses))
        if limit_deg < 180.0:
            tilt = maths.acos(np.clip(up(poses[..., 3:])[..., 2], -1.0, 1.0))
            total += np.maximum(tilt - math.radians(limit_deg) - 1e-12, 0.0).sum(axis=1)
        for i, j in combinations(range(len(self.slots)), 2) if least_m > 0.0 else ():
            apart = np.linalg.norm(poses[:, i, :3] - poses[:, j, :3], axis=1)
            total += np.maximum(least_m - apart, 0.0)
        total += violation([slot.surface for slot in self.slots], poses)
        if self.vehicle and not self.vehicle.allow_inside:
            total += self.vehicle.depth_m(poses[..., :3].reshape(-1, 3)).reshape(len(poses), -1).sum(axis=1)
        return total

    @property
    def rigs(self) -> tuple[int, int]:
        """The number of rigs that a trial stands for, of which the worst counts, and of LiDARs in all of them."""
        lidars = len(self.slots)
        if self.robust is None:
            return 1, lidars
        kept = self.robust.kept(lidars)
        drawn = self.robust.drawn
        return len(kept) + drawn, int(kept.sum()) + drawn * lidars

    @property
    def objective_cuts(self) -> bool:
        """Whether the objective needs the subspaces: all but misses and detection by returns do."""
        return self.objective.cuts(self.detection)

    @property
    def to_choose(self) -> bool:
        """Whether models are to be chosen; the study then stands for many: see combinations.py."""
        return any(slot.choices for slot in self.slots)

    def chosen(self, numbers: Sequence[int], slots: Sequence[Slot], file: dict[str, Any]) -> "Study":
        """The study with these slots in place of its own; slot i takes the bounds of the study's slot i."""
        rows = list(numbers)
        lower = self.lower[rows]
        upper = self.upper[rows]
        mirror = self.mirror[rows]
        asked = self.requirements and self.requirements.of_slots(rows)
        return replace(self, slots=tuple(slots), lower=lower, upper=upper, mirror=mirror, requirements=asked, file=file)

    @property
    def segments(self) -> int:
        """The number of segments from a trial's sensors to cuboids, along which bodies may hide the cuboids."""
        hidden = self.visibility is not None and self.visibility.blocks
        return self.rigs[1] * int(self.region.included.sum()) * hidden

    def criterion(
        self, kept: NDArray[np.bool_] = EVERY_CASE, mounts: Sequence[Mount] = (), known: KnownReturns | None = None
    ) -> Criterion:
        """The objective for this region and these objects; with `kept`, that of the worst case of failure.

        A rig whose sensors are not the study's needs its mounts here. Misses are counted at the places of `known`
        returns; without them, at fresh ones.
        """
        context = TermContext(
            region=self.region,
            objects=self.detection,
            targets=self.detection_targets,
            weight=weights(self.zones, self.region),
            misses=self.misses,
            known=known,
            mounts=mounts or self.rig(self.lower).mounts,
        )
        return Criterion(self.objective, context, kept)

    def scanners(self, mounts: Sequence[Mount]) -> tuple[core.returns.Scanner, ...]:
        """How the mounts' sensors fire in a revolution. Raises ConfigError if that is not known."""
        return scanners_of(mounts)

    @property
    def obstacles(self) -> Obstacles:
        """The obstacles between sensors and objects."""
        return self.visibility.obstacles if self.visibility else NO_OBSTACLES

    def shadow(self, rig: Rig) -> NDArray[np.bool_]:
        """(nx, ny, nz) which cuboids bodies alone hide from all LiDARs of a rig: without bodies, one would see them."""
        if self.visibility is None:
            return np.zeros(self.region.shape, np.bool_)
        lidars = rig_lidars(rig)
        without_bodies = segment(self.region, lidars, self.visibility.transparent()).seen_by
        return np.asarray((without_bodies > 0) & (segment(self.region, lidars, self.visibility).seen_by == 0))

    @cached_property
    def reference_m(self) -> Array:
        """(2,) x and y of the vehicle: the midpoint of its bodies' bounds.

        Without a vehicle, the mean of the sensors' positions at the midpoint of their bounds.
        """
        if self.vehicle:
            flat = self.vehicle.scene.mesh()[0][:, :2]
            middle: Array = (flat.min(axis=0) + flat.max(axis=0)) / 2
            return middle
        where: Array = self.midpoint[:, :2].mean(axis=0)
        return where

    @cached_property
    def body(self) -> Footprint | None:
        """The footprint of the vehicle's bodies."""
        return Footprint.of(self.vehicle.scene.mesh()) if self.vehicle else None

    def distances(self, item: DetectionObject) -> Distances:
        """Distances of an object's footprint from the vehicle's; without one, of its middle from the reference point.

        A box of cuboids is the object, though it may be smaller than they are.
        """
        if self.body is None:
            return from_point(self.reference_m)
        body = self.body
        known = {one.item.name: one.target for one in self.detection_targets}
        target = known[item.name] if item.name in known else box_target(item.box_m)
        footprint = Footprint.of((target.mesh[0] - target.origin_m, target.mesh[1]))
        return lambda places: body.to_objects_m(footprint, places)

    def cost(self, poses: Array) -> float:
        """The objective of one rig's poses (slots, 6), computed in full: by definition, what a search minimises."""

        def at(where: Array) -> Trial:
            return Trial(self.region, self.lidars(where), self.visibility)

        if self.robust is None:
            return self.criterion().of(at(poses))
        costs = []
        whole = self.criterion()
        errors = self.robust.errors(len(self.slots))
        if self.robust.lost:
            costs.append(self.criterion(self.robust.kept(len(self.slots))).of(at(poses)))
        if self.robust.drawn:
            drawn = sorted(whole.of(at(mounted(poses, error))) for error in errors)
            costs.append(drawn[self.robust.drawn - 1 - self.robust.spare])
        return max(costs)

    def lidars(self, poses: Array) -> tuple[Lidar, ...]:
        """The sensors at these poses (slots, 6)."""
        return tuple(placed(slot.lidar, row[:3], row[3:]) for row, slot in zip(poses, self.slots, strict=True))

    def rig(self, poses: Array) -> Rig:
        """The rig at these poses (slots, 6); every sensor with an address and ports of its own."""
        mounts = []
        for i, (row, slot) in enumerate(zip(poses.tolist(), self.slots, strict=True)):
            data_port, telemetry_port = ports(slot.sensor)
            mounts.append(
                Mount(
                    name=slot.name,
                    sensor=slot.sensor,
                    position_m=(row[0], row[1], row[2]),
                    rpy_rad=(row[3], row[4], row[5]),
                    model=slot.model,
                    host=str(FIRST_HOST + i),
                    data_port=data_port + i,
                    telemetry_port=telemetry_port + i,
                    rpm=RPM,
                    return_mode=RETURN_MODE,
                    azimuth_fov_deg=slot.azimuth_fov_deg,
                    range_m=slot.range_m,
                )
            )
        return Rig(self.name[:NAME_MAX], tuple(mounts), self.vehicle.section if self.vehicle else None)


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
            raise error_at(path, ("vehicle",), "leaves no cuboid in the region")
        check_bounds(file, path, bodies)
    surroundings = _surroundings(file, path)
    zones = _zones(file, region, path)
    if file.robust:
        with errors_at(path, "robust", "lost"):
            file.robust.check(len(slots.slots))
    detection_targets = _detection_targets(file, region, path)
    found = entries_of(file.requirements or (), path)
    seen = _visibility(file, region, bodies, surroundings)
    only_required = False
    if "objective" not in file.model_fields_set:
        if bodies:
            file = file.model_copy(update={"objective": Objective({MissesTerm.key: MissesFile()})})
        else:
            only_required = bool(found)
    if fault := without_cones(file.objective, file.detection, only_required, slots.sensors):
        raise error_at(path, *fault)
    required = _requirements(file, found, slots, region, bodies, seen, path)
    study = Study(
        name=path.stem,
        region=region,
        slots=slots.slots,
        lower=slots.lower,
        upper=slots.upper,
        mirror=slots.mirror,
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
        file=_resolved(file, found, slots.slots, choices, path),
    )
    if detection_targets:
        for mount, slot, number in zip(study.rig(study.lower).mounts, slots.slots, slots.group, strict=True):
            for sensor in [choice.sensor for choice in slot.choices if choice] or [slot.sensor]:
                with errors_at(path, "sensors", number):
                    study.scanners([replace(mount, sensor=sensor)])
    return study


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
                check_fits(item, region)
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
        body = Footprint.of(bodies.scene.mesh())
        return Misses.of(file.objective.misses or MissesFile(), body, *_ground(seen, region), path.parent)


def _requirements(
    file: StudyFile,
    found: Sequence[Entry],
    slots: Slots,
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
    models = [choice.model for slot in slots.slots for choice in slot.choices if choice] or [
        slot.model or "" for slot in slots.slots
    ]
    site = VehicleSite.of(bodies, obstacles, ground_m, slots.boxes_m)
    return resolved(found, Context(site, file.robust, prices, len(slots.slots), models))


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


def with_solver(study: Study, **changes: Any) -> Study:
    """The study with some of its solver's values replaced; a budget given here replaces the file's.

    Of another method, only the values that all solvers have are kept. Raises ConfigError.
    """
    solver = changed(study.solver, {key: value for key, value in changes.items() if value is not None})
    file = study.file | {"solver": solver.model_dump(mode="json", exclude_none=True)}
    return replace(study, solver=solver, file=file)
