"""A run of a scenario: where vehicle, target and parked cars are at each time, and the last moment to brake.

The vehicle drives straight at constant speed. A target that crosses is hit where its middle reaches the line on which
it walks; one that moves the same way, or stands, where the vehicle reaches its nearer end. Traffic keeps right, so the
near side is the vehicle's right. The world is the vehicle frame at the start of a run.

The last moment to brake follows from reaction time and deceleration: a distance, then seconds before the impact. The
distance with an object that brakes is that of Responsibility-Sensitive Safety, as Autoware's emergency braking computes
it (autoware_universe, control/autoware_autonomous_emergency_braking/README.md).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from lidarcfg.config.models import Model, validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, pose, transform
from lidarcfg.requirements.scenarios.file import TARGET, CarFile, Scenario
from lidarcfg.world.motion import Motion, TimedPose, Trajectory, build_path
from lidarcfg.world.scene import Scene, build_scene
from lidarcfg.world.scene_file import Box, Ground, MeshFile, SceneFile
from lidarcfg.world.vehicle import Vehicle

KM_H = 1 / 3.6  # in m/s
BEFORE_IMPACT_S = 6.0
AFTER_IMPACT_S = 1.0  # the target's motion goes on for this long
GAIN_POSES = 32  # timed poses while a target gains speed
GROUND_REFLECTIVITY = 15  # of asphalt, a guess; returns do not depend on it
REFLECTIVITY = 20  # of everything else, likewise
ACROSS_DEG = 90.0
NO_BODY = "a scenario needs the vehicle's body, whose front reaches the target; give vehicle"
LEAST_S = 0.5  # of a run before the last moment to brake: two revolutions of the slowest sensors, at 300 rpm, fit

Seconds = Annotated[float, Field(ge=0, le=60)]
Deceleration = Annotated[float, Field(ge=0.1, le=30)]
Offset = Annotated[float, Field(ge=0, le=100)]


class Braking(Model):
    """How a vehicle brakes. The defaults are an emergency's: figures of this project, of no standard."""

    reaction_s: Seconds = 0.3  # from the end of a frame to the brakes' full force
    deceleration_m_s2: Deceleration = 8.0
    object_deceleration_m_s2: Deceleration | None = None  # with which the target ahead stops; none: it keeps its speed
    offset_m: Offset = 0.0  # left between vehicle and target

    def distance_m(self, speed_m_s: float, target_m_s: float = 0.0) -> float:
        """The gap at the last moment to brake; the target moves ahead at `target_m_s` in the same direction."""
        if self.object_deceleration_m_s2 is None:
            closing_m_s = speed_m_s - target_m_s
            return closing_m_s * self.reaction_s + closing_m_s**2 / (2 * self.deceleration_m_s2) + self.offset_m
        braked_m = speed_m_s * self.reaction_s + speed_m_s**2 / (2 * self.deceleration_m_s2)
        return max(braked_m - target_m_s**2 / (2 * self.object_deceleration_m_s2), 0.0) + self.offset_m


EMERGENCY = Braking()
# autonomous_emergency_braking.param.yaml of autoware_launch at 025908d
COMFORT = Braking(reaction_s=1.0, deceleration_m_s2=3.0, object_deceleration_m_s2=1.0, offset_m=2.0)
PRESETS = {"emergency": EMERGENCY, "comfort": COMFORT}


