"""A study: which sensors may be placed where, what is minimised, and how to search."""

import math
import time
from dataclasses import dataclass, field, replace
from itertools import combinations, islice
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config import COORDINATE_MAX_M, Angles, Metres, Model, Position, error_at, fault, load
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.geometry import Array, up
from lidarcfg.placement.analytic import Analytic, analytic
from lidarcfg.placement.cones import Lidar, lidar, rig_lidars
from lidarcfg.placement.detection import Detection, DetectionObject, check_fits, detection
from lidarcfg.placement.metric import (
    bounds_m,
    centroid_m,
    inscribed_radii_m,
    surface_m2,
    volume_m3,
    vsr_m,
)
from lidarcfg.placement.objective import Criterion, Objective
from lidarcfg.placement.region import Region, RegionFile
from lidarcfg.placement.subspace import Subspaces, segment
from lidarcfg.rig import (
    FIRST_HOST,
    HOSTS,
    RETURN_MODE,
    RPM,
    Mount,
    MountName,
    Rig,
    angles_rad,
    one_of,
    ports,
    resolve_sensor,
)
from lidarcfg.sensor import Elevations, Sensor

WORST = 10  # how many of the worst subspaces an evaluation lists
BUDGETS = {"cycles", "evaluations", "seconds"}
COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")


class PoseBound(Model):
    """A bound on a pose."""

    position_m: Position
    rpy_rad: Angles | None = None
    rpy_deg: Angles | None = None

    @model_validator(mode="after")
    def _check(self) -> "PoseBound":
        one_of(self, "rpy_rad", "rpy_deg")
        return self

    @property
    def pose(self) -> tuple[float, ...]:
        """x, y, z, roll, pitch, yaw."""
        return *self.position_m, *angles_rad(self.rpy_rad, self.rpy_deg)


class GroupFile(Model):
    """Sensors of one model within the same bounds."""

    model: str | None = None
    elevation_deg: Elevations | None = None
    name: MountName | None = None
    count: Annotated[int, Field(ge=1, le=1000)] = 1
    mirror_y_m: Metres | None = None  # the sensors are pairs, each the other's image in the plane y = mirror_y_m
    min: PoseBound
    max: PoseBound

    @model_validator(mode="after")
    def _check(self) -> "GroupFile":
        one_of(self, "model", "elevation_deg")
        if self.mirror_y_m is not None and self.count % 2:
            raise fault(f"needs pairs, and count is {self.count}; allowed: an even count", "mirror_y_m")
        for i, (low, high) in enumerate(zip(self.min.pose, self.max.pose, strict=True)):
            if low > high:
                raise fault(f"its {COORDINATES[i]} is below min's; allowed: at or above it", "max")
        return self


class Constraints(Model):
    """What a rig must satisfy."""

    max_tilt_deg: Annotated[float, Field(ge=0, le=180)] = 180.0  # of every sensor's axis from the vertical
    min_distance_m: Annotated[float, Field(ge=0, le=COORDINATE_MAX_M)] = 0.0  # between any two sensors' origins


class Solver(Model):
    """How to search. The first budget that is reached ends the run.

    Without a budget: 800 cycles of `abc`, as in the paper, or 100,000 evaluations of another method.
    """

    method: Literal["auto", "abc", "cmaes", "de"] = "auto"
    bees: Annotated[int, Field(ge=2, le=1_000_000)] = 200  # abc: food sources
    limit: Annotated[int, Field(ge=1)] | None = None  # abc: failures of a source; default: bees × free dimensions
    cycles: Annotated[int, Field(ge=1)] | None = None
    evaluations: Annotated[int, Field(ge=1)] | None = None
    seconds: Annotated[float, Field(gt=0)] | None = None
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1

    @model_validator(mode="before")
    @classmethod
    def _default_budget(cls, values: Any) -> Any:
        if isinstance(values, dict) and all(values.get(key) is None for key in BUDGETS):
            return values | ({"cycles": 800} if values.get("method") == "abc" else {"evaluations": 100_000})
        return values


