"""LAS 1.4 and LAZ, by laspy: writes our clouds in point format 6 with extra dimensions; reads any program's files.

The extra dimensions are ring, sensor and return type. Times are GPS time: seconds since 1980-01-06 including leap
seconds, minus 10^9.
"""

import errno
import json
import os
import struct
from collections.abc import Callable
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

import lidarcfg
from lidarcfg.clouds.cloud import PointCloud, checked
from lidarcfg.errors import CloudError, LidarcfgError, missing
from lidarcfg.files import replacing
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory, check_regular
from lidarcfg.units import SECOND_NS

STEP_M = 1e-4  # a coordinate is an int32 of these steps from the file's offset
RANGE_M = STEP_M * (2**31 - 2)
INTENSITY_STEP = 256  # LAS 1.4: intensity is normalised to 16 bits, by 65,536 over the sensor's range of 256
VLR_USER = "lidarcfg"
VLR_RECORD = 1
VLR_MAX = 65_535
EXTRA = {
    "ring": (np.uint8, "0 is the lowest beam"),
    "sensor": (np.uint16, "index into the names in the VLR"),
    "return_type": (np.uint8, "0 strong. 1 last 2 2nd 3 first"),
}
TIME_MAX_S = 9e9  # beyond it, nanoseconds since 1970 do not fit into int64
DAY_NS = 86_400 * 10**9
CHUNK = 1 << 20  # points
POINT_BYTES = 200  # of memory a point, with what is read and what it becomes
CHUNK_BYTES = 1 << 26  # read at a time, whatever the size of a point
# Places in the header and in a VLR, by LAS 1.4 and the LASzip specification: the header's size, where the points begin,
# the number of VLRs, the point format, with its highest bit set in LAZ, and a point's size; in a VLR its user, record
# and length; in LASzip's VLR the number of items, each with two bytes of type, of size and of version.
HEADER_AT = 94
POINTS_AT = 96
VLRS_AT = 100
FORMAT_AT = 104
SIZE_AT = 105
COMPRESSED = 0x80
VLR_USER_AT = 2
VLR_RECORD_AT = 18
VLR_HEAD = 54
LASZIP = b"laszip encoded"
LASZIP_ITEMS_AT = 32
CHUNK_LEAST = 20  # bytes, fewer than any chunk has
ADJUSTED_S = 10**9  # "adjusted standard GPS time": LAS 1.4, global encoding, bit 0
# Days that began after a leap second, since the start of GPS time: IERS Bulletin C.
LEAP_DAYS = (
    *("1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01"),
    *("1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01"),
    *("2015-07-01", "2017-01-01"),
)


def _unix_s(day: str) -> int:
    return int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp())


SHIFT_S = _unix_s("1980-01-06") + ADJUSTED_S
LEAPS_S = np.array([_unix_s(day) for day in LEAP_DAYS], np.int64)
COUNTED_S = LEAPS_S + np.arange(1, len(LEAPS_S) + 1)  # the same instants on a clock that counts them


