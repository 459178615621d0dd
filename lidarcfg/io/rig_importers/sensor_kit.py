"""A kit: the sensors of a vehicle, each with its frame; and the rig of its LiDARs."""

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from lidarcfg.config.models import COORDINATE_MAX_M, NAME_MAX, Section, Vec3
from lidarcfg.errors import ConversionError
from lidarcfg.sensors.lidar_names import guessed_model, is_lidar, is_other
from lidarcfg.sensors.rig import MOUNT_NAME, RETURN_MODE, RPM, Mount, Rig, default_host, ports
from lidarcfg.sensors.sensor import Sensor, catalogue, custom_sensor, load_sensor
from lidarcfg.world.frame_tree import BASE_LINK, FrameTree, Pose, listed

LEAVE_OUT = "none"  # in place of a model: the frame is no LiDAR of the rig
DRIVER_FRAME = "os_lidar"  # below os_sensor, which is the frame of an Ouster's points here
SENSOR_FRAME = "os_sensor"
NOWHERE: Mapping[str, Vec3] = {}
HOUSING = "_base_link"  # ends the names of frames at the base of a housing


@dataclass(frozen=True)
class LidarFrame:
    """The frame of a LiDAR."""

    name: str
    pose: Pose  # in the vehicle frame
    hints: tuple[str, ...] = ()  # other texts that may name the model
    model: str | None = None  # where the kit itself says it
    elevation_deg: tuple[float, ...] = ()  # or its beams, where the kit has these alone
    rpm: float = RPM


@dataclass(frozen=True)
class SensorKit:
    """What a kit's files say."""

    where: str  # the file or folder
    name: str
    frames: tuple[LidarFrame, ...]
    others: tuple[str, ...] = ()  # sensors that a rig cannot hold
    candidates: tuple[str, ...] = ()  # all frames, where more than the LiDARs' may be named
    notes: tuple[str, ...] = ()  # what was assumed
    vehicle: Section | None = None  # the body, as a rig has it


def kit_of_tree(
    where: str,
    name: str,
    tree: FrameTree,
    models: Mapping[str, str],
    hints: Mapping[str, tuple[str, ...]],
    lidars: frozenset[str] = frozenset(),
    notes: tuple[str, ...] = (),
) -> SensorKit:
    """The kit of a tree of frames: its sensors are found by their names.

    A sensor's housing and its beams often have a frame each, one above the other: the lower one counts. `models` names
    frames that are LiDARs whatever they are called; so does `lidars`. Raises ConversionError for frames without a path
    to the base.
    """
    base = tree.base()
    given = [one for one in tree.frames if one in models]
    kept = [
        one
        for one in tree.frames
        if one not in models and one != base and (one in lidars or (is_lidar(one) and not is_other(one)))
    ]
    kept = [one for one in kept if not any(one in tree.above(of) or of in tree.above(one) for of in given)]
    found = [one for one in kept if not _is_driver_frame(one, tree)]
    found = [one for one in found if not any(one in tree.above(other) for other in found)]
    wanted = [one for one in tree.frames if one in {*given, *found}]
    others = [one for one in tree.frames if is_other(one) and one not in {*wanted, *kept}]
    others = [one for one in others if not set(tree.above(one)) & set(others)]
    if lost := tuple(one for one in wanted if models.get(one) != LEAVE_OUT and not tree.reaches(one, base)):
        raise ConversionError(f"{where}: no path leads from {listed(lost)} to {base}; it leads to {_tops(tree, lost)}")
    if base != BASE_LINK:
        notes = (*notes, f"has no {BASE_LINK}; the vehicle frame is {base}")
    frames = [
        LidarFrame(one, tree.pose(one, base), (*hints.get(one, ()), *_above_hints(one, tree, hints)))
        for one in wanted
        if tree.reaches(one, base)
    ]
    candidates = tuple(one for one in tree.frames if one != base)
    return SensorKit(where, name, tuple(frames), tuple(others), candidates, notes)


def _is_driver_frame(name: str, tree: FrameTree) -> bool:
    return name.endswith(DRIVER_FRAME) and tree.above(name)[:1] == (name.replace(DRIVER_FRAME, SENSOR_FRAME),)


