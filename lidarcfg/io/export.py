"""From a rig and a scene, or their files, to a capture or to points with ground truth, in one call."""

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path

from numpy.typing import ArrayLike

from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.ground_truth import TruthFile
from lidarcfg.capture.manifest import DriveInputs, manifest_path
from lidarcfg.capture.manifest_writer import ManifestInputs
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config.models import Given
from lidarcfg.errors import LidarcfgError, a_thing
from lidarcfg.files import check_replaceable, checked_path, remove_outdated, system_errors
from lidarcfg.io import formats
from lidarcfg.io.drive_dataset import DriveDataset
from lidarcfg.sensors.faults import GivenFaults
from lidarcfg.sensors.rig import ReturnMode, Rig, check_writable
from lidarcfg.simulate.scans import simulated_scans
from lidarcfg.simulate.scene_drive import SceneDrive, object_names
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.simulate.simulator import RayCounts
from lidarcfg.units import START_NS, TIME_END_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene
from lidarcfg.world.vehicle import Vehicle, check_outside

LONGEST_S = 86_400


@dataclass(frozen=True)
class Exported:
    """What an export has written."""

    files: tuple[Path, ...]  # the output first; then those that readers need beside it, the truth, and the manifest
    count: int
    what: str  # is counted: Ethernet frames of a pcap, points, messages of a bag, or scans of a folder
    rays: int  # traced
    hits: int  # of these, those that hit something in range


def export(
    rig: Rig | Given,
    scene: Scene | Given,
    output: str | Path,
    duration_s: float,
    at: ArrayLike | Trajectory | None = None,
    to: str | None = None,
    on_warning: Callable[[str], None] = print,
    trajectory: str | Path | Trajectory | None = None,
    faults: GivenFaults = None,
    *,
    vehicle: Vehicle | Given | None = None,
    start_ns: int = START_NS,
    return_mode: ReturnMode | None = None,
    truth: str | Path | None = None,
    split: bool = False,
    deskew: bool = False,
    on_progress: Callable[[float], None] = lambda fraction: None,
) -> Exported:
    """Write what a rig's sensors send, or see, in a scene: the formats of `lidarcfg export`, by suffix or `to`.

    rig, scene, vehicle: files, dicts with their keys, or what is loaded from them. The vehicle, by default the rig's,
        travels along and blocks beams; "none" leaves it out.
    duration_s: of simulated time, in seconds, up to a day.
    at: T_world_vehicle (4, 4), a rotation and a shift in metres, by default the identity; or the `Trajectory`.
    trajectory: a file of the motion from there, or the `Trajectory`.
    start_ns: the sensors' clocks at the beginning, in nanoseconds since 1970, whole microseconds.
    return_mode: of all sensors, instead of the rig's: strongest, last, first, dual …
    faults: of the sensors in a .pcap, instead of the rig's: a file, a dict with its keys, a list, or "none".
    truth: of a .pcap, an .npz to write with each return's object, true range and noise.
    split: whether to write a .pcap for each sensor, OUTPUT-SENSOR.pcap.
    deskew: whether points are in the world frame; for .ply, .pcd and .npz.
    on_progress: is told the fraction that is done.

    A manifest beside the output names all this for `decode`, as the command's does. Inputs that are in no file are
    written beside it, too: OUTPUT.rig.yaml, .scene.yaml, .vehicle.yaml, .trajectory.yaml or .tum. That cannot say
    sensors that are in no file but have more than elevations, and a scene that is no longer that of its file but names
    others: `on_warning` gets a line about what the manifest lacks then, or why there is none.

    Returns what was written. Raises LidarcfgError, and then leaves no output half written.
    """
    output = checked_path(output, "output")
    asked = _Output(
        output=output,
        to=to,
        truth=None if truth is None else checked_path(truth, "truth"),
        split=split,
        deskew=deskew,
        on_warning=on_warning,
        on_progress=on_progress,
    )
    asked.check(duration_s, start_ns)
    if trajectory is not None and isinstance(at, Trajectory):
        raise LidarcfgError("at is a trajectory, and a file of another is given; allowed: one of them")
    if at is not None and isinstance(trajectory, Trajectory):
        raise LidarcfgError("at is given beside a trajectory that says where it starts; allowed: one of them")
    drive = SceneDrive.load(
        rig,
        scene,
        duration_s,
        at=at,
        trajectory=trajectory,
        vehicle=vehicle,
        start_ns=start_ns,
        return_mode=return_mode,
        faults=faults,
    )
    if drive.rig.faults and not asked.is_capture:
        raise LidarcfgError("faults are of packets, for a .pcap; faults='none' leaves them out")
    check_writable(drive.rig)
    if drive.vehicle:
        check_outside(drive.vehicle, drive.rig.mounts, _file(rig))
    moved = None if isinstance(trajectory, Trajectory) else _file(trajectory)
    given = DriveInputs(_file(rig), _file(scene), moved, _file(vehicle), return_mode=return_mode)
    unfiled = drive.vehicle if vehicle is not None and given.vehicle is None else None
    with system_errors(output):
        paths = asked.paths(drive.rig)
        for path in paths:
            if path.parent.is_dir():
                check_replaceable(manifest_path(path))  # not after hours
        inputs = [ManifestInputs.of(drive, path, given, unfiled) for path in paths]
        counts = _Counts(asked, drive.duration_ns)
        made = _packets(asked, drive, paths, counts) if asked.is_capture else _points(asked, drive, counts)
        beside = list(made.beside)
        for path, one in zip(paths, inputs, strict=True):
            remove_outdated(one.outdated(path))
            named = one.with_faults(drive, counts.faulty) if asked.is_capture else one
            beside += named.save(path, on_warning)
    return Exported((*paths, *beside), made.amount.count, made.amount.what, counts.rays, counts.hits)