class StudyFile(Model):
    """A study file."""

    region: RegionFile
    sensors: Annotated[tuple[GroupFile, ...], Field(min_length=1)]
    objective: Objective = Objective()
    constraints: Constraints = Constraints()
    solver: Solver = Solver()
    detection: tuple[DetectionObject, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> "StudyFile":
        names = [item.name for item in self.detection]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise fault(f"{name!r} is an object already; each may stand once", "detection", i, "name")
        for name in self.objective.detection:
            if name not in names:
                allowed = ", ".join(names) or "none, as the study has no detection"
                raise fault(f"no object is called so; allowed: {allowed}", "objective", "detection", name)
        return self


@dataclass(frozen=True)
class Slot:
    """One sensor to place."""

    name: str
    sensor: Sensor
    model: str | None  # its name in files; None: its beams are given inline


@dataclass(frozen=True)
class Study:
    """A study, resolved: poses are rows of x, y, z, roll, pitch, yaw in metres and radians."""

    name: str
    region: Region
    slots: tuple[Slot, ...]
    lower: Array  # (slots, 6)
    upper: Array  # (slots, 6); equal to lower: a fixed value
    mirror: Array  # (slots,) the y of the plane that mirrors the sensor before into this one; else NaN
    solver: Solver
    objective: Objective = field(default_factory=Objective)
    constraints: Constraints = field(default_factory=Constraints)
    detection: tuple[DetectionObject, ...] = ()
    file: dict[str, Any] = field(default_factory=dict)  # the file with its defaults filled in

    @property
    def free(self) -> NDArray[np.bool_]:
        """(slots, 6) which coordinates vary independently."""
        return (self.lower < self.upper) & np.isnan(self.mirror)[:, None]

    def poses(self, unit: Array) -> Array:
        """Poses (n, slots, 6) of points (n, free coordinates) of the unit cube; 1 is exactly upper."""
        out = np.repeat(self.lower[None], len(unit), axis=0)
        low, high = self.lower[self.free], self.upper[self.free]
        out[:, self.free] = np.where(unit == 1.0, high, np.clip(low + unit * (high - low), low, high))
        images = np.flatnonzero(~np.isnan(self.mirror))
        out[:, images] = out[:, images - 1] * (1, -1, 1, -1, 1, -1)
        out[:, images, 1] += 2 * self.mirror[images]
        return out

    def violation(self, poses: Array) -> Array:
        """(n,) by how much poses (n, slots, 6) violate the constraints, radians and metres summed; 0 if they do not."""
        tilt = np.arccos(np.clip(up(poses[..., 3:])[..., 2], -1.0, 1.0))
        total: Array = np.maximum(tilt - math.radians(self.constraints.max_tilt_deg) - 1e-12, 0.0).sum(axis=1)
        for i, j in combinations(range(len(self.slots)), 2):
            apart = np.linalg.norm(poses[:, i, :3] - poses[:, j, :3], axis=1)
            total += np.maximum(self.constraints.min_distance_m - apart, 0.0)
        return total

    def criterion(self) -> Criterion:
        """The objective, made ready for this region and these objects."""
        return Criterion(self.objective, self.region, self.detection)

    def cost(self, poses: Array) -> float:
        """The objective of one rig's poses (slots, 6), computed in full: what a search minimises, by definition."""
        return self.criterion().of(segment(self.region, self.lidars(poses)))

    def lidars(self, poses: Array) -> tuple[Lidar, ...]:
        """The cones of the sensors at these poses (slots, 6)."""
        return tuple(
            lidar(row[:3], row[3:], slot.sensor.sin_elevation) for row, slot in zip(poses, self.slots, strict=True)
        )

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
                )
            )
        return Rig(self.name, tuple(mounts))


@dataclass(frozen=True)
class Worst:
    """One of the worst subspaces."""

    vsr_m: float
    volume_m3: float
    surface_m2: float
    inscribed_radius_m: float
    centroid_m: list[float]
    min_m: list[float]
    max_m: list[float]
    gap: list[int]  # by sensor: how many of its beams pass below
    between_deg: list[list[float | None]]  # by sensor: the elevations of the beams below and above; None: no beam


@dataclass(frozen=True)
class Evaluation:
    """How well a rig does in a study."""

    subspaces: Subspaces
    vsr_m: Array  # (n,) by subspace
    worst: tuple[Worst, ...]
    detection: dict[str, Detection]  # by object
    analytic: Analytic | None  # if a tolerance was asked for
    seconds: float

    @property
    def max_vsr_m(self) -> float:
        """The paper's cost, by the cuboids' faces."""
        return float(self.vsr_m.max())


