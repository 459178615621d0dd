"""Rigs, studies and objects in words, for reports."""

import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata

from lidarcfg import __version__
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.report.table import PRICE, written
from lidarcfg.report.text import truncate
from lidarcfg.sensors.rig import Rig
from lidarcfg.study.return_counts import HEADINGS_DEG, STEP_M
from lidarcfg.study.study import Study
from lidarcfg.study.terms import TERMS
from lidarcfg.study.terms.misses import describe_misses
from lidarcfg.vsr.detection import Detection, DetectionObject, Returns
from lidarcfg.vsr.region import Region

PACKAGES = ("numpy", "scipy", "open3d", "matplotlib")


def date() -> str:
    """Now in UTC, or the time in SOURCE_DATE_EPOCH. Raises ConfigError if that is not a time."""
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    if not seconds:
        return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    try:
        return f"{datetime.fromtimestamp(int(seconds), UTC):%Y-%m-%d %H:%M} UTC"
    except (ValueError, OverflowError, OSError):
        raise ConfigError(f"SOURCE_DATE_EPOCH: {seconds[:40]!r} is not a number of seconds since 1970") from None


def versions() -> str:
    """The versions of everything that a result may depend on."""
    found = [f"lidarcfg {__version__}", f"Python {platform.python_version()}"]
    for name in PACKAGES:
        for distribution in (name, f"{name}-cpu"):
            try:
                found.append(f"{distribution} {metadata.version(distribution)}")
            except metadata.PackageNotFoundError:
                continue
            break
    return ", ".join(found) + f"; {platform.system()} {platform.machine()}"


def counted(number: int, what: str) -> str:
    """A number of things: 1 beam, 2 beams."""
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"


def price(value: float) -> str:
    """A price with all its figures."""
    return written(value, PRICE)


def vector(values: Sequence[float] | Array, form: str = "g") -> str:
    """Numbers with commas between them, without negative zeros."""
    return ", ".join(f"{value:z{form}}" for value in values)


def beams(rig: Rig) -> int:
    """The number of beams of all sensors."""
    return sum(mount.sensor.count for mount in rig.mounts)


def has_cones(rig: Rig) -> bool:
    """Whether some sensor has beams, whose cones max VSR is about."""
    return not all(mount.sensor.scan_pattern for mount in rig.mounts)


def beams_alone(rig: Rig) -> str:
    """Which sensors have no part in max VSR, in words; empty if all have."""
    names = [truncate(mount.name) for mount in rig.mounts if mount.sensor.scan_pattern]
    return f"of beams alone, without those with scan patterns: {', '.join(names)}" if names else ""


def describe_rig(rig: Rig) -> str:
    """The number of sensors of each model, and of beams."""
    models = [mount.sensor.name for mount in rig.mounts]
    kinds = ", ".join(f"{models.count(name)} × {name}" for name in dict.fromkeys(models))
    return f"{counted(len(models), 'sensor')} ({kinds}), {counted(beams(rig), 'beam')}"


def region_rows(region: Region) -> list[tuple[str, str]]:
    """The region's extent, its cuboids and its exclusions."""
    excluded = region.included.size - int(region.included.sum())
    return [
        ("region", f"from {vector(region.min_m)} to {vector(region.max_m)} m"),
        ("cuboids", f"{' × '.join(map(str, region.shape))} of {' × '.join(f'{e:g}' for e in region.cuboid_m)} m"),
        ("excluded", f"{excluded:,} of {region.included.size:,} cuboids"),
    ]


def describe_object(item: DetectionObject) -> str:
    """An object's size, where it may be, and when it counts as detected."""
    if item.returns:
        return _by_returns(item)
    where = "on the ground" if item.on_ground else "at all heights"
    how = f"{counted(item.samples, 'position')} and headings drawn" if item.samples else "every position on the grid"
    size = " × ".join(f"{edge:g}" for edge in item.box_m)
    return f"{size} m, {where}, {how}; detected if in more than {counted(item.most_touched, 'subspace')}"


def describe_places(study: Study, item: DetectionObject, found: Detection) -> str:
    """The number and the spacing of the places that a rate was counted at, or how they were drawn."""
    if found.half_width:
        return f"± {found.half_width:.4f}, {found.places:,} drawn places"
    if item.returns:
        headings = item.headings_deg or HEADINGS_DEG
        turned = f", at {len(headings)} headings" if len(headings) > 1 else ""
        return f"{found.places:,} places, {item.step_m or STEP_M:g} m apart{turned}"
    steps = study.region.cuboid_m[: 2 if item.on_ground else 3]
    return f"{found.places:,} places, {' × '.join(f'{step:g}' for step in steps)} m apart"


def describe_origin(study: Study) -> str:
    """What distances along the ground begin at."""
    return "the vehicle's body" if study.vehicle else "the midpoint of the sensors' bounds"


