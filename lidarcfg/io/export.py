"""From a rig and a scene, or their files, to a capture or to points with ground truth, in one call."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.manifest import DriveInputs, manifest_path
from lidarcfg.capture.manifest_writer import ManifestInputs
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config.models import Given
from lidarcfg.errors import LidarcfgError
from lidarcfg.files import check_replaceable, remove_outdated
from lidarcfg.geometry import Array
from lidarcfg.io import formats
from lidarcfg.io.drive_dataset import DriveDataset
from lidarcfg.sensors.faults import GivenFaults
from lidarcfg.sensors.rig import Rig
from lidarcfg.simulate.scans import simulated_scans
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.simulate.sensor_runs import SimulationOptions
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene


@dataclass(frozen=True)
class Exported:
    """What an export has written."""

    files: tuple[Path, ...]  # the output first; then those that readers need beside it, and the manifest
    count: int
    what: str  # is counted: Ethernet frames of a pcap, points, messages of a bag, or scans of a folder


def export(
    rig: Rig | Given,
    scene: Scene | Given,
    output: str | Path,
    duration_s: float,
    at: Array | Trajectory | None = None,
    to: str | None = None,
    on_warning: Callable[[str], None] = print,
    trajectory: str | Path | None = None,
    faults: GivenFaults = None,
) -> Exported:
    """Write what a rig's sensors send, or see, in a scene: the formats of `lidarcfg export`, by suffix or `to`.

    The vehicle stands at `at`, T_world_vehicle (4, 4), at the origin without it; or it moves from there as the file
    `trajectory` says, or along a trajectory. The rig's own vehicle travels along and blocks beams. Simulated time
    begins at START_NS. A manifest beside the output names all this for `decode`, as the command's does.

    `faults` of the sensors, in a capture, are a file, a dict with its keys, a list or `none`, instead of the rig's.

    Inputs that are in no file are written beside it, too: OUTPUT.rig.yaml, OUTPUT.scene.yaml, OUTPUT.trajectory.yaml or
    .tum. That cannot say a pose that is not rigid, sensors that are in no file but have more than elevations, and a
    scene that is no longer that of its file but names others: `on_warning` gets a line about what the manifest lacks
    then, or why there is none. Raises LidarcfgError.

    Rig and scene are files, dicts with their keys, or what is loaded from them. Returns what was written.
    """
    if not 0 < duration_s <= 86_400:
        raise LidarcfgError(f"duration_s is {duration_s:g}; allowed: above 0, at most 86400")
    if trajectory is not None and isinstance(at, Trajectory):
        raise LidarcfgError("at is a trajectory, and a file of another is given; allowed: one of them")
    output = Path(output)
    drive = SceneDrive.load(rig, scene, duration_s, at=at, trajectory=trajectory, faults=faults)
    if drive.rig.faults and (output.suffix != ".pcap" or to):
        raise LidarcfgError("faults are of packets, for a .pcap; faults='none' leaves them out")
    if output.parent.is_dir():
        check_replaceable(manifest_path(output))  # not after hours
    given = DriveInputs(_file(rig), _file(scene), _file(trajectory))
    inputs = ManifestInputs.of(drive, output, given)
    if output.suffix != ".pcap" or to:
        form = formats.format_of("drive", output, to)
        dataset = DriveDataset(drive, simulated_scans(drive))
        written = formats.save_dataset(output, form, dataset, False, on_warning)
        companions: list[Path] = []
    else:
        hits = Counter[int]()
        options = SimulationOptions(on_fault=lambda number, packets: hits.update({number: packets}))
        motion = drive.trajectory, drive.duration_ns
        streams = simulated_packets(drive.rig, drive.scene, *motion, vehicle=drive.vehicle, options=options)
        written = formats.Amount(write_pcap(output, in_time_order(streams)), "frames")
        companions = save_sidecar_files(output, drive.rig.mounts)
        inputs = inputs.with_faults(drive, hits)
    remove_outdated(inputs.outdated(output))
    beside = *companions, *inputs.save(output, on_warning)
    return Exported((output, *beside), written.count, written.what)


def _file(given: object) -> Path | None:
    """The path of what is given as a file."""
    return Path(given) if isinstance(given, str | Path) else None
