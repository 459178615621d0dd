"""One line on what a file is, and on what it would do."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from lidarcfg.capture.manifest import CaptureManifest, read_manifest
from lidarcfg.config.kinds import DISCRIMINATING_KEYS, likely_kind_of
from lidarcfg.config.models import load, load_keys
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.packets.families import codec
from lidarcfg.report.describe import counted
from lidarcfg.requirements.file import load_requirements
from lidarcfg.requirements.scenarios.file import scenario_in
from lidarcfg.search.combinations import combinations
from lidarcfg.search.sweep_plan import load_plan
from lidarcfg.sensors.faults import FaultsFile
from lidarcfg.sensors.rig import Mount, load_rig
from lidarcfg.sensors.sensor import Sensor, load_sensor
from lidarcfg.solvers.solver import BUDGETS
from lidarcfg.study.checks import rig_warnings, study_warnings
from lidarcfg.study.loading import check_firing, load_study
from lidarcfg.world.motion import load_path
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.vehicle import Vehicle, check_outside, load_vehicle, rig_vehicle


@dataclass(frozen=True)
class Summary:
    """A file's kind, what it would do, and what looks wrong."""

    kind: str
    text: str  # what it would do
    warnings: tuple[str, ...]


def summary(path: str | Path) -> Summary:
    """The summary of one of our files. Raises ConfigError and SceneError if it has an error."""
    path = example(path)
    kind = "trajectory" if path.suffix == ".tum" else likely_kind_of(load_keys(path))
    if kind is None:
        allowed = ", ".join(sorted({*DISCRIMINATING_KEYS, "requirements", "faults", "rig"}))
        raise ConfigError(f"{path}: is not one of lidarcfg's files; allowed: {allowed}")
    text, warnings = SUMMARIES[kind](path)
    return Summary(kind, text, tuple(warnings))


def _study(path: Path) -> tuple[str, Iterable[str]]:
    study = load_study(path)
    check_firing(study, path)
    free = study.space.dimensions
    solver = study.solver
    limits = {key: getattr(solver, key) for key in sorted(BUDGETS)}
    budget = ", ".join(f"{limit:,} {key}".replace(".0 ", " ") for key, limit in limits.items() if limit is not None)
    search = f"{solver.method} searches {free} free coordinates for {budget}" if free else "nothing is free to move"
    sensors = _models(slot.model for slot in study.slots)
    if study.to_choose:
        sensors = f"{counted(len(combinations(study)), 'combination')} of sensors"
    what = "to minimise a weighted mean"
    if study.objective.is_max_vsr:
        what = "to minimise max VSR"
    elif study.objective.is_misses and study.objective.misses:
        count = study.objective.misses.returns
        what = f"to minimise misses: places where an object gets fewer than {count} returns"
    if study.only_required:
        what = "to widen the least margin"
    what += " by zones" * bool(study.zones) + ", with failures or mounting errors" * bool(study.robust)
    count = len(study.requirements.items) if study.requirements else 0
    required = f", {counted(count, 'requirement')}" if count else ""
    text = (
        f"{int(study.region.included.sum()):,} cuboids, {sensors}, "
        f"{_objects(len(study.detection))}{required}; {search}, {what}"
    )
    vehicle = study.vehicle.warnings if study.vehicle else ()
    return text, (*vehicle, *study_warnings(path, study))


def _plan(path: Path) -> tuple[str, Iterable[str]]:
    plan = load_plan(path)
    return f"{len(plan.runs):,} runs of a sweep over {', '.join(plan.varied)}", ()


def _requirements(path: Path) -> tuple[str, Iterable[str]]:
    found = [one.item.name for one in load_requirements(path)]
    return f"{counted(len(found), 'requirement')}: {', '.join(found)}", ()


def _scenario(path: Path) -> tuple[str, Iterable[str]]:
    found = scenario_in(path)
    speeds = ", ".join(f"{speed:g}" for speed in found.file.speeds_km_h or ())
    cars = counted(len(found.file.cars), "parked car")
    unverified = (f"{path}: {found.name}: not verified: {found.file.unverified}",) if found.file.unverified else ()
    return f"{found.name}, at {speeds or 'no'} km/h, {cars}", unverified


