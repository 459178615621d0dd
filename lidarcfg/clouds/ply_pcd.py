"""Reads PLY and PCD files, ours or another program's, into the columns of a cloud; by plyfile and pypcd4."""

import json
import struct
import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import CloudError
from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS

# Names in use for each field; the first that a file has is taken. CloudCompare puts scalar_ before them.
ALIASES = {
    "intensity": ("intensity", "reflectivity", "reflectance"),
    "ring": ("ring", "laser_id", "laser", "channel"),
    "time_ns": ("time_ns", "timestamp", "time", "t"),
    "sensor": ("sensor",),
    "return_type": ("return_type",),
}
PREFIX = "scalar_"
TIME_PARTS = ("time_s", "time_rest_ns")  # in our PLY files
SECONDS_MAX = 2**63 // SECOND_NS  # whole seconds that, with the rest of one, are an int64 of nanoseconds
NANOSECONDS_FROM = 1e11  # a float time beyond is in nanoseconds (Livox): in seconds it would be the year 5138
WHOLE_MAX = 2.0**53  # of a float
INTENSITY_MAX = 255
HEADER_LINES_MAX = 1000  # of a PCD file
HEADER_LINE_MAX = 4096
VALUES_MAX = 1000  # a point
# What pypcd4 raises for damaged files: pydantic's and numpy's ValueError, IndexError and KeyError for lists of unlike
# lengths, RuntimeError and TypeError for compressed data that do not unpack, and the last two for absurd counts.
PCD_ERRORS = (ValueError, IndexError, KeyError, RuntimeError, TypeError, struct.error, MemoryError, OverflowError)

Column = NDArray[Any]


def read_columns(path: Path, on_warning: Callable[[str], None]) -> dict[str, Any]:
    """The file's fields as a cloud's columns and the names of its sensors. Raises CloudError.

    Fields that the file lacks are 0. In a file that names no sensors, and so is not ours, points without finite
    coordinates stand for no return and are dropped. One warning says all that was assumed, scaled, dropped or ignored.
    """
    rows, comments = read_rows(path)
    fields = {_plain(name): rows[name] for name in rows.dtype.names or () if rows.dtype[name].kind in "iuf"}
    if absent := [name for name in "xyz" if name not in fields]:
        raise CloudError(f"{path}: missing: {', '.join(absent)}")
    xyz = np.stack([fields.pop(name) for name in "xyz"], axis=1, dtype=np.float64)
    names = Names(_listed(path, comments, "sensor"), _listed(path, comments, "object"), path.stem)
    columns, others, remarks = columns_of(str(path), xyz, fields, names)
    remarks += [f"{', '.join(others)} ignored"] * bool(others)
    if remarks:
        on_warning(f"{path}: {'; '.join(remarks)}")
    return columns


class Names(NamedTuple):
    """The names that come with points."""

    sensors: list[Any] | None  # None: the points are another program's
    objects: list[Any] | None  # None: what the points are of is not known
    source: str  # of the only sensor, where there is no other name


def columns_of(
    source: str, xyz: Array, fields: dict[str, Column], names: Names
) -> tuple[dict[str, Any], dict[str, Column], list[str]]:
    """The columns of a cloud of points (N, 3) with fields (N,) by their names in lower case, from a source.

    Also the fields that no column holds, and remarks on what was assumed, scaled or dropped. Raises CloudError.
    """
    remarks = []
    if names.sensors is None and not (finite := np.isfinite(xyz).all(axis=1)).all():
        remarks.append(f"{(~finite).sum()} points without coordinates are dropped")
        xyz = xyz[finite]
        fields = {name: field[finite] for name, field in fields.items()}
    fields = dict(fields)
    if fields.keys() >= set(TIME_PARTS):
        fields["time_ns"] = _joined_ns(source, *(fields.pop(name) for name in TIME_PARTS))

    columns: dict[str, Any] = {"xyz": xyz}
    lacking = []
    for key, aliases in ALIASES.items():
        name = next((alias for alias in aliases if alias in fields), None)
        if name is None:
            lacking.append(key)
            columns[key] = np.zeros(len(xyz), np.uint8)
        elif key == "time_ns":
            columns[key] = _nanoseconds(source, name, fields.pop(name), remarks)
        elif key == "intensity" and names.sensors is None:
            columns[key] = _intensity(source, name, fields.pop(name), remarks)
        else:
            columns[key] = _whole(source, name, fields.pop(name))
    if names.objects is not None and "object" in fields:  # ours, with ground truth
        columns |= {"object": _whole(source, "object", fields.pop("object")), "object_names": names.objects}
    if lacking:
        remarks.insert(0, f"has no {', '.join(lacking)}; 0 is assumed")
    columns["sensor_names"] = names.sensors or _numbered(names.source, columns["sensor"], "sensor" in lacking)
    return columns, fields, remarks


def read_rows(path: Path) -> tuple[Column, list[str]]:
    """The points of a file as a structured array, and its comments. Raises CloudError."""
    try:
        return _read_ply(path) if path.suffix.lower() == ".ply" else _read_pcd(path)
    except OSError as error:
        raise CloudError.from_os(path, error) from None


def _read_ply(path: Path) -> tuple[Column, list[str]]:
    """The vertices as a structured array, and the comments."""
    import plyfile

    try:
        data = plyfile.PlyData.read(str(path))
    except (plyfile.PlyParseError, ValueError, OverflowError, MemoryError) as error:  # absurd sizes are the last two
        raise CloudError.damaged(path, error) from None
    if "vertex" not in data:
        raise CloudError(f"{path}: not a whole ply file: it has no element vertex")
    return data["vertex"].data, data.comments