def _above_hints(name: str, tree: FrameTree, hints: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Hints from the parent frame: the base of a sensor's housing, whose mesh is named after the model."""
    return tuple(text for one in tree.above(name)[:1] for text in hints.get(one, ()))


def _tops(tree: FrameTree, names: tuple[str, ...]) -> str:
    return listed(tuple(dict.fromkeys(tree.above(one)[-1] if tree.above(one) else one for one in names)))


def rig_of_kit(
    kit: SensorKit,
    models: Mapping[str, str],
    on_warning: Callable[[str], None],
    origins_m: Mapping[str, Vec3] = NOWHERE,
) -> Rig:
    """The rig of a kit's LiDARs.

    `models` says what they are, by frame: a model, a sensor's file, or none; under the name "" that of all others.
    `origins_m` says where their beams start, by frame and in that; under "" where those of all other housings do.
    `on_warning` gets what was guessed and what the rig cannot hold. Raises ConversionError, ConfigError.
    """
    known = kit.candidates or tuple(frame.name for frame in kit.frames)
    for option, names_given in (("--model", models), ("--origin", origins_m)):
        for name in names_given:
            if name and name not in known:
                raise ConversionError(f"{kit.where}: {option} {name}: {_unknown(name, known)}")
    told = list(kit.notes)
    guesses: list[str] = []
    rest = models.get("")
    rest_is_used = False
    unknown: list[str] = []
    housings: list[str] = []
    mounts: list[Mount] = []
    names: dict[str, str] = {}
    left_out = list(kit.others)
    for frame in kit.frames:
        model = models.get(frame.name) or frame.model
        if not model and not frame.elevation_deg:
            model = guessed_model(frame.name, *frame.hints)
            if model:
                guesses.append(f"{frame.name} as {model}")
            else:
                model, rest_is_used = rest, True
        if model == LEAVE_OUT:
            left_out.append(frame.name)
            continue
        if not model and not frame.elevation_deg:
            unknown.append(frame.name)
            continue
        sensor = load_sensor(model) if model else custom_sensor(frame.elevation_deg)
        whole = model if model is None or model in catalogue() else os.path.realpath(model)
        origin_m = origins_m.get(frame.name, origins_m.get("") if frame.name.endswith(HOUSING) else None)
        if origin_m:
            frame = replace(frame, pose=frame.pose.moved(origin_m))
        elif frame.name.endswith(HOUSING):
            housings.append(frame.name)
        mounts.append(_mount(kit, len(mounts), frame, sensor, whole, names))
    if unknown:
        what = f"no name says the model of {listed(tuple(unknown))}"
        how = f"say --model {unknown[0]}=MODEL, or {unknown[0]}={LEAVE_OUT} to leave it out"
        raise ConversionError(f"{kit.where}: {what}; {how}; lidarcfg sensors lists the models")
    if not mounts:
        found = f"its frames: {listed(known)}" if known else "it has no frames"
        raise ConversionError(f"{kit.where}: has no LiDAR by its frames' names; --model NAME=MODEL says which; {found}")
    if guesses:
        told.append(f"taken by name: {', '.join(guesses)}; --model NAME=MODEL says otherwise")
    if rest and not rest_is_used:
        if rest != LEAVE_OUT:
            load_sensor(rest)  # whether there is one
        one = kit.frames[0].name
        told.append(f"--model {rest} is not used: it is for frames of unknown model; say --model {one}={rest}")
    if housings:
        what = "by the name the base of the housing; its beams start above that: --origin NAME=X,Y,Z says where"
        told.append(f"{', '.join(housings)}: {what}")
    if left_out:
        told.append(f"a rig has LiDARs only; left out: {', '.join(left_out)}")
    for text in told:
        on_warning(f"{kit.where}: {text}")
    return Rig(kit.name[:NAME_MAX] or "rig", tuple(mounts), kit.vehicle)


def _mount(
    kit: SensorKit, index: int, frame: LidarFrame, sensor: Sensor, model: str | None, names: dict[str, str]
) -> Mount:
    """The mount of a frame, with the defaults of a rig's file; `names` gets its name."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", frame.name.strip("/"))[:NAME_MAX]
    name = name if re.match(MOUNT_NAME, name) else f"lidar_{name}"[:NAME_MAX]
    if name in names:
        raise ConversionError(f"{kit.where}: {names[name]} and {frame.name} would both be called {name}")
    names[name] = frame.name
    if any(abs(value) > COORDINATE_MAX_M for value in frame.pose.position_m):
        raise ConversionError(f"{kit.where}: {frame.name} is more than {COORDINATE_MAX_M:g} m away")
    host = default_host(index)
    if host is None:
        raise ConversionError(f"{kit.where}: has more than {index} LiDARs, for which a rig has default addresses")
    rpm = frame.rpm
    if sensor.rotation:
        rpm = min(max(rpm, sensor.rotation.rpm_min), sensor.rotation.rpm_max)
    data_port, telemetry_port = ports(sensor)
    made = Mount(
        name=name,
        sensor=sensor,
        position_m=frame.pose.position_m,
        rpy_rad=frame.pose.rpy_rad,
        model=model,
        host=host,
        data_port=data_port,
        telemetry_port=telemetry_port,
        rpm=rpm,
        return_mode=RETURN_MODE,
    )
    return replace(made, azimuth_fov_deg=sensor.field_of_view_deg(None))


def _unknown(name: str, known: tuple[str, ...]) -> str:
    import difflib  # slow to load, and only for mistakes

    close = difflib.get_close_matches(name, known, 1)
    hint = f"did you mean {close[0]}? " if close else ""
    return f"no frame is called so; {hint}its frames: {listed(known)}"
