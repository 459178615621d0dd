"""A study file: its keys, what is allowed in each, and their defaults."""

import math
from collections.abc import Mapping
from itertools import combinations, product
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from lidarcfg import maths
from lidarcfg.config.models import (
    COORDINATE_MAX_M,
    Angle,
    Angles,
    FileName,
    Metres,
    Model,
    Position,
    Section,
    as_model,
    check_names,
    validation_error,
)
from lidarcfg.geometry import Array
from lidarcfg.requirements.file import RequirementOrFile
from lidarcfg.requirements.robustness import Robust
from lidarcfg.sensors.rig import SENSORS_MAX, MountName, Range, angles_rad, one_of
from lidarcfg.sensors.sensor import AzimuthFov, Elevations
from lidarcfg.solvers import DEFAULT, GONE, SOLVERS, solver_of
from lidarcfg.solvers.solver import BUDGETS, Solver
from lidarcfg.study.objective import Objective
from lidarcfg.study.surfaces import SurfaceFile
from lidarcfg.study.terms import TERMS
from lidarcfg.study.zones import ELSEWHERE, ZoneFile
from lidarcfg.vsr.detection import DetectionObject
from lidarcfg.vsr.region import RegionFile
from lidarcfg.world.vehicle import VehicleFile, vehicle_file