def _read_pcd(path: Path) -> tuple[Column, list[str]]:
    """The points as a structured array, and the comments."""
    from pypcd4.pypcd4 import PointCloud

    with open(path, "rb") as file:
        lines = [file.readline(HEADER_LINE_MAX)]
        while not lines[-1].startswith(b"DATA"):
            if len(lines) == HEADER_LINES_MAX or not lines[-1]:
                raise CloudError(f"{path}: not a whole pcd file: no header")
            lines.append(file.readline(HEADER_LINE_MAX))
        try:
            counts = [int(word) for line in lines if line.startswith(b"COUNT") for word in line.split()[1:]]
            if sum(counts) > VALUES_MAX:  # each becomes a field
                raise CloudError(f"{path}: a point has {sum(counts)} values; allowed: up to {VALUES_MAX}")
            file.seek(0)
            stream: Any = file
            if b"ascii" in lines[-1]:  # pypcd4 wants one space between values, and none at the end
                stream = BytesIO(b"\n".join(b" ".join(line.split()) for line in file))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # numpy's, where there is no point
                cloud = PointCloud.from_fileobj(stream)
        except PCD_ERRORS as error:
            raise CloudError.damaged(path, error) from None
    rows = np.atleast_1d(cloud.pc_data)
    points = cloud.metadata.points
    if len(rows) != points:
        raise CloudError(f"{path}: {points} points are announced, {len(rows)} are there")
    return rows, [line[1:].decode("ascii", "replace").strip() for line in lines if line.startswith(b"#")]


def _plain(name: str) -> str:
    return name.lower().removeprefix(PREFIX)


def _listed(path: Path, comments: list[str], kind: str) -> list[Any] | None:
    """The names of sensors or objects that our comments list, or none."""
    found = [comment.partition(" ")[2] for comment in comments if comment.startswith(f"{kind} ")]
    try:
        return [json.loads(name) for name in found] or None
    except (ValueError, RecursionError):
        raise CloudError(f"{path}: the {kind}s' names are not JSON") from None


def _numbered(source: str, sensor: Column, unknown: bool) -> list[str]:
    """Names for sensors without any: their numbers, or without numbers the source's name."""
    most = int(sensor.max(initial=0))
    return [source] if unknown or not 0 < most <= np.iinfo(np.uint16).max else [str(i) for i in range(most + 1)]


def _joined_ns(source: str, time_s: Column, rest_ns: Column) -> Column:
    """Whole seconds, in floats, and the rest of one, exactly. Raises CloudError."""
    if not (np.isfinite(time_s).all() and ((abs(time_s) < SECONDS_MAX) & (np.floor(time_s) == time_s)).all()):
        raise CloudError(f"{source}: allowed for time_s are whole numbers below {SECONDS_MAX}")
    if rest_ns.dtype.kind not in "iu" or not ((rest_ns >= 0) & (rest_ns < SECOND_NS)).all():
        raise CloudError(f"{source}: allowed for time_rest_ns are the integers 0 to {SECOND_NS - 1}")
    return np.asarray(time_s.astype(np.int64) * SECOND_NS + rest_ns.astype(np.int64))


def _nanoseconds(source: str, name: str, column: Column, remarks: list[str]) -> Column:
    """Integers as they are; floats, which are of seconds or, where they are large, of nanoseconds."""
    if column.dtype.kind != "f":
        return column
    unit_ns = 1 if abs(column).max(initial=0) > NANOSECONDS_FROM else SECOND_NS
    if not (np.isfinite(column).all() and (abs(column) < SECONDS_MAX * SECOND_NS / unit_ns).all()):
        raise CloudError(f"{source}: {name} holds times that are not finite, or beyond 292 years")
    remarks.append(f"{name} is taken for {'nanoseconds' if unit_ns == 1 else 'seconds'}")
    whole = np.floor(column.astype(np.float64))
    return np.asarray(whole.astype(np.int64) * unit_ns + np.rint((column - whole) * unit_ns).astype(np.int64))


def _intensity(source: str, name: str, column: Column, remarks: list[str]) -> Column:
    """Intensities from 0 to 255: rounded if they are within that; fractions of 1, and others beyond it, are scaled."""
    values: Array = column.astype(np.float64)
    if not np.isfinite(values).all():
        raise CloudError(f"{source}: {name} is not finite")
    low = float(values.min(initial=0))
    high = float(values.max(initial=0))
    fractions = bool((values % 1).any())
    if low < 0 or high > INTENSITY_MAX or (fractions and high <= 1):
        high = max(high, 1.0)
        remarks.append(f"{name}, from {low:g} to {high:g}, is scaled to 0 to {INTENSITY_MAX}")
        values = np.interp(values, (low, high), (0, INTENSITY_MAX))
    elif fractions:
        remarks.append(f"{name} is rounded")
    return np.rint(values).astype(np.int64)


def _whole(source: str, name: str, column: Column) -> Column:
    """Integers, also where another program wrote them as floats."""
    if column.dtype.kind != "f":
        return column
    if not (np.isfinite(column).all() and (abs(column) <= WHOLE_MAX).all() and (column % 1 == 0).all()):
        raise CloudError(f"{source}: {name} holds something other than whole numbers")
    return column.astype(np.int64)
