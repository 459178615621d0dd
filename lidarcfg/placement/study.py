"""A study: which sensors may sit where, what is asked of them, and how the answer is looked for."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config import Model, Vec3, error_at, fault, load
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.placement.bee_colony import BeeColony
from lidarcfg.placement.detection import DetectionObject, check_fits, detection_rate
from lidarcfg.placement.evaluator import Evaluator, max_vsr
from lidarcfg.placement.metric import (
    bounds_m,
    centroid_m,
    inscribed_radius_m,
    surface_m2,
    volume_m3,
    vsr_m,
)
from lidarcfg.placement.region import Region, RegionFile
from lidarcfg.placement.subspace import Lidar, Subspaces, lidar, rig_lidars, segment
from lidarcfg.rig import (
    DATA_PORT,
    FIRST_HOST,
    HOSTS,
    TELEMETRY_PORT,
    Mount,
    MountName,
    Rig,
    angles_rad,
    one_of,
    resolve_sensor,
)
from lidarcfg.sensor import Elevations, Sensor

WORST = 10  # so many of the worst subspaces are named
BUDGETS = {"cycles", "evaluations", "seconds"}
COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")


class PoseBound(Model):
    """A bound on a pose."""

    position_m: Vec3
    rpy_rad: Vec3 | None = None
    rpy_deg: Vec3 | None = None

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
    min: PoseBound
    max: PoseBound

    @model_validator(mode="after")
    def _check(self) -> "GroupFile":
        one_of(self, "model", "elevation_deg")
        for i, (low, high) in enumerate(zip(self.min.pose, self.max.pose, strict=True)):
            if low > high:
                raise fault(f"its {COORDINATES[i]} is below min's; allowed: at or above it", "max")
        return self


class Objective(Model):
    """The weights of what is minimised."""

    max_vsr: Annotated[float, Field(gt=0)] = 1.0


class Solver(Model):
    """How the answer is looked for. The first budget that is reached ends the run; by default, 800 cycles."""

    method: Literal["abc"] = "abc"
    bees: Annotated[int, Field(ge=2, le=1_000_000)] = 200
    limit: Annotated[int, Field(ge=1)] | None = None  # default: bees × free dimensions
    cycles: Annotated[int, Field(ge=1)] | None = None
    evaluations: Annotated[int, Field(ge=1)] | None = None
    seconds: Annotated[float, Field(gt=0)] | None = None
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1

    @model_validator(mode="before")
    @classmethod
    def _default_budget(cls, values: Any) -> Any:
        if isinstance(values, dict) and not values.keys() & BUDGETS:
            return values | {"cycles": 800}
        return values


class StudyFile(Model):
    """A study, as its file says it."""

    region: RegionFile
    sensors: Annotated[tuple[GroupFile, ...], Field(min_length=1)]
    objective: Objective = Objective()
    solver: Solver = Solver()
    detection: tuple[DetectionObject, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> "StudyFile":
        names = [item.name for item in self.detection]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise fault(f"{name!r} is an object already; each may stand once", "detection", i, "name")
        return self


@dataclass(frozen=True)
class Slot:
    """One sensor to place."""

    name: str
    sensor: Sensor
    model: str | None  # what a file calls the sensor; None: its beams stand inline


@dataclass(frozen=True)
class Study:
    """A study, resolved: poses are rows of x, y, z, roll, pitch, yaw in metres and radians."""

    name: str
    region: Region
    slots: tuple[Slot, ...]
    lower: Array  # (slots, 6)
    upper: Array  # (slots, 6); equal to lower: a fixed value
    solver: Solver
    detection: tuple[DetectionObject, ...] = ()
    file: dict[str, Any] = field(default_factory=dict)  # the file with its defaults filled in

    @property
    def free(self) -> NDArray[np.bool_]:
        """(slots, 6) which coordinates vary."""
        return self.lower < self.upper

    def poses(self, unit: Array) -> Array:
        """Poses (n, slots, 6) of points (n, free coordinates) of the unit cube; 1 is exactly upper."""
        out = np.repeat(self.lower[None], len(unit), axis=0)
        low, high = self.lower[self.free], self.upper[self.free]
        out[:, self.free] = np.where(unit == 1.0, high, np.clip(low + unit * (high - low), low, high))
        return out

    def lidars(self, poses: Array) -> tuple[Lidar, ...]:
        """The cones of the sensors at these poses (slots, 6)."""
        return tuple(
            lidar(row[:3], row[3:], slot.sensor.sin_elevation) for row, slot in zip(poses, self.slots, strict=True)
        )

    def rig(self, poses: Array) -> Rig:
        """The rig at these poses (slots, 6); every sensor with an address and ports of its own."""
        mounts = []
        for i, (row, slot) in enumerate(zip(poses.tolist(), self.slots, strict=True)):
            mounts.append(
                Mount(
                    name=slot.name,
                    sensor=slot.sensor,
                    position_m=(row[0], row[1], row[2]),
                    rpy_rad=(row[3], row[4], row[5]),
                    model=slot.model,
                    host=str(FIRST_HOST + i),
                    data_port=DATA_PORT + i,
                    telemetry_port=TELEMETRY_PORT + i,
                    rpm=600.0,
                    return_mode="strongest",
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
    gap: list[int]  # by sensor: so many of its beams pass below


@dataclass(frozen=True)
class Evaluation:
    """What a rig is worth in a study."""

    subspaces: Subspaces
    vsr_m: Array  # (n,) by subspace
    worst: tuple[Worst, ...]
    detection: dict[str, float]  # by object: the share of places where it is detected
    seconds: float

    @property
    def max_vsr_m(self) -> float:
        """The paper's cost."""
        return float(self.vsr_m.max())