def _of_preset(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value not in PRESETS:
        known = ", ".join(PRESETS)
        raise validation_error(f"{value!r} is not allowed; allowed: {known}, or keys and values")
    return PRESETS[value].model_dump()


BrakingOrName = Annotated[Braking, BeforeValidator(_of_preset, json_schema_input_type=Braking | str)]


@dataclass(frozen=True)
class VehicleExtent:
    """How far a vehicle's bodies reach in the vehicle frame, in metres."""

    front_m: float
    rear_m: float
    right_m: float
    left_m: float

    @classmethod
    def of(cls, vehicle: Vehicle | None) -> "VehicleExtent":
        """Of a vehicle's bodies. Raises ConfigError without them."""
        if vehicle is None:
            raise ConfigError(NO_BODY)
        vertices = vehicle.scene.mesh()[0]
        low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        return cls(front_m=high[0], rear_m=low[0], right_m=low[1], left_m=high[1])

    @property
    def middle_m(self) -> float:
        """Where the middle of the vehicle's path is."""
        return 0.5 * (self.right_m + self.left_m)

    def across_m(self, fraction: float) -> float:
        """A fraction of the width from the right side."""
        return self.right_m + fraction * (self.left_m - self.right_m)


@dataclass(frozen=True)
class Approach:
    """A run of a scenario at one speed: where everything is, at times since it starts. Raises ConfigError."""

    scenario: Scenario
    extent: VehicleExtent
    speed_km_h: float
    impact: float  # fraction of the width, from the right side
    lead_s: float  # from the start to the impact
    ground_m: float = 0.0  # height of the ground in the vehicle frame

    @property
    def speed_m_s(self) -> float:
        """The vehicle's speed."""
        return self.speed_km_h * KM_H

    @property
    def way(self) -> float:
        """1 if the vehicle drives forwards, along x; -1 if it reverses."""
        return -1.0 if self.scenario.file.backwards else 1.0

    @property
    def walk_m_s(self) -> float:
        """The target's speed once it has gained it."""
        return self.scenario.file.path.speed_km_h * KM_H

    @property
    def ahead_m_s(self) -> float:
        """The target's speed along the vehicle's path."""
        return 0.0 if self.scenario.file.path.crosses_from else self.walk_m_s

    @property
    def closing_m_s(self) -> float:
        """The speed at which vehicle and target approach each other along the path."""
        return self.speed_m_s - self.ahead_m_s

    @property
    def contact_m(self) -> float:
        """x of the vehicle's front, or rear if it reverses, at the impact."""
        end_m = self.extent.rear_m if self.scenario.file.backwards else self.extent.front_m
        return end_m + self.way * self.speed_m_s * self.lead_s

    @property
    def heading_deg(self) -> float:
        """The target's heading."""
        crosses = self.scenario.file.path.crosses_from
        if crosses:
            return ACROSS_DEG if crosses == "right" else -ACROSS_DEG
        return 180.0 if self.scenario.file.backwards else 0.0

    @property
    def velocity_m_s(self) -> Array:
        """(2,) of the vehicle."""
        return np.array([self.way * self.speed_m_s, 0.0])

    def remaining_m(self, seconds: float) -> float:
        """The way that the target still has to go to the place of the impact."""
        path = self.scenario.file.path
        left_s = self.lead_s - seconds
        if path.start_m is None:
            return self.walk_m_s * left_s
        steady_s = (self.walked_m - path.gain_m) / self.walk_m_s
        gaining_s = 2 * path.gain_m / self.walk_m_s
        since_s = steady_s + gaining_s - left_s  # since it began to move
        if since_s <= 0.0:
            return self.walked_m
        if since_s < gaining_s:
            return self.walked_m - self.walk_m_s**2 / (4 * path.gain_m) * since_s**2
        return self.walk_m_s * left_s

    @cached_property
    def walked_m(self) -> float:
        """The whole way of a target that starts beside the vehicle's path. Raises ConfigError if it is too short."""
        path = self.scenario.file.path
        assert path.start_m is not None
        inward = 1.0 if path.crosses_from == "right" else -1.0
        whole_m = path.start_m + inward * (self.extent.across_m(self.impact) - self.extent.middle_m)
        if not whole_m > path.gain_m:
            what = f"start_m: {path.start_m:g} m beside the path leave {whole_m:g} m to the impact, of which the target"
            raise ConfigError(f"{self.scenario.name}: {what} needs {path.gain_m:g} to gain its speed")
        return whole_m

    def target_m(self, seconds: float) -> Array:
        """(2,) the middle of the target."""
        remaining_m = self.remaining_m(seconds)
        if crosses := self.scenario.file.path.crosses_from:
            inward = 1.0 if crosses == "right" else -1.0
            return np.array([self.contact_m, self.extent.across_m(self.impact) - inward * remaining_m])
        x = self.contact_m + self.way * (0.5 * float(self.scenario.target.size_m[0]) - remaining_m)
        return np.array([x, self.extent.across_m(self.impact)])

    def gap_m(self, seconds: float) -> float:
        """Along the path from the vehicle to the place of the impact, or to the target if it moves along the path."""
        return self.closing_m_s * (self.lead_s - seconds)

    @property
    def near_side_m(self) -> float:
        """x of the target's nearer side, or of its end if it does not cross, at the impact."""
        if not self.scenario.file.path.crosses_from:
            return self.contact_m
        return self.contact_m - self.way * 0.5 * float(self.scenario.target.size_m[1])

    def car_m(self, car: CarFile) -> Array:
        """(3,) the middle of a parked car."""
        length_m, width_m, height_m = car.size_m
        x = self.near_side_m - self.way * (car.before_m + 0.5 * length_m)
        if car.side == "right":
            y = self.extent.right_m - car.beside_m - 0.5 * width_m
        else:
            y = self.extent.left_m + car.beside_m + 0.5 * width_m
        return np.array([x, y, self.ground_m + 0.5 * height_m])

    @cached_property
    def scene_file(self) -> SceneFile:
        """The scene, whose time 0 is the start: the ground, the parked cars, and the target."""
        boxes = [_box(car.name, tuple(self.car_m(car).tolist()), car.size_m) for car in self.scenario.file.cars]
        meshes = []
        target = self.scenario.target
        place = np.array([*self.target_m(0.0), self.ground_m])
        if self.scenario.mesh is None:
            length_m, width_m, height_m = target.size_m.tolist()
            x, y, z = (place + np.array([0.0, 0.0, 0.5 * height_m])).tolist()
            moving = {"yaw_deg": self.heading_deg, "motion": self._motion}
            boxes.append(_box(TARGET, (x, y, z), (length_m, width_m, height_m)).model_copy(update=moving))
        else:
            x, y, z = (place - self._turned(target.origin_m[None])[0]).tolist()
            meshes.append(
                MeshFile(
                    name=TARGET,
                    reflectivity=REFLECTIVITY,
                    file=self.scenario.mesh,
                    position_m=(x, y, z),
                    rpy_deg=(0.0, 0.0, self.heading_deg),
                    motion=self._motion,
                )
            )
        ground = Ground(z_m=self.ground_m, reflectivity=GROUND_REFLECTIVITY)
        return SceneFile(name=self.scenario.name, ground=ground, boxes=tuple(boxes), meshes=tuple(meshes))

    @cached_property
    def scene(self) -> Scene:
        """The scene of the file."""
        return build_scene(self.scene_file, Path(self.scenario.name))

    @property
    def motion(self) -> Motion:
        """The vehicle's, from its place at time 0."""
        x, y = self.velocity_m_s.tolist()
        return Motion(velocity_m_s=(x, y, 0.0))

    def trajectory(self, zero_ns: int) -> Trajectory:
        """The vehicle's, when the run starts at a time."""
        return Trajectory(np.eye(4), build_path(self.motion), zero_ns)

    def target_points(self, points: Array, seconds: float) -> Array:
        """Points (N, 3) relative to the target's place, in the world at a time."""
        place = np.array([*self.target_m(seconds), self.ground_m])
        return np.asarray(self._turned(points) + place)

    def _turned(self, points: Array) -> Array:
        return transform(self._T_turned, points)

    @cached_property
    def _T_turned(self) -> Array:
        return pose((0.0, 0.0, 0.0), (0.0, 0.0, math.radians(self.heading_deg)))

    @property
    def _motion(self) -> Motion | None:
        """The target's, from its place at time 0; while it gains speed, along chords of some tenths of a millimetre."""
        if not self.walk_m_s:
            return None
        start = self.target_m(0.0)
        path = self.scenario.file.path
        end_s = self.lead_s + AFTER_IMPACT_S
        if path.start_m is None:
            x, y = (self.target_m(1.0) - start).tolist()
            return Motion(velocity_m_s=(x, y, 0.0))
        steady_s = self.lead_s - (self.walked_m - path.gain_m) / self.walk_m_s
        gaining_s = np.linspace(steady_s - 2 * path.gain_m / self.walk_m_s, steady_s, GAIN_POSES + 1)
        times_s = [0.0, *(time for time in np.unique(gaining_s).tolist() if 0.0 < time < end_s), end_s]
        moved = [self.target_m(time) - start for time in times_s]
        poses = [
            TimedPose(time_s=time, position_m=(float(x), float(y), 0.0))
            for time, (x, y) in zip(times_s, moved, strict=True)
        ]
        return Motion(poses=tuple(poses))


def _box(name: str, center_m: tuple[float, ...], size_m: Sequence[float]) -> Box:
    x, y, z = center_m
    length_m, width_m, height_m = size_m
    return Box(name=name, reflectivity=REFLECTIVITY, center_m=(x, y, z), size_m=(length_m, width_m, height_m))


def needed(approach: Approach, braking: Braking) -> float:
    """Seconds from the last moment to brake to the impact."""
    return braking.distance_m(approach.speed_m_s, approach.ahead_m_s) / approach.closing_m_s


def approach_of(
    scenario: Scenario, extent: VehicleExtent, speed_km_h: float, impact: float, ground_m: float, braking: Braking
) -> Approach:
    """The run at a speed and impact. Raises ConfigError unless it starts long enough before braking begins."""
    one = Approach(scenario, extent, speed_km_h, impact, scenario.file.before_impact_s or BEFORE_IMPACT_S, ground_m)
    at = f"{scenario.name} at {speed_km_h:g} km/h"
    if not one.closing_m_s > 0.0:
        raise ConfigError(f"{at}: the target moves away as fast; allowed: more than {scenario.file.path.speed_km_h:g}")
    if scenario.file.from_m is not None:
        one = replace(one, lead_s=scenario.file.from_m / one.closing_m_s)
    one.remaining_m(0.0)
    needed_s = needed(one, braking)
    if one.lead_s - needed_s < LEAST_S:
        what = f"braking begins {needed_s:.2f} s before the impact, and a run {one.lead_s:.2f} s"
        raise ConfigError(f"{at}: {what}; let it start earlier (before_impact_s, from_m), or brake harder")
    return one
