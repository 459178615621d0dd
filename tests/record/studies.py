"""Cases of studies: subspaces and their measures, detection, searches."""

from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

from tests.record import package
from tests.record.answers import INPUTS, Answers, case, named

PAPER = "paper-1x4", "paper-4x16", "paper-3x8"
LIMITED = "car-max-vsr", "round", "surface"
TILTED_DEG = (
    [(22.04, 7.93, 111.7), (-0.39, 28.3, -77.23), (29.94, -14.27, 125.66)],
    [(9.77, -26.2, 1.38), (-17.57, -7.93, 108.79), (27.15, -23.61, 78.48)],
    [(-7.84, -15.53, -179.94), (19.72, -21.79, -136.3), (-18.28, -26.95, -138.14)],
)
OBJECTIVES = "paper-3x8", "car-blind", "car-detection", "car-returns", "car-lost", "surface", "round"
METHODS = "abc", "annealing", "auto"


@cache
def study(name: str):
    """One of the frozen studies."""
    return package.load_study(INPUTS / "studies" / f"{name}.yaml")


@cache
def poses(name: str, count: int, seed: int = 1) -> np.ndarray:
    """Poses (count, slots, 6) within the bounds of a study that keep its constraints, drawn at random."""
    one = study(name)
    drawn = one.space.poses(np.random.Generator(np.random.Philox(seed)).random((40 * count, one.space.dimensions)))
    kept = drawn[one.space.violation(drawn) == 0.0][:count]
    assert len(kept) == count
    return kept


def rigs(name: str, count: int) -> list:
    """Rigs of a study."""
    return [study(name).rig(one) for one in poses(name, count)]


def subspaces_of(found) -> dict[str, object]:
    """The answers about subspaces."""
    answers = {key: getattr(found, key) for key in ("label", "cuboids", "internal", "gap", "first")}
    return answers | {"seen_by": found.seen_by}


def worst_of(worst: Iterable) -> dict[str, object]:
    """The answers about the worst subspaces."""
    keys = "vsr_m", "volume_m3", "surface_m2", "inscribed_radius_m", "centroid_m", "min_m", "max_m", "gap"
    return {f"worst {key}": np.array([getattr(one, key) for one in worst]) for key in keys}


def detection_of(found) -> dict[str, object]:
    """The answers about a detection rate."""
    answers = {key: getattr(found, key) for key in ("rate", "places", "half_width")}
    if found.returns:
        answers |= {key: getattr(found.returns, key) for key in ("rate_in_worst_phase", "mean", "mean_in_worst_phase")}
    return answers


def evaluation_of(found) -> dict[str, object]:
    """The answers of an evaluation."""
    answers = subspaces_of(found.subspaces) | worst_of(found.worst)
    answers |= {"vsr": found.vsr_m, "max vsr": found.max_vsr_m, "sphere": found.sphere_m}
    for name, one in found.detection.items():
        answers |= named(name, detection_of(one))
    for name, one in found.counted.items():
        answers |= named(name, {"detected": one.detected, "can be": one.places, "held": one.held})
    for name, one in found.return_counts.items():
        keys = "worst", "mean", "probability"
        answers |= named(name, {f"returns {key}": getattr(one, key) for key in keys})
    answers["seen by m3"] = found.seen_by_m3
    answers |= {f"zone {one.name}": one.max_vsr_m for one in found.zones}
    if found.extrapolated:
        answers |= {"extrapolated": found.extrapolated.max_vsr_m, "extrapolated error": found.extrapolated.error_m}
    return answers


def details_of(found) -> dict[str, object]:
    """The answers of an evaluation's details."""
    answers = {"volume": found.volume_m3, "midpoint": found.midpoint_max_vsr_m, "vehicle": found.vehicle_m}
    answers |= {f"beams across {axis}": beams for axis, beams in zip("xyz", found.coverage.beams, strict=True)}
    answers |= {key: getattr(found.coverage, key) for key in ("median_beams", "by_none", "by_one_sensor")}
    for name, rings in found.rings.items():
        answers |= named(name, {"rings detected": rings.detected, "rings places": rings.places})
    for name, places in found.detection_maps.items():
        answers |= named(name, {"above detected": places.detected, "above places": places.places})
    for name, one in found.gap_fits.items():
        keys = "in_worst", "subspaces", "largest_vsr_m", "nearest_m", "nearest_at_m"
        answers |= named(name, {f"hiding {key}": getattr(one, key) for key in keys})
    if robust := found.evaluation.robustness:
        answers["off"] = robust.change_m
        for one in (robust.whole, *robust.without):
            answers |= named(f"without {one.lost}", {"max vsr": one.max_vsr_m, "objective": one.objective})
            answers |= {f"without {one.lost} zone {zone.name}": zone.max_vsr_m for zone in one.zones}
    return answers