NONE = "none"  # a choice: no sensor
PRICE_MAX = 1e12
COMBINATIONS_MAX = 1000  # with a search of each
CHEAPEST_MAX = 100_000  # where the cheapest that meets requirements is looked for
COUNTED = 10**18  # combinations are counted up to here
COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def _check_turn(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise validation_error(f"{value[1]:g} is below {value[0]:g}; allowed: at or above it", 1)
    return value


Turn = Annotated[tuple[Angle, Angle], AfterValidator(_check_turn)]  # from, to


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
    """Sensors within the same bounds or on the same surface, of one model or each of a model to choose."""

    model: str | None = None
    elevation_deg: Elevations | None = None
    choose: Annotated[tuple[str, ...], Field(min_length=1)] | None = None  # models; none: no sensor
    name: MountName | None = None
    count: Annotated[int, Field(ge=1, le=SENSORS_MAX)] = 1
    range_m: Range | None = None  # least, greatest; none: the sensor's
    azimuth_fov_deg: AzimuthFov | None = None  # none: all around
    mirror_y_m: Metres | None = None  # the sensors are pairs, each the other's image in the plane y = mirror_y_m
    min: PoseBound | None = None
    max: PoseBound | None = None
    on: SurfaceFile | None = None  # instead of min and max
    roll_deg: Turn | None = None  # none: 0; on a surface, and only of an upright sensor
    pitch_deg: Turn | None = None
    yaw_deg: Turn | None = None

    @model_validator(mode="after")
    def _check(self) -> "GroupFile":
        one_of(self, "model", "elevation_deg", "choose")
        for i, model in enumerate(self.choose or ()):
            if model in (self.choose or ())[:i]:
                raise validation_error(f"{model!r} is a choice already; each may be given once", "choose", i)
        if self.choose == (NONE,):
            raise validation_error("the only choice is none; give a model, or remove the sensor", "choose")
        if self.mirror_y_m is not None and self.count % 2:
            raise validation_error(f"needs pairs, and count is {self.count}; allowed: an even count", "mirror_y_m")
        self._check_place()
        for i, (low, high) in enumerate(zip(*self.bounds, strict=True)):
            if low > high:
                raise validation_error(f"its {COORDINATES[i]} is below min's; allowed: at or above it", "max")
        return self

    def _check_place(self) -> None:
        for key in ("min", "max"):
            if self.on and getattr(self, key):
                raise validation_error("conflicts with on; give min and max, or on", key)
            if not self.on and not getattr(self, key):
                raise validation_error("missing; give min and max, or on", key)
        for key in ANGLES:
            if getattr(self, key) and not self.on:
                raise validation_error("goes with on; otherwise min and max bound the angles", key)
            if getattr(self, key) and self.on and not self.on.upright and key != "yaw_deg":
                raise validation_error("goes with upright: true; this sensor's axis is the normal", key)

    @property
    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The least and the greatest x, y, z, roll, pitch, yaw; on a surface those of its box."""
        if self.min and self.max:
            return self.min.pose, self.max.pose
        if self.on is None:
            raise ValueError("a group has min and max, or on")
        turns = [getattr(self, key) or (0.0, 0.0) for key in ANGLES]
        least, most = (tuple(math.radians(turn[end]) for turn in turns) for end in (0, 1))
        return (*self.on.within.min_m, *least), (*self.on.within.max_m, *most)

    @property
    def together(self) -> int:
        """The number of sensors that are chosen together: mirrored ones in pairs."""
        return 1 if self.mirror_y_m is None else 2


class Constraints(Model):
    """What a rig must satisfy."""

    max_tilt_deg: Annotated[float, Field(ge=0, le=180)] = 180.0  # of every sensor's axis from the vertical
    min_distance_m: Annotated[float, Field(ge=0, le=COORDINATE_MAX_M)] = 0.0  # between any two sensors' origins


def _solver(values: Any) -> Solver:
    """A validator: the solver of the method that its values name."""
    if not isinstance(values, Mapping):
        raise PydanticKnownError("model_type", {"class_name": "solver"})
    if not isinstance(values.get("method", DEFAULT), str):
        raise validation_error(f"is not a text; allowed: {', '.join(SOLVERS)}", "method")
    method = values.get("method", DEFAULT)
    kinds = {name: solver_of(name) for name in SOLVERS}
    owners = {key: [name for name, one in kinds.items() if key in one.model_fields] for key in values}
    if method in SOLVERS:
        kind = kinds[method]
        own = {key: value for key, value in values.items() if key in kind.model_fields or not owners[key]}
        faults = [
            validation_error(f"does not go with {method}; it goes with {' or '.join(owners[key])}", key)
            for key in values
            if key not in own and values[key] is not None
        ]
    else:
        kind = kinds[DEFAULT]  # for the keys that all solvers have
        own = {key: value for key, value in values.items() if key != "method" and owners[key] in ([], [*SOLVERS])}
        what = GONE.get(method, f"is not allowed; allowed: {', '.join(SOLVERS)}")
        faults = [validation_error(f"{method!r} {what}", "method")]
    return as_model(kind, {"method": DEFAULT} | own, faults)


class _FromTable:
    """How pydantic reads a solver: as one of those that the table has then."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(_solver)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [handler(TypeAdapter(solver_of(name)).core_schema) for name in SOLVERS]}


AnySolver = Annotated[Solver, _FromTable()]


class _SolverFile(Model):
    """The part of a study that says how to search."""

    solver: AnySolver


def changed(given: Solver, changes: Mapping[str, Any]) -> Solver:
    """A solver with some values replaced. A budget replaces all; another method keeps the values that all solvers have.

    Raises ConfigError.
    """
    kept = given.model_dump(exclude_none=True)
    if changes.keys() & BUDGETS:
        kept = {key: value for key, value in kept.items() if key not in BUDGETS}
    if changes.get("method", given.method) != given.method:
        kept = {key: value for key, value in kept.items() if key not in given.own_keys}
    return Section({"solver": {**kept, **changes}}).checked(_SolverFile).solver


class VisibilityFile(Model):
    """What limits the sight of sensors. Each applies where the study gives what it needs."""

    range: bool = True
    field_of_view: bool = True
    occlusion: bool = True


class StudyFile(Model):
    """A study file."""

    kind: ClassVar[str] = "study"
    region: RegionFile
    sensors: Annotated[tuple[GroupFile, ...], Field(min_length=1, max_length=SENSORS_MAX)]
    vehicle: Annotated[VehicleFile | None, BeforeValidator(vehicle_file)] = None
    surroundings: FileName | None = None  # a scene's file, relative to the study's
    visibility: VisibilityFile | None = None
    objective: Objective = Field(default_factory=Objective)
    constraints: Constraints = Constraints()
    requirements: tuple[RequirementOrFile, ...] | None = None
    robust: Robust | None = None
    zones: tuple[ZoneFile, ...] = ()
    solver: AnySolver = Field(default_factory=lambda: _solver({}))
    detection: tuple[DetectionObject, ...] = ()
    prices: dict[str, Annotated[float, Field(gt=0, le=PRICE_MAX)]] | None = None  # by model

    @property
    def limits_sight(self) -> bool:
        """Whether anything limits the sight of sensors; if nothing does, the study is as in the paper."""
        own = [item for group in self.sensors for item in (group.range_m, group.azimuth_fov_deg)]
        given = any(item is not None for item in (self.vehicle, self.surroundings, self.visibility, *own))
        wanted = self.visibility or VisibilityFile()
        return given and (wanted.range or wanted.field_of_view or wanted.occlusion)

    @model_validator(mode="after")
    def _check(self) -> "StudyFile":
        if self.requirements == ():
            raise validation_error("asks for nothing; give a requirement, or remove the key", "requirements")
        self._check_prices()
        check_names((item.name for item in self.detection), "an object", "detection")
        for i, group in enumerate(self.sensors):
            if group.on and not self.vehicle:
                raise validation_error("needs the study's vehicle, and there is none", "sensors", i, "on")
        for i, zone in enumerate(self.zones):
            if zone.name == ELSEWHERE:
                raise validation_error(f"{ELSEWHERE!r} is what lies in no zone; give another name", "zones", i, "name")
        check_names((zone.name for zone in self.zones), "a zone", "zones")
        for key, given in self.objective.given.items():
            TERMS[key].check(given, self)
        _check_constraints(self)
        return self

    def _check_prices(self) -> None:
        prices = self.prices or {}
        if NONE in prices:
            raise validation_error("costs nothing; remove its price", "prices", NONE)
        if all(group.choose is None for group in self.sensors):
            return
        for i, group in enumerate(self.sensors):
            if group.elevation_deg is not None:
                what = "has no model, so no price, and others are to choose; write its elevations into a sensor's file"
                raise validation_error(what, "sensors", i, "elevation_deg")
            for n, model in enumerate(group.choose or (group.model,)):
                if model != NONE and model not in prices:
                    key = ("choose", n) if group.choose else ("model",)
                    raise validation_error(f"{model!r} has no price; give it one in prices", "sensors", i, *key)
        count = self.combinations
        most = CHEAPEST_MAX if self.requirements else COMBINATIONS_MAX
        if count > most:
            some = f"{count:,}" if count < COUNTED else f"more than {COUNTED:,}"
            raise validation_error(f"the choices allow {some} combinations; allowed: at most {most:,}", "sensors")

    @property
    def combinations(self) -> int:
        """The number of combinations of sensors; those of a group are interchangeable, and a rig has at least one.

        Counted up to COUNTED.
        """
        total = 1
        for group in self.sensors:
            kinds = len(group.choose or (None,))
            places = group.count // group.together
            total *= math.comb(kinds + places - 1, places)
            if total >= COUNTED:
                return total
        return total - all(NONE in (group.choose or ()) for group in self.sensors)


def _check_constraints(file: StudyFile) -> None:
    """Raises a fault for constraints that no poses within the bounds keep."""
    limit_deg = file.constraints.max_tilt_deg
    apart_m = file.constraints.min_distance_m
    boxes = []
    for i, group in enumerate(file.sensors):
        low, high = (np.array(bound) for bound in group.bounds)
        reach_m = group.on.standoff_m if group.on else 0.0
        roll, pitch = (_cosines(low[axis], high[axis]) for axis in (3, 4))
        least_deg = math.degrees(maths.acos(max(a * b for a, b in product(roll, pitch))))
        if least_deg > limit_deg + 1e-6:
            what = f"{limit_deg:g} is impossible: sensors[{i}] tilts by {least_deg:.4g} or more within its bounds"
            raise validation_error(what, "constraints", "max_tilt_deg")
        box = low[:3] - reach_m, high[:3] + reach_m
        if NONE in (group.choose or ()):  # without it the others may keep apart
            continue
        boxes += [(i, _mirrored(box, group.mirror_y_m) if number % 2 else box) for number in range(group.count)]
    for (i, one), (j, other) in combinations(boxes, 2):
        most_m = math.hypot(*np.maximum(one[1] - other[0], other[1] - one[0]))
        if most_m < apart_m:
            which = f"two of sensors[{i}]" if i == j else f"sensors[{i}] and sensors[{j}]"
            what = f"{apart_m:g} is impossible: {which} are at most {most_m:.4g} m apart within their bounds"
            raise validation_error(what, "constraints", "min_distance_m")


def _cosines(low: float, high: float) -> tuple[float, float]:
    """The least and the greatest cosine of the angles from low to high."""
    ends = [maths.cos(low), maths.cos(high)]
    turns = low / math.pi, high / math.pi
    if math.floor(turns[1]) > math.ceil(turns[0]) or high - low >= 2 * math.pi:
        return -1.0, 1.0
    if math.floor(turns[1]) == math.ceil(turns[0]):
        ends.append(maths.cos(math.floor(turns[1]) * math.pi))
    return min(ends), max(ends)


def _mirrored(box: tuple[Array, Array], plane_y_m: float | None) -> tuple[Array, Array]:
    """The image of a box's corners in the plane y = plane_y_m; the box itself without one."""
    if plane_y_m is None:
        return box
    low, high = (corner.copy() for corner in box)
    low[1], high[1] = 2 * plane_y_m - box[1][1], 2 * plane_y_m - box[0][1]
    return low, high