def save_las(path: str | Path, cloud: PointCloud, chunk: int = CHUNK) -> None:
    """Write the cloud as .las or .laz, whole or not at all, `chunk` points at a time.

    Coordinates are kept to 0.05 mm, times to 30 ns. Raises CloudError for a cloud that is not finite or too
    wide, ConversionError without laspy, OSError for a full disk.
    """
    path = Path(path)
    laspy, lazrs = libraries()
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, STEP_M)
    header.offsets = _offsets(path, cloud.xyz)
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, type=kind, description=what) for name, (kind, what) in EXTRA.items()]
    )
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.global_encoding.wkt = True  # point formats from 6 on must say so
    header.system_identifier = "lidarcfg"
    header.generating_software = f"lidarcfg {lidarcfg.__version__}"
    newest_ns = int(cloud.time_ns.max(initial=0))
    header.creation_date = date(1970, 1, 1) + timedelta(days=newest_ns // DAY_NS)  # the same cloud, the same bytes
    names = json.dumps(cloud.sensor_names).encode()
    if len(names) > VLR_MAX:
        raise CloudError(f"{path}: the sensors' names take {len(names)} bytes; a LAS file has {VLR_MAX} for them")
    header.vlrs.append(laspy.VLR(VLR_USER, VLR_RECORD, "names of the sensors", names))
    # One thread: lazrs's parallel backend is no faster here, and leaves its thread pool open.
    compression = {"do_compress": path.suffix.lower() == ".laz", "laz_backend": laspy.LazBackend.Lazrs}
    try:
        with (
            replacing(path, "wb") as file,
            laspy.open(file, "w", header=header, closefd=False, **compression) as writer,
        ):
            for first in range(0, len(cloud.xyz), chunk):
                part = slice(first, first + chunk)
                rows = laspy.ScaleAwarePointRecord.zeros(len(cloud.xyz[part]), header=header)
                rows.x, rows.y, rows.z = cloud.xyz[part].T
                rows.intensity = cloud.intensity[part].astype(np.uint16) * INTENSITY_STEP
                rows.gps_time = gps_seconds(cloud.time_ns[part])
                rows.return_number = rows.number_of_returns = np.ones(len(rows), np.uint8)
                for name in EXTRA:
                    rows[name] = getattr(cloud, name)[part]
                writer.write_points(rows)
    except lazrs.LazrsError:  # which does not say why
        raise OSError(errno.EIO, "Not all of it could be written", str(path)) from None


def _offsets(path: Path, xyz: Array) -> Array:
    """(3,) whole metres at the midpoint of the bounds."""
    if not len(xyz):
        return np.zeros(3)
    low = xyz.min(axis=0)
    high = xyz.max(axis=0)
    if not np.isfinite(high - low).all():
        raise CloudError(f"{path}: a point is not finite")
    midpoint = np.rint((low + high) / 2)
    if max((high - midpoint).max(), (midpoint - low).max()) > RANGE_M:
        raise CloudError(f"{path}: the cloud is {(high - low).max():.0f} m wide; LAS in steps of 0.1 mm has 429496")
    return np.asarray(midpoint)


def load_las(path: str | Path, on_warning: Callable[[str], None]) -> PointCloud:
    """The cloud in a .las or .laz, ours or another program's.

    `on_warning` gets the fields that the file lacks, which are then 0. Raises CloudError, and ConversionError without
    laspy.
    """
    path = Path(path)
    laspy, lazrs = libraries()
    try:
        check_regular(path)
        check_header(path)
        with laspy.open(path, read_evlrs=False, laz_backend=laspy.LazBackend.Lazrs) as reader:
            columns = _read(laspy, reader)
            header = reader.header
        given = [vlr for vlr in header.vlrs if (vlr.user_id, vlr.record_id) == (VLR_USER, VLR_RECORD)]
        names = json.loads(given[0].record_data) if given else None
        week = header.global_encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    except (laspy.LaspyException, lazrs.LazrsError, ValueError) as error:  # the last is Unicode's, JSON's and numpy's
        raise CloudError.damaged(path, error) from None
    except LidarcfgError as error:  # of memory
        raise CloudError(f"{path}: {error}") from None
    if "gps_time" in columns:
        columns["time_ns"] = _time_ns(path, columns.pop("gps_time"), week)
    lacking = [key for key in ("time_ns", *EXTRA) if key not in columns]
    if lacking:
        on_warning(f"{path}: has no {', '.join(lacking)}; 0 is assumed")
    if week and "time_ns" not in lacking:
        on_warning(f"{path}: its times are of a week that it does not name; 0 is the week's beginning")
    if (columns["intensity"] % INTENSITY_STEP).any():
        on_warning(f"{path}: intensities of 16 bits are rounded down to 8")
    columns["intensity"] = columns["intensity"] // INTENSITY_STEP
    columns |= dict.fromkeys(lacking, np.zeros(len(columns["xyz"]), np.int64))
    if names is None:
        names = [str(number) for number in range(int(columns["sensor"].max(initial=0)) + 1)]
    return checked(path, columns | {"sensor_names": names}, allow_empty=True)


def _read(laspy: Any, reader: Any) -> dict[str, NDArray[Any]]:
    """All the points' columns that we keep. Raises ValueError where there are fewer than the header announces."""
    header = reader.header
    check_memory(f"a cloud of {header.point_count:,} points", POINT_BYTES * header.point_count)
    chunks = [_columns(laspy.ScaleAwarePointRecord.zeros(0, header=header))]
    left = header.point_count
    while left:
        wanted = min(left, CHUNK, max(1, CHUNK_BYTES // header.point_format.size))
        chunks.append(_columns(reader.read_points(wanted)))
        if len(chunks[-1]["xyz"]) != wanted:
            raise ValueError(f"{header.point_count} points are announced but missing")
        left -= wanted
    return {key: np.concatenate([part[key] for part in chunks]) for key in chunks[0]}


def _time_ns(path: Path, gps_s: Array, week: bool) -> NDArray[np.int64]:
    """Nanoseconds since 1970, or since a week's beginning. Raises CloudError."""
    if not (abs(gps_s) < TIME_MAX_S).all():
        raise CloudError(f"{path}: allowed for gps_time are seconds below {TIME_MAX_S:g}")
    return np.rint(gps_s * 1e9).astype(np.int64) if week else unix_ns(gps_s)


def _columns(rows: Any) -> dict[str, NDArray[Any]]:
    """The columns of a chunk of points that a cloud has, unconverted."""
    there = set(rows.point_format.dimension_names)
    columns = {key: np.array(rows[key]) for key in ("intensity", "gps_time", *EXTRA) if key in there}
    with np.errstate(over="ignore"):  # of absurd scales; what they make is not finite
        return {"xyz": np.stack([rows.x, rows.y, rows.z], axis=1).astype(np.float64)} | columns


def read_xyz(path: Path, most: int) -> Array:
    """(N, 3): where the points are. Raises CloudError, also for more than `most`, and ConversionError without laspy."""
    laspy, lazrs = libraries()
    try:
        check_header(path)
        with laspy.open(path, read_evlrs=False, laz_backend=laspy.LazBackend.Lazrs) as reader:
            count = reader.header.point_count
            if count > most:
                raise CloudError(f"{path}: has {count:,} points; allowed: at most {most:,}")
            rows = reader.read_points(count)
            if len(rows) != count:
                raise ValueError(f"{count} points are announced but missing")
            with np.errstate(over="ignore", invalid="ignore"):  # absurd scales give values that are not finite
                return np.stack([rows.x, rows.y, rows.z], axis=1).astype(np.float64)
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    except (laspy.LaspyException, lazrs.LazrsError, ValueError) as error:
        raise CloudError.damaged(path, error) from None


def check_header(path: Path) -> None:
    """Raises ValueError for sizes in the header that laspy and lazrs would trust.

    laspy would look for as many VLRs as are announced; lazrs would allocate memory for as many chunks, and end the
    process, and panic where the items of a point do not add up to its size.
    """
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        vlrs = _unpacked(file, VLRS_AT, "<I")[0]
        points_at = _unpacked(file, POINTS_AT, "<I")[0]
        if vlrs * VLR_HEAD > size:
            raise ValueError(f"{vlrs} VLRs are announced but missing")
        if not _unpacked(file, FORMAT_AT, "<B")[0] & COMPRESSED:
            return
        (table_at,) = _unpacked(file, points_at, "<q")
        if table_at == -1:  # the file was written as a stream, with the table at its end
            (table_at,) = _unpacked(file, size - 8, "<q")
        chunks = _unpacked(file, table_at, "<II")[1]  # after its version
        if chunks * CHUNK_LEAST > size:
            raise ValueError(f"{chunks} chunks are announced but missing")
        (at,) = _unpacked(file, HEADER_AT, "<H")
        for _ in range(vlrs):
            length = _unpacked(file, at + VLR_RECORD_AT, "<HH")[1]
            file.seek(at + VLR_USER_AT)
            if file.read(len(LASZIP)) == LASZIP:
                items_at = at + VLR_HEAD + LASZIP_ITEMS_AT
                (count,) = _unpacked(file, items_at, "<H")
                items = _unpacked(file, items_at + 2, f"<{3 * count}H")
                if not count or sum(items[1::3]) != _unpacked(file, SIZE_AT, "<H")[0]:
                    raise ValueError("its LASzip items are not those of its points")
            at += VLR_HEAD + length


def _unpacked(file: IO[bytes], at: int, form: str) -> tuple[int, ...]:
    """Numbers at a place of the file. Raises ValueError where there is none."""
    end = at + struct.calcsize(form)
    if not 0 <= at < end <= os.fstat(file.fileno()).st_size:
        raise ValueError(f"it has no byte {end - 1}")
    file.seek(at)
    return struct.unpack(form, file.read(end - at))


def libraries() -> tuple[Any, Any]:
    """laspy and lazrs."""
    try:
        import laspy
        import lazrs
    except ImportError:
        raise missing("laspy[lazrs]") from None
    return laspy, lazrs


def gps_seconds(time_ns: NDArray[np.int64]) -> Array:
    """(N,) adjusted standard GPS times of times (N,) in ns since 1970, UTC; to 30 ns until 2028, by float64."""
    whole_s, rest_ns = np.divmod(time_ns, SECOND_NS)
    leaps = np.searchsorted(LEAPS_S, whole_s, side="right")
    return np.asarray(whole_s - SHIFT_S + leaps + rest_ns / SECOND_NS)


def unix_ns(gps_s: Array) -> NDArray[np.int64]:
    """(N,) times in ns since 1970, UTC, of adjusted standard GPS times (N,)."""
    floor_s = np.floor(gps_s)
    whole_s = floor_s.astype(np.int64) + SHIFT_S
    whole_s -= np.searchsorted(COUNTED_S, whole_s, side="right")
    return np.asarray(whole_s * SECOND_NS + np.rint((gps_s - floor_s) * SECOND_NS).astype(np.int64))
