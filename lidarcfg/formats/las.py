"""LAS 1.4 and LAZ, by laspy: point format 6 with extra dimensions for ring, sensor and return type."""

import json
import os
import struct
from collections.abc import Callable
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lidarcfg
from lidarcfg.cloud import DAMAGE, PointCloud, checked
from lidarcfg.errors import CloudError
from lidarcfg.files import replacing
from lidarcfg.formats.extra import missing
from lidarcfg.formats.gps import gps_seconds, unix_ns
from lidarcfg.geometry import Array

STEP_M = 1e-4  # of a coordinate, which is an int32 of them from the file's offset on
REACH_M = STEP_M * (2**31 - 2)
INTENSITY_STEP = 256  # LAS 1.4: intensity is normalised to 16 bits, by 65,536 over the sensor's range of 256
VLR_USER, VLR_RECORD, VLR_MAX = "lidarcfg", 1, 65_535
EXTRA = {
    "ring": (np.uint8, "0 is the lowest beam"),
    "sensor": (np.uint16, "index into the names in the VLR"),
    "return_type": (np.uint8, "0 strongest 1 last 2 2nd str."),
}
TIME_MAX_S = 9e9  # beyond it, nanoseconds since 1970 do not fit into int64
DAY_NS = 86_400 * 10**9
CHUNK = 1 << 20  # points
CHUNK_BYTES = 1 << 26  # of them when read, whatever the size of a point
VLRS_AT, VLR_HEAD = 100, 54  # bytes: where the header counts its VLRs, and the least that one takes (LAS 1.4)


def save_las(path: Path, cloud: PointCloud) -> None:
    """Write the cloud as .las or .laz, whole or not at all.

    Coordinates are kept to 0.05 mm, times to 30 ns. Raises CloudError for a cloud that is not finite or reaches
    too far, HandoverError without laspy.
    """
    laspy = _laspy()
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, STEP_M), _offsets(path, cloud.xyz)
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, type=kind, description=what) for name, (kind, what) in EXTRA.items()]
    )
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = True  # point formats from 6 on must say so
    header.system_identifier, header.generating_software = "lidarcfg", f"lidarcfg {lidarcfg.__version__}"
    newest_ns = int(cloud.time_ns.max(initial=0))
    header.creation_date = date(1970, 1, 1) + timedelta(days=newest_ns // DAY_NS)  # the same cloud, the same bytes
    names = json.dumps(cloud.sensor_names).encode()
    if len(names) > VLR_MAX:
        raise CloudError(f"{path}: the sensors' names take {len(names)} bytes; a LAS file has {VLR_MAX} for them")
    header.vlrs.append(laspy.VLR(VLR_USER, VLR_RECORD, "names of the sensors", names))
    with (
        replacing(path, "wb") as file,
        laspy.open(file, "w", header=header, do_compress=path.suffix.lower() == ".laz", closefd=False) as writer,
    ):
        for first in range(0, len(cloud.xyz), CHUNK):
            part = slice(first, first + CHUNK)
            rows = laspy.ScaleAwarePointRecord.zeros(len(cloud.xyz[part]), header=header)
            rows.x, rows.y, rows.z = cloud.xyz[part].T
            rows.intensity = cloud.intensity[part].astype(np.uint16) * INTENSITY_STEP
            rows.gps_time = gps_seconds(cloud.time_ns[part])
            rows.return_number = rows.number_of_returns = np.ones(len(rows), np.uint8)
            for name in EXTRA:
                rows[name] = getattr(cloud, name)[part]
            writer.write_points(rows)


def _offsets(path: Path, xyz: Array) -> Array:
    """(3,) whole metres in the middle of the cloud."""
    if not len(xyz):
        return np.zeros(3)
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    if not np.isfinite(high - low).all():
        raise CloudError(f"{path}: a point is not finite")
    middle = np.rint((low + high) / 2)
    if max((high - middle).max(), (middle - low).max()) > REACH_M:
        raise CloudError(f"{path}: the cloud is {(high - low).max():.0f} m wide; LAS in steps of 0.1 mm has 429496")
    return np.asarray(middle)


def load_las(path: Path, on_warning: Callable[[str], None]) -> PointCloud:
    """The cloud in a .las or .laz, ours or another's; `on_warning` is told which fields it lacks, which are then 0.

    Raises CloudError, and HandoverError without laspy.
    """
    laspy = _laspy()
    try:
        _check_vlrs(path)
        with laspy.open(path, read_evlrs=False) as reader:
            header = reader.header
            chunks = [_columns(laspy.ScaleAwarePointRecord.zeros(0, header=header))]
            left = header.point_count
            while left:
                wanted = min(left, CHUNK, max(1, CHUNK_BYTES // header.point_format.size))
                chunks.append(_columns(reader.read_points(wanted)))
                if len(chunks[-1]["xyz"]) != wanted:
                    raise ValueError(f"{header.point_count} points are announced, and not there")
                left -= wanted
        columns = {key: np.concatenate([chunk[key] for chunk in chunks]) for key in chunks[0]}
        count = len(columns["xyz"])
        given = [vlr for vlr in header.vlrs if (vlr.user_id, vlr.record_id) == (VLR_USER, VLR_RECORD)]
        names = json.loads(given[0].record_data) if given else None
        week = header.global_encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME
        if "gps_time" in columns:
            gps_s = columns.pop("gps_time")
            if not (abs(gps_s) < TIME_MAX_S).all():
                raise ValueError(f"allowed for gps_time are seconds below {TIME_MAX_S:g}")
            columns["time_ns"] = np.rint(gps_s * 1e9).astype(np.int64) if week else unix_ns(gps_s)
    except OSError as error:
        raise CloudError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except (laspy.LaspyException, *DAMAGE) as error:
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise CloudError(f"{path}: not a whole {path.suffix[1:].lower()} file: {what}") from None
    lacking = [key for key in ("time_ns", *EXTRA) if key not in columns]
    if lacking:
        on_warning(f"{path}: has no {', '.join(lacking)}; they are 0")
    if week and "time_ns" not in lacking:
        on_warning(f"{path}: its times are of a week that it does not name; 0 is the week's beginning")
    if (columns["intensity"] % INTENSITY_STEP).any():
        on_warning(f"{path}: intensities of 16 bits are rounded down to 8")
    columns["intensity"] = columns["intensity"] // INTENSITY_STEP
    columns |= dict.fromkeys(lacking, np.zeros(count, np.int64))
    if names is None:
        names = [str(number) for number in range(int(columns["sensor"].max(initial=0)) + 1)]
    return checked(path, columns | {"sensor_names": names}, allow_empty=True)


def _check_vlrs(path: Path) -> None:
    """Raises ValueError where the header announces more VLRs than the file can hold; laspy would look for them all."""
    with open(path, "rb") as file:
        (count,) = struct.unpack_from("<I", file.read(VLRS_AT + 4), VLRS_AT)
        if count * VLR_HEAD > file.seek(0, os.SEEK_END):
            raise ValueError(f"{count} VLRs are announced, and not there")


def _columns(rows: Any) -> dict[str, NDArray[Any]]:
    """What we keep of a chunk of points, as it stands there."""
    there = set(rows.point_format.dimension_names)
    columns = {key: np.array(rows[key]) for key in ("intensity", "gps_time", *EXTRA) if key in there}
    return {"xyz": np.stack([rows.x, rows.y, rows.z], axis=1).astype(np.float64)} | columns


def _laspy() -> Any:
    try:
        import laspy
        import lazrs  # noqa: F401
    except ImportError:
        raise missing("laspy[lazrs]") from None
    return laspy