def _evaluations(name: str, count: int) -> dict[str, object]:
    answers: dict[str, object] = {"included": study(name).region.included}
    for number, rig in enumerate(rigs(name, count)):
        answers |= named(f"rig {number}", evaluation_of(package.evaluate(study(name), rig)))
        answers[f"rig {number} cost"] = package.objective_of(study(name), poses(name, count)[number])
    return answers


for each, count in [*((name, 4) for name in PAPER), *((name, 2) for name in LIMITED)]:

    @case(f"evaluations of {each}")
    def _evaluated(folder: Path, name: str = each, count: int = count) -> Answers:
        return _evaluations(name, count)


@case("tilted rigs")
def _tilted_rigs(folder: Path) -> Answers:
    """Three sensors each, tilted by angles of which numpy's sine or cosine differs from processor to processor."""
    answers: dict[str, object] = {}
    one = study("paper-3x8")
    for number, rpy_deg in enumerate(TILTED_DEG):
        at = poses("paper-3x8", 1)[0].copy()
        at[:, 3:] = np.radians(rpy_deg)
        found = package.evaluate(one, one.rig(at))
        axes = np.array([lidar.axis for lidar in package.rig_lidars(one.rig(at))])
        answers |= named(f"rig {number}", evaluation_of(found) | {"axes": axes, "cost": package.objective_of(one, at)})
    return answers


@case("trials of annealing")
def _trials_of_annealing(folder: Path) -> Answers:
    """What is drawn on the way down a bowl."""
    groups = np.repeat(np.arange(3), 4)
    drawing = package.Annealing(package.Coordinates(groups, np.tile(np.arange(4), 3)), np.random.default_rng(3), 4000)
    answers: dict[str, object] = {}
    for number in range(40):
        trials = drawing.ask()
        answers[f"{number}"] = trials.x
        drawing.tell(package.of_objectives(np.square(trials.x - 0.3).sum(axis=1)))
    return answers


@case("a tilted and a tumbled region")
def _odd_grids(folder: Path) -> Answers:
    """Rows longer and shorter than a word of 64 cuboids, with holes."""
    answers: dict[str, object] = {}
    lidars = package.rig_lidars(rigs("paper-4x16", 1)[0])
    draw = np.random.Generator(np.random.Philox(5))
    for shape in ((64, 9, 7), (65, 8, 5), (130, 6, 6), (7, 40, 3), (3, 3, 70)):
        region = package.Region(np.array([20.0, 4, 0]), np.array([40.0, 16, 4]), draw.random(shape) < 0.97)
        found = package.segment(region, lidars)
        answers |= named(f"{shape}", subspaces_of(found))
    return answers


for each in ("paper-3x8", "car-max-vsr", "round"):

    @case(f"details of {each}")
    def _detailed(folder: Path, name: str = each) -> Answers:
        rig = rigs(name, 1)[0]
        found = package.report_inputs(study(name), rig, package.evaluate(study(name), rig))
        return details_of(found) | evaluation_of(found.evaluation)


@case("extrapolated max vsr")
def _extrapolated(folder: Path) -> Answers:
    answers: dict[str, object] = {}
    for name, tolerance in (("paper-3x8", 0.15), ("round", 0.1), ("car-max-vsr", 0.5)):
        found = package.evaluate(study(name), rigs(name, 1)[0], tolerance).extrapolated
        answers |= named(name, {"max vsr": found.max_vsr_m, "error": found.error_m, "cuboid": found.cuboid_m})
    return answers


@case("sight")
def _sight(folder: Path) -> Answers:
    """Which cuboids each LiDAR sees, with all that limits it, and without what hides."""
    answers: dict[str, object] = {}
    for name in LIMITED:
        one = study(name)
        lidars = package.rig_lidars(rigs(name, 1)[0])
        for kind, sight in (("limited", one.visibility), ("transparent", one.visibility.transparent())):
            answers[f"{name} {kind} cuboids"] = package.seen_cuboids(one.region, lidars, sight.sight(lidars))
    return answers


@case("returns of each sensor")
def _returns(folder: Path) -> Answers:
    """The returns at each place, from each sensor, in each phase."""
    answers: dict[str, object] = {}
    models = "vlp-16", "hdl-32e", "vls-128", "os0-32", "os1-64", "qt128", "pandar-xt32", "helios-16p", "hdl-64e-s3"
    sensors = [
        {
            "name": model,
            "model": str(INPUTS / "sensors" / f"{model}.yaml"),
            "position_m": [0.4 * number - 1.6, (-1) ** number * 0.7, 1.8 + 0.1 * number],
            "rpy_deg": [3 * number - 9, 5 - 2 * number, 40 * number],
            **({"azimuth_fov_deg": [250, 110 + 10 * number]} if number % 3 == 1 else {}),
        }
        for number, model in enumerate(models)
    ]
    rig = package.rig_of(folder, sensors)
    one = study("car-returns")
    scanners = package.scanners_of(rig.mounts)
    at = package.sensor_poses(package.rig_lidars(rig))
    for sought in one.detection_targets:
        for kind, obstacles in (("", one.obstacles), (" in the open", package.NO_OBSTACLES)):
            found = package.returns(sought.places, sought.target, scanners, at, obstacles)
            keys = {"counts": found.counts, "worst": found.worst, "mean": found.mean}
            answers |= named(f"{sought.item.name}{kind}", keys)
            for enough in (1, 7, 40):
                answers[f"{sought.item.name}{kind} probability of {enough}"] = found.probability(enough)
        answers[f"{sought.item.name} places"] = sought.places
    return answers


