"""KITTI's .bin: x, y, z and reflectance of each point as four little-endian float32, nothing else."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg.clouds.cloud import PointCloud, checked
from lidarcfg.errors import CloudError
from lidarcfg.files import replacing
from lidarcfg.inputs import check_memory, check_regular

FULL = 255  # the intensity that is a reflectance of 1
WARNING_M = 1e-4  # float32 rounding beyond that is worth a warning
CHUNK = 1 << 20  # points
FILE_COPIES = 8  # of a file, in memory at once
LACKS = ("ring", "time_ns", "sensor", "return_type")


def save_kitti(path: str | Path, cloud: PointCloud, on_warning: Callable[[str], None], chunk: int = CHUNK) -> None:
    """Write the cloud's positions and intensities, whole or not at all, `chunk` points at a time.

    Raises CloudError unless all are finite.
    """
    moved_m = 0.0
    with replacing(path, "wb") as file:
        for first in range(0, len(cloud.xyz), chunk):
            part = slice(first, first + chunk)
            xyz = cloud.xyz[part]
            if not np.isfinite(xyz).all():
                raise CloudError(f"{path}: a point is not finite")
            rows = np.column_stack([xyz, cloud.intensity[part] / FULL]).astype("<f4")
            moved_m = max(moved_m, float(abs(rows[:, :3] - xyz).max()))
            file.write(rows.tobytes())
    if moved_m > WARNING_M:
        on_warning(f"{path}: float32 moves a point by up to {moved_m:.2g} m")


def load_kitti(path: str | Path, on_warning: Callable[[str], None]) -> PointCloud:
    """The cloud in a .bin, of one sensor named after the file; `on_warning` gets a line on what it lacks.

    Raises CloudError.
    """
    path = Path(path)
    if path.name.lower().endswith(".pcd.bin"):
        raise CloudError(f"{path}: is a nuScenes file, with five numbers a point; allowed: KITTI's four")
    try:
        check_memory(str(path), FILE_COPIES * check_regular(path))
        raw = path.read_bytes()
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    if len(raw) % 16:
        raise CloudError(f"{path}: not a whole KITTI file: {len(raw)} bytes are not points of 16")
    rows = np.frombuffer(raw, "<f4").reshape(-1, 4)
    reflectance = rows[:, 3]
    odd = np.flatnonzero(~((reflectance >= 0) & (reflectance <= 1)))
    if len(odd):
        raise CloudError(f"{path}: point {odd[0]}: reflectance is {reflectance[odd[0]]:g}; allowed: 0 to 1")
    zeros = np.zeros(len(rows), np.int64)
    columns: dict[str, Any] = dict.fromkeys(LACKS, zeros)
    on_warning(f"{path}: has no {', '.join(LACKS)}; 0 is assumed")
    intensity = np.rint(reflectance * FULL).astype(np.int64)
    columns |= {"xyz": rows[:, :3].astype(np.float64), "intensity": intensity, "sensor_names": [path.stem]}
    return checked(path, columns, allow_empty=True)