def _rig(path: Path) -> tuple[str, Iterable[str]]:
    rig = load_rig(path)
    vehicle = rig_vehicle(rig)
    if vehicle:
        check_outside(vehicle, rig.mounts, path)
    silent = [mount.name for mount in rig.mounts if not _sends(mount)]
    short = [mount.name for mount in rig.mounts if not (mount.sensor.range or mount.range_m)]
    export = f"{', '.join(silent)} exported as points: no packets" if silent else "can be exported"
    if short:
        export = f"cannot be exported: no range of {', '.join(short)}"
    bodies = _bodies(vehicle) if vehicle else "no vehicle"
    text = f"{_models(mount.model for mount in rig.mounts)}, {bodies}; {export}"
    return text, (*(vehicle.warnings if vehicle else ()), *rig_warnings(path, vehicle=vehicle))


def _sends(mount: Mount) -> bool:
    """Whether a mount's sensor has packets. Raises ConfigError for invalid packet settings."""
    if mount.sensor.codec is None:
        return False
    codec(mount.sensor).check(mount)
    return True


def _scene(path: Path) -> tuple[str, Iterable[str]]:
    scene = load_scene(path)
    dynamic = sum(motion is not None for motion in scene.motions)
    return f"{_objects(len(scene.names))}, {dynamic} of them dynamic; {_triangles(scene)}", ()


def _sensor(path: Path) -> tuple[str, Iterable[str]]:
    sensor = load_sensor(path.resolve())
    low, high = sensor.elevation_span_deg
    what = counted(sensor.count, "channel" if sensor.scan_pattern else "beam")
    text = f"{sensor.name}, {what} from {low:.6g}° to {high:.6g}°; {_packets(sensor)}"
    return text, ()


def _packets(sensor: Sensor) -> str:
    if sensor.codec is None:
        return "no packets: exported as points" if sensor.range else "for placement: no range, no packets"
    codec(sensor)
    return f"packets of {sensor.codec}"


def _vehicle(path: Path) -> tuple[str, Iterable[str]]:
    vehicle = load_vehicle(path)
    return _bodies(vehicle), vehicle.warnings


def _trajectory(path: Path) -> tuple[str, Iterable[str]]:
    found = load_path(path)
    times_s = found.times_s
    if len(times_s):
        return f"{len(times_s):,} timed poses from {times_s[0]:g} s to {times_s[-1]:g} s", ()
    return ("an arc" if found.motion.arc else "a constant velocity"), ()


def _faults(path: Path) -> tuple[str, Iterable[str]]:
    faults = load(path, FaultsFile).faults
    counts = Counter(fault.fault for fault in faults)
    sensors = ", ".join(dict.fromkeys(fault.sensor for fault in faults))
    return f"{', '.join(f'{count} × {name}' for name, count in counts.items())}; of {sensors}", ()


def _manifest(path: Path) -> tuple[str, Iterable[str]]:
    manifest = read_manifest(path)
    for key in ("rig", "scene", "trajectory", "vehicle"):
        manifest.input_path(key)
    return f"{manifest.duration_s:g} s from {manifest.start} on, by version {manifest.version}", ()


def _models(models: Iterable[str | None]) -> str:
    """Sensors by their models."""
    counts = Counter(Path(model).stem if model else "beams of its own" for model in models)
    return ", ".join(f"{count} × {name}" for name, count in counts.items())


def _objects(count: int) -> str:
    return f"{count} object{'s' * (count != 1)}"


def _bodies(vehicle: Vehicle) -> str:
    count = len(vehicle.scene.names)
    return f"a vehicle of {count} {'body' if count == 1 else 'bodies'} with {_triangles(vehicle.scene)}"


def _triangles(scene: Scene) -> str:
    return counted(len(scene.triangles), "triangle")


SUMMARIES: dict[str, Callable[[Path], tuple[str, Iterable[str]]]] = {
    "plan": _plan,
    "study": _study,
    "requirements": _requirements,
    "scenario": _scenario,
    "rig": _rig,
    "scene": _scene,
    "sensor": _sensor,
    "vehicle": _vehicle,
    "trajectory": _trajectory,
    "faults": _faults,
    CaptureManifest.kind: _manifest,
}