@dataclass(frozen=True)
class _Output:
    """What to write, and whom to tell."""

    output: Path
    to: str | None
    truth: Path | None
    split: bool
    deskew: bool
    on_warning: Callable[[str], None]
    on_progress: Callable[[float], None]

    @property
    def is_capture(self) -> bool:
        """Whether packets are written; else points."""
        return self.output.suffix == ".pcap" and not self.to

    def paths(self, rig: Rig) -> list[Path]:
        """The files or the folder to write."""
        if self.split:
            return [self.output.with_name(f"{self.output.stem}-{mount.name}.pcap") for mount in rig.mounts]
        return [self.output]

    def check(self, duration_s: object, start_ns: object) -> None:
        """Raises LidarcfgError for what does not go together, and for times that are none."""
        if not self.output.name:
            raise LidarcfgError(f"output {str(self.output)!r} names neither a file nor a folder")
        if not (isinstance(duration_s, Real) and 0 < float(duration_s) <= LONGEST_S):
            shown = f"{duration_s:g}" if isinstance(duration_s, Real) else a_thing(duration_s)
            raise LidarcfgError(f"duration_s is {shown}; allowed: above 0, at most {LONGEST_S}")
        if not (isinstance(start_ns, int) and 0 <= start_ns < TIME_END_NS and start_ns % 1000 == 0):
            raise LidarcfgError(f"start_ns is {start_ns!r}; allowed: whole microseconds, from 0 to below {TIME_END_NS}")
        if (self.split or self.truth) and not self.is_capture:
            raise LidarcfgError("split and truth are for a .pcap; points have their objects")
        if self.truth and self.truth.suffix != ".npz":
            raise LidarcfgError(f"truth {str(self.truth)!r} does not end in .npz")
        if self.deskew and self.is_capture:
            raise LidarcfgError("deskew is for points; packets stay as a sensor sends them")


@dataclass
class _Counts:
    """What is counted while an export goes on."""

    asked: _Output
    duration_ns: int
    rays: int = 0
    hits: int = 0
    faulty: Counter[int] = field(default_factory=Counter)  # packets, by the fault that hit them

    @property
    def options(self) -> SimulationOptions:
        """Those of a simulation that is counted."""

        def on_rays(counts: RayCounts) -> None:
            self.rays += counts.rays
            self.hits += counts.hits

        return SimulationOptions(
            on_progress=lambda done_ns: self.asked.on_progress(done_ns / self.duration_ns),
            on_rays=on_rays,
            on_fault=lambda number, packets: self.faulty.update({number: packets}),
        )


@dataclass(frozen=True)
class _Written:
    """How much was written, and what beside the output."""

    amount: formats.Amount
    beside: tuple[Path, ...] = ()


def _packets(asked: _Output, drive: SceneDrive, paths: list[Path], counts: _Counts) -> _Written:
    """Write one pcap, or one of each sensor, and the files that readers need."""
    mounts = drive.rig.mounts
    with ExitStack() as stack:
        truth = None
        if asked.truth:
            names = [mount.name for mount in mounts]
            truth = stack.enter_context(TruthFile(asked.truth, names, object_names(drive.scene, drive.vehicle)))
        streams = simulated_packets(
            drive.rig,
            drive.scene,
            drive.trajectory,
            drive.duration_ns,
            drive.start_ns,
            truth.add if truth else None,
            drive.vehicle,
            counts.options,
        )
        if asked.split:
            count = sum(write_pcap(path, stream) for path, stream in zip(paths, streams, strict=True))
            groups = [[mount] for mount in mounts]
        else:
            count = write_pcap(paths[0], in_time_order(streams))
            groups = [list(mounts)]
        beside = [file for path, some in zip(paths, groups, strict=True) for file in save_sidecar_files(path, some)]
        if truth:
            truth.save()
    return _Written(formats.Amount(count, "frames"), (*beside, *([asked.truth] if asked.truth else [])))


def _points(asked: _Output, drive: SceneDrive, counts: _Counts) -> _Written:
    """Write points with their ground truth, in the format that suffix or name say."""
    form = formats.format_of("drive", asked.output, asked.to)
    if asked.deskew and form.name not in formats.CLOUDS:
        raise LidarcfgError(f"deskew is for {', '.join(formats.CLOUDS)}")
    dataset = DriveDataset(drive, simulated_scans(drive, counts.options))
    return _Written(formats.save_dataset(asked.output, form, dataset, asked.deskew, asked.on_warning))


def _file(given: object) -> Path | None:
    """The path of what is given as a file."""
    return Path(given) if isinstance(given, str | Path) else None
