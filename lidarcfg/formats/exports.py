"""From a rig and a scene, or their files, to a capture or to points with ground truth, in one call."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.record import place, record_path, save_record
from lidarcfg.errors import LidarcfgError
from lidarcfg.files import loaded, together
from lidarcfg.formats import formats
from lidarcfg.formats.recording import Recording
from lidarcfg.geometry import Array
from lidarcfg.rig import Rig, load_rig
from lidarcfg.simulate import export as packets
from lidarcfg.simulate.scans import simulated_scans
from lidarcfg.simulate.tasks import START_NS, Drive
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory, load_path
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.vehicle import rig_vehicle


def export(
    rig: Rig | str | Path,
    scene: Scene | str | Path,
    output: str | Path,
    duration_s: float,
    at: Array | Trajectory | None = None,
    to: str | None = None,
    on_warning: Callable[[str], None] = print,
    trajectory: str | Path | None = None,
) -> None:
    """Write what a rig's sensors send, or see, in a scene: the formats of `lidarcfg export`, by suffix or `to`.

    The vehicle stands at `at`, T_world_vehicle (4, 4), at the origin without it; or it moves from there as the file
    `trajectory` says, or along a trajectory. The rig's own vehicle travels along and blocks beams. Simulated time
    begins at START_NS. Where rig and scene are files, a record of all this is written beside the output, unless `at` is
    a trajectory, or a pose that is raised or tilted. Raises LidarcfgError.
    """
    if not 0 < duration_s <= 86_400:
        raise LidarcfgError(f"duration_s is {duration_s:g}; allowed: above 0, at most 86400")
    if trajectory is not None and isinstance(at, Trajectory):
        raise LidarcfgError("at is a trajectory, and a file of another is given; allowed: one of them")
    output, files = Path(output), {"rig": _file(rig), "scene": _file(scene), "trajectory": _file(trajectory)}
    rig, scene = loaded(rig, load_rig), loaded(scene, load_scene)
    if isinstance(at, Trajectory):
        moved = at
    else:
        moved = Trajectory(np.eye(4) if at is None else at, load_path(trajectory), START_NS)
    drive = Drive(rig, scene, moved, rig_vehicle(rig), START_NS, round(duration_s * SECOND_NS))
    where = None if isinstance(at, Trajectory) else _place(moved.T_world_start)
    noted = where is not None and files["rig"] and files["scene"]
    with together(() if noted else [record_path(output)]):
        if output.suffix != ".pcap" or to:
            form = formats.format_of("drive", output, to)
            formats.save_recording(output, form, Recording(drive, simulated_scans(drive)), False, on_warning)
        else:
            streams = packets.export(rig, scene, moved, drive.duration_ns, vehicle=drive.vehicle)
            packets.save_companions(output, rig.mounts)
            write_pcap(output, packets.in_time_order(streams))
        if noted:
            start = datetime.fromtimestamp(START_NS // SECOND_NS, UTC).replace(tzinfo=None).isoformat()
            values = {"at": where, "start": start, "duration_s": float(duration_s)}
            save_record(output, files, rig, scene, drive.vehicle, values)


def _file(given: object) -> Path | None:
    return Path(given) if isinstance(given, str | Path) else None


def _place(T_world_vehicle: Array) -> str | None:
    """X,Y,YAW_DEG of a pose (4, 4) in the plane; None: it is not in it."""
    yaw_deg = np.degrees(np.arctan2(T_world_vehicle[1, 0], T_world_vehicle[0, 0]))
    numbers = (*T_world_vehicle[:2, 3].tolist(), float(yaw_deg))
    text = ",".join(repr(number).removesuffix(".0") for number in numbers)
    return text if np.allclose(place(text), T_world_vehicle, rtol=0, atol=1e-12) else None