def describe_returns(found: Returns) -> str:
    """The number of returns, on average and in the worst phase."""
    least = f"in the worst phase {found.mean_in_worst_phase:.1f}, rate {found.rate_in_worst_phase:.4f}"
    return f"{found.mean:.1f} returns on average; {least}"


def _by_returns(item: DetectionObject) -> str:
    what = " × ".join(f"{edge:g}" for edge in item.box_m) + " m" if item.size_m else str(item.mesh)
    headings = ", ".join(f"{angle:g}°" for angle in item.headings_deg or HEADINGS_DEG)
    how = f"every {item.step_m or STEP_M:g} m, heading {headings}"
    if item.samples:
        how = f"{counted(item.samples, 'position')} and headings drawn"
    return f"{what}, on the ground, {how}; detected by {counted(item.returns or 0, 'return')} or more in a revolution"


def describe_objective(study: Study) -> str:
    """The quantity that the search minimises, or widens."""
    if study.only_required:
        return "the least margin of the requirements, as a part of what each demands, as large as it can be"
    return "; ".join([_describe_terms(study), *_describe_robust(study)])


def _describe_robust(study: Study) -> list[str]:
    """The failures and errors that a rig must withstand."""
    robust = study.robust
    terms = []
    if robust is None:
        return []
    if robust.lost:
        terms.append(f"of the worst rig left when any {counted(robust.lost, 'LiDAR')} of {len(study.slots)} fail")
    if robust.drawn:
        sigmas = (robust.position_sigma_m or 0.0, "m"), (robust.angle_sigma_deg or 0.0, "°")
        errors = " and ".join(f"{sigma:g} {unit}" for sigma, unit in sigmas if sigma)
        rank = f"the {robust.drawn - robust.spare}-th smallest of {counted(robust.drawn, 'draw')}"
        terms.append(f"with mounting errors of {errors} (standard deviation), {rank}")
    return ["; or ".join(terms) + ("; the larger of both" if len(terms) > 1 else "")]


def _describe_terms(study: Study) -> str:
    """The terms of the objective."""
    wanted = study.objective
    if wanted.is_max_vsr:
        weighted = ", times the weight of its zones" if study.zones else ""
        return f"max VSR, the largest volume-to-surface ratio of all subspaces{weighted}"
    if wanted.misses and wanted.is_misses:
        return describe_misses(wanted.misses, truncate)
    terms = [one for key, given in wanted.given.items() for one in TERMS[key].describe(given, truncate)]
    return "the weighted mean of " + ", ".join(terms)


def cost_label(study: Study) -> str:
    """What the costs of a search are, on an axis: lower is better."""
    value = "max VSR (m)" if study.is_max_vsr else "misses, as believed" if study.is_misses else "objective"
    if study.only_required:
        value = "1 / (1 + least margin)"
    return f"shortfall, then {value}" if study.requirements else value


def describe_skips(study: Study) -> str:
    """When a search stops evaluating a trial early."""
    wanted = study.objective
    if study.requirements:
        return "A trial ends as soon as the places counted so far show that its shortfall is no less than that to beat."
    if study.is_misses:
        return "A trial ends as soon as the places counted so far show that it misses no less than what it has to beat."
    if wanted.is_max_vsr:
        ends = "as soon as one of its subspaces is no better than the value it has to beat"
    else:
        ends = "as soon as the terms computed so far, with 0 for all others, reach the value it has to beat"
    if study.robust:
        ends += ", in as many of the rigs that it stands for as settle it"
    return f"A trial ends {ends}. {study.solver.in_full}".rstrip()


def describe_limits(study: Study) -> str:
    """The limits on the LiDARs' sight besides their beams; empty if there are none."""
    if study.visibility is None:
        return ""
    what = ["their ranges"] * study.visibility.range
    what += ["their horizontal fields of view"] * study.visibility.field_of_view
    if study.visibility.blocks:
        what += [f"the vehicle ({', '.join(map(truncate, study.vehicle.scene.names))})"] if study.vehicle else []
        what += [f"the surroundings ({truncate(study.surroundings.file.name)})"] if study.surroundings else []
    return ", ".join(what)


def describe_constraints(study: Study) -> str:
    """The constraints on every rig."""
    limits = study.constraints
    terms = [] if limits.max_tilt_deg == 180 else [f"every sensor's tilt at most {limits.max_tilt_deg:g}°"]
    terms += [] if not limits.min_distance_m else [f"sensors at least {limits.min_distance_m:g} m apart"]
    terms += ["bases wholly on their surfaces"] * any(slot.surface for slot in study.slots)
    return "; ".join(["the bounds below", *terms])


def describe_solver(study: Study) -> str:
    """The method, its seed and its budget."""
    solver = study.solver
    budgets = [("cycles", solver.cycles), ("evaluations", solver.evaluations), ("seconds", solver.seconds)]
    budget = " or ".join(f"{value:,} {name}" for name, value in budgets if value is not None)
    own = "".join(f", {key} {value:,}" for key, value in solver.own_keys.items())
    return f"{solver.method}{own}, seed {solver.seed}, for {budget}"