def load_study(path: str | Path) -> Study:
    """The study in a YAML file. Raises ConfigError with file, line and key."""
    path = example(path)
    file = load(path, StudyFile)
    slots: list[Slot] = []
    lower, upper, mirror = [], [], []
    for i, group in enumerate(file.sensors):
        sensor, model = resolve_sensor(path, i, group.model, group.elevation_deg)
        for number in range(group.count):
            name = group.name or f"lidar_{len(slots)}"
            if group.name and group.count > 1:
                name = f"{name}_{number}"
            if name in [slot.name for slot in slots]:
                raise error_at(path, ("sensors", i), f"two are called {name!r}; give each group its own name")
            slots.append(Slot(name, sensor, model))
            lower.append(group.min.pose)
            upper.append(group.max.pose)
            mirror.append(group.mirror_y_m if group.mirror_y_m is not None and number % 2 else math.nan)
    if len(slots) > HOSTS:
        raise error_at(path, ("sensors",), f"has {len(slots)} sensors; allowed: at most {HOSTS}")
    region = Region.from_file(file.region)
    if not region.included.any():
        raise error_at(path, ("region", "exclude"), "leaves no cuboid in the region")
    for i, item in enumerate(file.detection):
        try:
            check_fits(item, region)
        except ConfigError as error:
            raise error_at(path, ("detection", i), error) from None
    return Study(
        name=path.stem,
        region=region,
        slots=tuple(slots),
        lower=np.array(lower, np.float64),
        upper=np.array(upper, np.float64),
        mirror=np.array(mirror, np.float64),
        solver=file.solver,
        objective=file.objective,
        constraints=file.constraints,
        detection=file.detection,
        file=_resolved(file, slots),
    )


def _resolved(file: StudyFile, slots: list[Slot]) -> dict[str, Any]:
    """The file with its defaults filled in and the paths of its models resolved."""
    values = file.model_dump(mode="json", exclude_none=True)
    models = iter(slots)
    for group in values["sensors"]:
        for slot in islice(models, group["count"]):
            if slot.model is not None:
                group["model"] = slot.model
    return values


def evaluate(study: Study, rig: Rig, tolerance: float | None = None, worst_count: int = WORST) -> Evaluation:
    """A rig's max VSR, worst subspaces and detection rates; the study's bounds are not enforced.

    With a relative tolerance also the analytic max VSR, to that tolerance. Raises ConfigError where it is not
    above 0, or where the region has too many cuboids to refine.
    """
    started = time.perf_counter()
    converged = None if tolerance is None else analytic(study.region, rig_lidars(rig), tolerance)
    subspaces = segment(study.region, rig_lidars(rig))
    vsr, volume, surface = vsr_m(subspaces), volume_m3(subspaces), surface_m2(subspaces)
    radius = inscribed_radii_m(subspaces)
    worst = []
    for number in np.argsort(-vsr, kind="stable")[:worst_count].tolist():
        low, high = bounds_m(subspaces, number)
        worst.append(
            Worst(
                vsr_m=float(vsr[number]),
                volume_m3=float(volume[number]),
                surface_m2=float(surface[number]),
                inscribed_radius_m=float(radius[number]),
                centroid_m=centroid_m(subspaces, number).tolist(),
                min_m=low.tolist(),
                max_m=high.tolist(),
                gap=subspaces.gap[number].tolist(),
                between_deg=[
                    _beams_around(mount.sensor, gap)
                    for mount, gap in zip(rig.mounts, subspaces.gap[number].tolist(), strict=True)
                ],
            )
        )
    rates = {item.name: detection(subspaces, item) for item in study.detection}
    return Evaluation(subspaces, vsr, tuple(worst), rates, converged, time.perf_counter() - started)


def _beams_around(sensor: Sensor, gap: int) -> list[float | None]:
    beams = [None, *sorted(sensor.beams.elevation_deg), None]
    return [beams[gap], beams[gap + 1]]


def with_solver(study: Study, **changes: Any) -> Study:
    """The study with some of its solver's settings replaced; a budget given here replaces the file's."""
    given = {key: value for key, value in changes.items() if value is not None}
    if given.keys() & BUDGETS:
        given = dict.fromkeys(BUDGETS) | given
    solver = study.solver.model_copy(update=given)
    file = study.file | {"solver": solver.model_dump(mode="json", exclude_none=True)}
    return replace(study, solver=solver, file=file)
