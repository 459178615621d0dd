"""From a rig and a scene, or their files, to a capture or to points with ground truth, in one call."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import LidarcfgError
from lidarcfg.files import together
from lidarcfg.formats import formats
from lidarcfg.formats.recording import Recording
from lidarcfg.geometry import Array
from lidarcfg.rig import Rig, load_rig
from lidarcfg.simulate import export as packets
from lidarcfg.simulate.scans import simulated_scans
from lidarcfg.simulate.tasks import START_NS, Drive
from lidarcfg.units import SECOND_NS
from lidarcfg.world.motion import Trajectory, standing
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
) -> None:
    """Write what a rig's sensors send, or see, in a scene: the formats of `lidarcfg export`, by suffix or `to`.

    The vehicle stands at `at`, T_world_vehicle (4, 4), at the origin without it, or moves along a trajectory; the rig's
    own vehicle travels along and blocks beams. Simulated time begins at START_NS. Raises LidarcfgError.
    """
    if not 0 < duration_s <= 86_400:
        raise LidarcfgError(f"duration_s is {duration_s:g}; allowed: above 0, at most 86400")
    rig = rig if isinstance(rig, Rig) else load_rig(rig)
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    moved = at if isinstance(at, Trajectory) else standing(np.eye(4) if at is None else at)
    drive = Drive(rig, scene, moved, rig_vehicle(rig), START_NS, round(duration_s * SECOND_NS))
    output = Path(output)
    if output.suffix != ".pcap" or to:
        form = formats.format_of("drive", output, to)
        formats.save_recording(output, form, Recording(drive, simulated_scans(drive)), False, on_warning)
        return
    streams = packets.export(rig, scene, moved, drive.duration_ns, vehicle=drive.vehicle)
    with together():
        packets.save_companions(output, rig.mounts)
        write_pcap(output, packets.in_time_order(streams))
