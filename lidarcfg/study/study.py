"""A study: which sensors may be mounted where, what is minimised, and how to search."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from lidarcfg.config.models import NAME_MAX
from lidarcfg.geometry import Array
from lidarcfg.notebook import Shown
from lidarcfg.requirements.resolved import Requirements
from lidarcfg.requirements.robustness import Robust
from lidarcfg.returns.misses import Misses
from lidarcfg.sensors.rig import Rig
from lidarcfg.solvers.solver import Solver
from lidarcfg.study.file import Constraints, changed
from lidarcfg.study.mounting import Slot, mounts_at
from lidarcfg.study.objective import Objective
from lidarcfg.study.return_counts import DetectionTarget
from lidarcfg.study.search_space import SearchSpace
from lidarcfg.study.zones import Zone
from lidarcfg.vsr.detection import DetectionObject
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.visibility import Visibility
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.scene import Scene
from lidarcfg.world.tracer import NO_OBSTACLES, Obstacles
from lidarcfg.world.vehicle import Vehicle


@dataclass(frozen=True)
class Study(Shown):
    """What a study's file says, resolved."""

    name: str
    region: Region
    slots: tuple[Slot, ...]  # of the sensors
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

    def __repr__(self) -> str:
        return f"<Study {self.name}: {len(self.slots)} sensors, {int(self.region.included.sum()):,} cuboids>"

    @cached_property
    def space(self) -> SearchSpace:
        """Where its sensors may be."""
        return SearchSpace(self.slots, self.constraints, self.vehicle, self.solver.is_upright_central)

    @property
    def body(self) -> Footprint | None:
        """The footprint of the vehicle's bodies."""
        return self.vehicle.footprint if self.vehicle else None

    @property
    def obstacles(self) -> Obstacles:
        """The obstacles between sensors and objects."""
        return self.visibility.obstacles if self.visibility else NO_OBSTACLES

    @property
    def is_max_vsr(self) -> bool:
        """Whether max VSR of the whole rig, and nothing else, is what a search minimises."""
        return self.objective.is_max_vsr and self.robust is None and not self.zones and not self.only_required

    @property
    def is_misses(self) -> bool:
        """Whether misses of the whole rig, and nothing else, are what a search minimises."""
        return self.objective.is_misses and self.robust is None and not self.only_required

    @property
    def to_choose(self) -> bool:
        """Whether models are to be chosen; the study then stands for many: see combinations.py."""
        return any(slot.choices for slot in self.slots)

    def rig(self, poses: Array) -> Rig:
        """The rig with the sensors at poses (slots, 6)."""
        return Rig(self.name[:NAME_MAX], mounts_at(self.slots, poses), self.vehicle.section if self.vehicle else None)


def with_solver(study: Study, **changes: Any) -> Study:
    """The study with some of its solver's values replaced; a budget given here replaces the file's.

    Of another method, only the values that all solvers have are kept. Raises ConfigError.
    """
    solver = changed(study.solver, {key: value for key, value in changes.items() if value is not None})
    file = study.file | {"solver": solver.model_dump(mode="json", exclude_none=True)}
    return replace(study, solver=solver, file=file)
