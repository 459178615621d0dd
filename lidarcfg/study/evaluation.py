"""How well a rig does in a study, what a LiDAR that fails changes, and how much each axis of each mount matters."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config.document import key_text
from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array
from lidarcfg.notebook import Shown
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.misses import MissesFound
from lidarcfg.returns.post_visibility import PostVisibility
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.study.criterion import Criterion
from lidarcfg.study.detection import detection_rates, rig_returns
from lidarcfg.study.extents import Extent, extents
from lidarcfg.study.extrapolation import Extrapolated, extrapolate
from lidarcfg.study.loading import load_study
from lidarcfg.study.objective import without_cones
from lidarcfg.study.return_counts import ReturnCounts
from lidarcfg.study.spheres import largest_spheres
from lidarcfg.study.study import Study
from lidarcfg.study.trial import Trial
from lidarcfg.study.zones import ZoneVsr, max_vsr_by_zone
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.detection import Counted, Detection, counted_places
from lidarcfg.vsr.metric import surface_m2, volume_m3, vsr_m
from lidarcfg.vsr.subspaces import BLIND, Subspaces, segment
from lidarcfg.vsr.visibility import seen_by_m3
from lidarcfg.world.vehicle import check_outside

CUBOIDS_MAX = 1_000_000  # for larger regions it is omitted
STEP_M = 0.01  # of a position
STEP_DEG = 0.1  # of an angle
OFFSETS = (-5, -1, 1, 5)  # steps by which a coordinate is off
HUGE = float(np.finfo(np.float64).max)  # to beat: everything does
WORST = 10  # how many of the worst subspaces an evaluation lists


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
        slope: Array = (self.change_m * off).sum(axis=-1) / np.square(off).sum()
        return slope

    @property
    def increase_m(self) -> Array:
        """(lidars, 6) the largest increase of max VSR; 0 where there is none."""
        most: Array = np.maximum(self.change_m.max(axis=2), 0.0)
        return most

    def largest_m(self, angles: bool) -> float:
        """The largest increase of max VSR by a position, or an angle, that is off."""
        return float((self.increase_m[:, 3:] if angles else self.increase_m[:, :3]).max())


def misses_without(study: Study, rig: Rig) -> dict[str, float]:
    """What is missed if one sensor fails, by its name; empty where there is one alone, or misses are not known."""
    if len(rig.mounts) == 1:
        return {}
    left = {lost.name: replace(rig, mounts=tuple(m for m in rig.mounts if m is not lost)) for lost in rig.mounts}
    found = {name: misses_of(study, others) for name, others in left.items()}
    return {name: one.mean for name, one in found.items() if one} if all(found.values()) else {}


def robustness(study: Study, rig: Rig) -> Robustness | None:
    """The effects of failures and mounting errors; None where the region has too many cuboids for a quick answer."""
    if study.region.included.size > CUBOIDS_MAX:
        return None
    trial = Trial(study.region, rig_lidars(rig), study.visibility)
    criterion = Criterion.of_study(study, mounts=rig.mounts)
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
    with BoundedCosts(study.region, rig_lidars(rig), visibility=study.visibility) as bounded:
        source = np.zeros(len(every), np.int64)
        cost = bounded.costs(every, source, pose[None], np.full(len(every), HUGE))
    change: Array = cost[1:] - cost[0]
    return change.reshape(len(pose), 6, len(OFFSETS))


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
    # a sensor that does not see it has the gap −1, and no beams


@dataclass(frozen=True)
class Evaluation(Shown):
    """How well a rig does in a study."""

    subspaces: Subspaces
    vsr_m: Array  # (n,) by subspace
    worst: tuple[Worst, ...]
    extents: tuple[Extent, ...]  # of these
    sphere_m: float  # radius of the largest sphere inside any subspace
    detection: dict[str, Detection]  # by object
    counted: dict[str, Counted]  # by object whose places on the grid are counted
    return_counts: dict[str, ReturnCounts]  # by object that is detected by returns
    seen_by_m3: Array  # (LiDARs + 1,) the volume that exactly 0, 1, 2 … of them see, whatever their beams
    zones: tuple[ZoneVsr, ...]  # of studies that have some
    extrapolated: Extrapolated | None  # if a tolerance was asked for
    seconds: float
    robustness: Robustness | None = None  # where it was asked for, and is cheap
    posts: tuple[PostVisibility, ...] = ()  # where posts are seen, where that was asked for and is known
    misses: MissesFound | None = None  # at fresh places; None: no vehicle, or sensors lack facts
    misses_without: dict[str, float] = field(default_factory=dict)  # by the sensor that is lost; empty as robustness
    verdict: Verdict | None = None  # of a study with requirements
    verifier: Verifier | None = None  # that reached it, if it was reached here: it knows the rig's counts

    def __repr__(self) -> str:
        misses = f"misses {self.misses.mean:.2%}, " if self.misses else ""
        verdict = f", {self.verdict!r}" if self.verdict else ""
        return f"<Evaluation: {misses}max VSR {self.max_vsr_m:.4f} m{verdict}>"

    @property
    def max_vsr_m(self) -> float:
        """Max VSR by the cuboids' faces: the paper's cost. Sensors with a scan pattern, without cones, have no part."""
        return float(self.vsr_m.max())


def evaluate(
    study: Study | Given,
    rig: Rig | Given,
    tolerance: float | None = None,
    worst_count: int = WORST,
    on_progress: Callable[[float], None] = lambda fraction: None,
    verdict: Verdict | None = None,
) -> Evaluation:
    """A rig's misses, max VSR, worst subspaces, detection rates and verdict; the study's bounds are not enforced.

    Study and rig are files, dicts with their keys, or loaded. With a relative tolerance also max VSR extrapolated to
    ever smaller cuboids, to that tolerance. `on_progress` is told the fraction done of the objects that are detected by
    returns, which take longest. `verdict` is that on the rig, where it is known already. Raises ConfigError where the
    tolerance is not above 0, or where the region has too many cuboids to refine; and where a sensor is inside the
    study's vehicle.
    """
    study = loaded(study, load_study, Study)
    rig = loaded(rig, load_rig, Rig)
    started = time.perf_counter()
    if study.vehicle:
        check_outside(study.vehicle, rig.mounts)
    sensors = [mount.sensor for mount in rig.mounts]
    if fault := without_cones(study.objective, study.detection, study.only_required, sensors):
        raise ConfigError(f"study {study.name!r}: {key_text(fault[0])}{fault[1]}")
    if not (tolerance is None or isinstance(tolerance, Real)):
        raise ConfigError(f"tolerance is {tolerance!r}; allowed: a number above 0")
    if tolerance is not None and any(sensor.scan_pattern for sensor in sensors):
        raise ConfigError("a tolerance is that of cones of beams; sensors with a scan pattern have none")
    lidars = rig_lidars(rig)
    extrapolated = None if tolerance is None else extrapolate(study.region, lidars, tolerance, study.visibility)
    subspaces = segment(study.region, lidars, study.visibility)
    vsr = vsr_m(subspaces)
    radius = largest_spheres(subspaces).radius_m
    numbers = np.argsort(-vsr, kind="stable")[:worst_count].tolist()
    where = extents(subspaces, numbers)
    worst = _worst(rig, subspaces, vsr, radius, dict(zip(numbers, where, strict=True)))
    seen = rig_returns(study, rig, on_progress)
    counted = {
        item.name: counted_places(subspaces, item) for item in study.detection if not (item.samples or item.returns)
    }
    rates = detection_rates(study, rig, subspaces, seen, counted)
    zones = max_vsr_by_zone(study.zones, subspaces)
    misses = misses_of(study, rig)
    verifier = None
    if study.requirements and verdict is None:
        verifier = Verifier(study.requirements)
        verdict = verifier.verify(rig.mounts)
    seconds = time.perf_counter() - started
    return Evaluation(
        subspaces=subspaces,
        vsr_m=vsr,
        worst=worst,
        extents=tuple(where),
        sphere_m=float(radius.max()),
        detection=rates,
        counted=counted,
        return_counts=seen,
        seen_by_m3=seen_by_m3(study.region, subspaces.seen, len(lidars)),
        zones=zones,
        extrapolated=extrapolated,
        seconds=seconds,
        misses=misses,
        verdict=verdict,
        verifier=verifier,
    )


def with_failures(study: Study, rig: Rig, found: Evaluation) -> Evaluation:
    """An evaluation with the effects of failures and mounting errors."""
    return replace(found, robustness=robustness(study, rig), misses_without=misses_without(study, rig))


def shadow(study: Study, rig: Rig) -> NDArray[np.bool_]:
    """(nx, ny, nz) which cuboids bodies alone hide from all LiDARs of a rig: without bodies, one would see them."""
    if study.visibility is None:
        return np.zeros(study.region.shape, np.bool_)
    lidars = rig_lidars(rig)
    without_bodies = segment(study.region, lidars, study.visibility.transparent()).seen_by
    return np.asarray((without_bodies > 0) & (segment(study.region, lidars, study.visibility).seen_by == 0))


def misses_of(study: Study, rig: Rig) -> MissesFound | None:
    """How often a rig misses objects around the study's vehicle; None without one, or if its sensors lack facts."""
    if study.misses is None:
        return None
    try:
        return study.misses.found(rig.mounts)
    except ConfigError:
        return None


def _worst(rig: Rig, subspaces: Subspaces, vsr: Array, radius: Array, where: dict[int, Extent]) -> tuple[Worst, ...]:
    """The subspaces with these numbers."""
    volume = volume_m3(subspaces)
    surface = surface_m2(subspaces)
    found = []
    for number, extent in where.items():
        low, high = extent.bounds_m
        gaps = subspaces.gap[number].tolist()
        found.append(
            Worst(
                vsr_m=float(vsr[number]),
                volume_m3=float(volume[number]),
                surface_m2=float(surface[number]),
                inscribed_radius_m=float(radius[number]),
                centroid_m=extent.centroid_m.tolist(),
                min_m=low.tolist(),
                max_m=high.tolist(),
                gap=gaps,
                between_deg=[_beams_around(mount.sensor, gap) for mount, gap in zip(rig.mounts, gaps, strict=True)],
            )
        )
    return tuple(found)


def _beams_around(sensor: Sensor, gap: int) -> list[float | None]:
    if gap == BLIND:
        return [None, None]
    beams = [None, *sorted(sensor.beams.elevation_deg), None]
    return [beams[gap], beams[gap + 1]]