for each in OBJECTIVES:

    @case(f"costs of {each}")
    def _costs(folder: Path, name: str = each) -> Answers:
        """Costs of trials around sources, also where only better ones matter, and smoothed."""
        count = 24
        one = study(name)
        every = poses(name, 6 + count, seed=3)
        sources = every[:6]
        trials = every[6:].copy()
        answers = {}
        which = np.arange(count) % 6
        trials[count // 2 :] = sources[which[count // 2 :]]
        trials[count // 2 :, 0] = every[6 : 6 + count // 2, 0]  # one sensor moves alone
        with package.ObjectiveCosts(one, 2) as costs:
            at = costs.costs(sources, np.arange(6), sources, np.full(6, np.inf))
            answers["of sources"] = at
            for number, smoothing in enumerate((0.0, 0.0, 0.05)):
                answers[f"batch {number}"] = costs.costs(trials, which, sources, at[which], smoothing)
        with package.ObjectiveCosts(one, 2, skip=False) as costs:
            full = costs.costs(trials, which, sources, at[which])
            answers["in full"] = full
        answers["by definition"] = np.array([package.objective_of(one, trial) for trial in trials[:2]])
        return answers


def found_of(found) -> dict[str, object]:
    """The answers of a search."""
    return {
        "poses": np.array([[*mount.position_m, *mount.rpy_rad] for mount in found.rig.mounts]),
        "objective": found.objective,
        "max vsr": found.evaluation.max_vsr_m,
        "midpoint": found.midpoint_max_vsr_m,
        "history": np.array([[cycle.cycle, cycle.evaluations, cycle.best, cycle.mean] for cycle in found.history]),
        "evaluations": [found.evaluations, found.first_evaluations, found.scout_evaluations, found.evaluated],
        "told": np.where(found.log.cost[:, 0] > 0, *found.log.cost.T),  # each as one number
    }


def _searched(name: str, threads: int, **solver: object) -> dict[str, object]:
    changed = package.with_solver(study(name), **solver)
    return found_of(package.optimize(changed, threads))


for method in METHODS:

    @case(f"search by {method}")
    def _search(folder: Path, method: str = method) -> Answers:
        answers: dict[str, object] = {}
        for name, evaluations in (("paper-3x8", 900), ("car-max-vsr", 150)):
            for threads in (1, 2):
                options = {"method": method, "evaluations": evaluations, "seed": 11}
                options |= {"bees": 12} if method == "abc" else {}
                answers |= named(f"{name} {threads}", _searched(name, threads, **options))
        return answers


for each in OBJECTIVES[1:]:

    @case(f"search of {each}")
    def _search_for(folder: Path, name: str = each) -> Answers:
        answers = _searched(name, 2, method="abc", evaluations=40, seed=2, bees=8)
        answers |= named("auto", _searched(name, 2, method="auto", evaluations=40, seed=4))
        if name == "car-returns":  # what is told of a trial that is given up depends on which thread found it hopeless
            answers = {key: value for key, value in answers.items() if not key.endswith("told")}
        return answers


@case("price front")
def _front(folder: Path) -> Answers:
    answers: dict[str, object] = {}
    for threads in (1, 2):
        found = package.front(study("prices"), threads)
        for number, point in enumerate(found.points):
            answers |= named(f"{threads} point {number}", found_of(point.placement))
            answers[f"{threads} point {number} price"] = point.combination.price
        history = [[part.evaluations, part.own_evaluations, part.best, part.on_front] for part in found.history]
        answers[f"{threads} history"] = np.array(history)
        answers[f"{threads} objectives"] = np.array([one.objective for one in found.candidates])
    return answers


@case("mount surfaces")
def _surfaces(folder: Path) -> Answers:
    """Where bases fit, how sensors sit there, and by how much poses violate that."""
    one = study("surface")
    unit = np.random.Generator(np.random.Philox(9)).random((200, one.space.dimensions))
    at = one.space.poses(unit)
    off = at.copy()
    off[:, :, :3] += 0.02 * np.random.Generator(np.random.Philox(10)).random(off[:, :, :3].shape)
    return {
        "poses": at,
        "violation": one.space.violation(at),
        "off": one.space.violation(off),
        "midpoint": one.space.midpoint,
        "lower": one.space.lower,
        "upper": one.space.upper,
    }
