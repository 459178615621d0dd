"""What a rig's max VSR and objective become if a LiDAR fails, and how much each axis of each mount matters."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.placement.cones import rig_lidars
from lidarcfg.placement.evaluator import Evaluator
from lidarcfg.placement.metric import vsr_m
from lidarcfg.placement.objective import Criterion, Trial
from lidarcfg.placement.study import Study
from lidarcfg.placement.zones import ZoneVsr, max_vsr_by_zone
from lidarcfg.sensors.rig import Rig

CUBOIDS_MAX = 1_000_000  # for larger regions it is omitted
STEP_M = 0.01  # of a position
STEP_DEG = 0.1  # of an angle
OFFSETS = (-5, -1, 1, 5)  # steps by which a coordinate is off
HUGE = float(np.finfo(np.float64).max)  # to beat: everything does


@dataclass(frozen=True)
class DegradedRig:
    """A rig without one of its LiDARs; or the whole one, to compare with."""

    lost: str | None  # the mount that fails; None: the whole rig
    max_vsr_m: float
    objective: float  # the study's, of what is left
    zones: tuple[ZoneVsr, ...]


@dataclass(frozen=True)
class Robustness:
    """The effects of failures and mounting errors on a rig."""

    whole: DegradedRig
    without: tuple[DegradedRig, ...]  # each LiDAR in turn; none where there is one alone
    change_m: Array  # (lidars, 6, OFFSETS) of max VSR, with x, y, z, roll, pitch or yaw off

    @property
    def worst(self) -> DegradedRig | None:
        """The case of failure with the largest max VSR."""
        return max(self.without, key=lambda rig: rig.max_vsr_m, default=None)

    @property
    def slope_m(self) -> Array:
        """(lidars, 6) the change of max VSR per step: the slope of the best line through the whole rig's value."""
        off = np.array(OFFSETS, np.float64)
        slope: Array = self.change_m @ off / (off @ off)
        return slope

    @property
    def increase_m(self) -> Array:
        """(lidars, 6) the largest increase of max VSR; 0 where there is none."""
        most: Array = np.maximum(self.change_m.max(axis=2), 0.0)
        return most

    def largest_m(self, angles: bool) -> float:
        """The largest increase of max VSR by a position, or an angle, that is off."""
        return float((self.increase_m[:, 3:] if angles else self.increase_m[:, :3]).max())


def robustness(study: Study, rig: Rig) -> Robustness | None:
    """The effects of failures and mounting errors; None where the region has too many cuboids for a quick answer."""
    if study.region.included.size > CUBOIDS_MAX:
        return None
    trial = Trial(study.region, rig_lidars(rig), study.visibility)
    criterion = study.criterion(mounts=rig.mounts)
    names = [mount.name for mount in rig.mounts]
    everyone = range(len(rig.mounts))
    without = [
        _degraded(study, criterion, trial.left(tuple(i for i in everyone if i != lost)), names[lost])
        for lost in everyone
        if len(names) > 1
    ]
    return Robustness(_degraded(study, criterion, trial, None), tuple(without), changes_m(study, rig))


def _degraded(study: Study, criterion: Criterion, trial: Trial, lost: str | None) -> DegradedRig:
    subspaces = trial.subspaces
    return DegradedRig(
        lost, float(vsr_m(subspaces).max()), criterion.of(trial), max_vsr_by_zone(study.zones, subspaces)
    )


def changes_m(study: Study, rig: Rig, step_m: float = STEP_M, step_deg: float = STEP_DEG) -> Array:
    """(lidars, 6, OFFSETS) the change of max VSR when one coordinate of a pose is off by OFFSETS steps."""
    pose = np.array([[*mount.position_m, *mount.rpy_rad] for mount in rig.mounts])
    step = np.repeat([step_m, np.radians(step_deg)], 3)
    lidars, axes = np.indices((len(pose), 6)).reshape(2, -1)
    moved = np.repeat(pose[None], len(OFFSETS) * pose.size, axis=0)
    for number, off in enumerate(OFFSETS):
        moved[number :: len(OFFSETS)][np.arange(pose.size), lidars, axes] += off * step[axes]
    every = np.concatenate([pose[None], moved])
    with Evaluator(study.region, rig_lidars(rig), visibility=study.visibility) as evaluator:
        source = np.zeros(len(every), np.int64)
        cost = evaluator.costs(every, source, pose[None], np.full(len(every), HUGE))
    change: Array = cost[1:] - cost[0]
    return change.reshape(len(pose), 6, len(OFFSETS))