@dataclass(frozen=True)
class Cycle:
    """A line of the history: how the swarm stood at the end of a cycle."""

    cycle: int
    evaluations: int
    best_m: float
    mean_m: float
    seconds: float


@dataclass(frozen=True)
class Placement:
    """The best rig found, and how."""

    rig: Rig
    evaluation: Evaluation
    middle_max_vsr_m: float  # of the rig in the middle of the bounds
    history: tuple[Cycle, ...]
    evaluations: int  # trials asked of employed bees and onlookers
    first_evaluations: int
    scout_evaluations: int
    full_evaluations: int  # so many were computed in full, first sources and scouts included
    cuboids: int  # so many were looked at
    seconds: float
    interrupted: bool


def load_study(path: str | Path) -> Study:
    """The study in a YAML file. Raises ConfigError with file, line and key."""
    path = Path(path)
    file = load(path, StudyFile)
    slots: list[Slot] = []
    lower, upper = [], []
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
        solver=file.solver,
        detection=file.detection,
        file=file.model_dump(mode="json", exclude_none=True),
    )


def evaluate(study: Study, rig: Rig) -> Evaluation:
    """A rig's max VSR, worst subspaces and detection rates; the study's bounds are not enforced."""
    started = time.perf_counter()
    subspaces = segment(study.region, rig_lidars(rig))
    vsr, volume, surface = vsr_m(subspaces), volume_m3(subspaces), surface_m2(subspaces)
    worst = []
    for number in np.argsort(-vsr, kind="stable")[:WORST].tolist():
        low, high = bounds_m(subspaces, number)
        worst.append(
            Worst(
                vsr_m=float(vsr[number]),
                volume_m3=float(volume[number]),
                surface_m2=float(surface[number]),
                inscribed_radius_m=inscribed_radius_m(subspaces, number),
                centroid_m=centroid_m(subspaces, number).tolist(),
                min_m=low.tolist(),
                max_m=high.tolist(),
                gap=subspaces.gap[number].tolist(),
            )
        )
    detection = {item.name: detection_rate(subspaces, item) for item in study.detection}
    return Evaluation(subspaces, vsr, tuple(worst), detection, time.perf_counter() - started)


def optimize(
    study: Study,
    solver: Solver | None = None,
    threads: int | None = None,
    on_cycle: Callable[[Cycle], None] | None = None,
    skip: bool = True,
) -> Placement:
    """Look for the rig of least max VSR. The result depends on the seed, not on the number of threads.

    `solver` replaces the study's; without `skip` everything is evaluated in full, which changes nothing but the
    time. An interrupt (Ctrl-C) ends the search and keeps the best so far.
    Raises ConfigError where nothing is free to move.
    """
    solver = solver or study.solver
    dimensions = int(study.free.sum())
    if dimensions == 0:
        raise ConfigError("nothing to optimise: every bound is equal; evaluate the rig instead")
    started = time.perf_counter()
    middle = study.poses(np.full((1, dimensions), 0.5))[0]
    colony = BeeColony(dimensions, solver.bees, solver.limit or solver.bees * dimensions, solver.seed)
    asked = {"first": 0, "employed": 0, "onlooker": 0, "scout": 0}
    history: list[Cycle] = []
    interrupted = False

    def done() -> bool:
        trials = asked["employed"] + asked["onlooker"]
        return (
            (solver.cycles is not None and colony.cycles >= solver.cycles)
            or (solver.evaluations is not None and trials >= solver.evaluations)
            or (solver.seconds is not None and time.perf_counter() - started >= solver.seconds)
        )

    sines = [slot.sensor.sin_elevation for slot in study.slots]
    with Evaluator(study.region, sines, threads, skip) as evaluator:
        try:
            while not done():
                trials = colony.ask()
                left = len(trials.x)
                if solver.evaluations is not None and trials.phase in ("employed", "onlooker"):
                    left = min(left, solver.evaluations - asked["employed"] - asked["onlooker"])
                values = np.full(len(trials.x), math.inf)
                values[:left] = evaluator.max_vsr(
                    study.poses(trials.x[:left]),
                    trials.source[:left],
                    study.poses(colony.x),
                    trials.to_beat[:left],
                )
                asked[trials.phase] += left
                before = colony.cycles
                colony.tell(values)
                if colony.cycles > before or trials.phase == "first" or done():
                    history.append(
                        Cycle(
                            cycle=colony.cycles,
                            evaluations=asked["employed"] + asked["onlooker"],
                            best_m=colony.best_cost,
                            mean_m=float(colony.cost.mean()),
                            seconds=time.perf_counter() - started,
                        )
                    )
                    if on_cycle:
                        on_cycle(history[-1])
        except KeyboardInterrupt:
            interrupted = True
    if not math.isfinite(colony.best_cost):
        raise KeyboardInterrupt
    rig = study.rig(study.poses(colony.best_x[None])[0])
    return Placement(
        rig=rig,
        evaluation=evaluate(study, rig),
        middle_max_vsr_m=max_vsr(study.region, study.lidars(middle)),
        history=tuple(history),
        evaluations=asked["employed"] + asked["onlooker"],
        first_evaluations=asked["first"],
        scout_evaluations=asked["scout"],
        full_evaluations=evaluator.full_evaluations,
        cuboids=evaluator.cuboids,
        seconds=time.perf_counter() - started,
        interrupted=interrupted,
    )


def with_solver(study: Study, **changes: Any) -> Study:
    """The study with some of its solver's settings replaced; a budget given here replaces the file's."""
    given = {key: value for key, value in changes.items() if value is not None}
    if given.keys() & BUDGETS:
        given = dict.fromkeys(BUDGETS) | given
    solver = study.solver.model_copy(update=given)
    file = study.file | {"solver": solver.model_dump(mode="json", exclude_none=True)}
    return replace(study, solver=solver, file=file)
