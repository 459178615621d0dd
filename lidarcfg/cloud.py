"""Points: merge, save, load. Files are .npz, .ply and .pcd, each with every field and exact times."""

import json
import lzma
import os
import struct
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import copyfileobj
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import CloudError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS

SUFFIXES = (".ply", ".pcd", ".npz")
FIELDS: dict[str, Any] = {
    "xyz": np.float64,
    "intensity": np.uint8,
    "ring": np.uint8,
    "time_ns": np.int64,
    "sensor": np.uint16,
    "return_type": np.uint8,
}
_BYTES = [("intensity", "u1"), ("ring", "u1"), ("return_type", "u1")]
_XYZ = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
# PLY knows no 64-bit integers, and Open3D's reader neither short nor uint: the time is whole seconds + rest.
PLY_ROW = np.dtype([*_XYZ, *_BYTES, ("sensor", "<i4"), ("time_s", "<f8"), ("time_rest_ns", "<i4")])
PCD_ROW = np.dtype([*_XYZ, *_BYTES, ("sensor", "<u2"), ("time_ns", "<i8")])
PLY_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "uint": "<u4", "short": "<i2", "ushort": "<u2"}
PLY_TYPES |= {"char": "i1", "uchar": "u1", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2"}
PLY_TYPES |= {"int32": "<i4", "uint32": "<u4", "float32": "<f4", "float64": "<f8"}
PCD_TYPES = {f"{kind}{size}" for kind in "IU" for size in (1, 2, 4, 8)} | {"F4", "F8"}
HEADER_LINES_MAX = 10_000
XYZ_MAX_M = np.float64(1e9)
SECONDS_MAX = 2**63 // SECOND_NS  # so many, and the rest of one, are an int64 of nanoseconds
# What numpy, zipfile and json raise on bytes that make no sense; an encrypted zip is a RuntimeError, as is one of an
# odd version (NotImplementedError), and absurd sizes are OverflowError and MemoryError.
DAMAGE = (
    *(ValueError, KeyError, IndexError, TypeError, EOFError, OverflowError, MemoryError, RuntimeError),
    *(SyntaxError, tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
)


@dataclass(frozen=True)
class PointCloud:
    """N points, in one frame or, where no rig is known, each in its sensor's."""

    xyz: Array  # (N, 3) in metres
    intensity: NDArray[np.uint8]  # (N,) 0-100 diffuse in per cent, 101-255 retro-reflectors
    ring: NDArray[np.uint8]  # (N,) 0 is the sensor's lowest beam
    time_ns: NDArray[np.int64]  # (N,) device time since 1970
    sensor: NDArray[np.uint16]  # (N,) index into sensor_names
    sensor_names: tuple[str, ...]
    return_type: NDArray[np.uint8]  # (N,) 0 strongest, 1 last, 2 second strongest, where the last is the strongest

    @classmethod
    def none(cls, sensor_names: tuple[str, ...]) -> "PointCloud":
        """No points of these sensors."""
        columns = {key: np.empty((0, 3) if key == "xyz" else 0, kind) for key, kind in FIELDS.items()}
        return cls(sensor_names=sensor_names, **columns)


def concatenate(clouds: Sequence[PointCloud]) -> PointCloud:
    """The clouds as one; sensors of the same name are the same sensor."""
    index: dict[str, int] = {}
    sensor = [_sensor(cloud, index) for cloud in clouds]
    columns = {
        key: np.concatenate([np.empty((0, 3) if key == "xyz" else 0, kind), *(getattr(c, key) for c in clouds)])
        for key, kind in FIELDS.items()
        if key != "sensor"
    }
    columns["sensor"] = np.concatenate([np.empty(0, np.uint16), *sensor])
    return PointCloud(sensor_names=tuple(index), **columns)


def _sensor(cloud: PointCloud, index: dict[str, int]) -> NDArray[np.uint16]:
    """The cloud's sensors as numbers in `index`, which learns the names that it does not know."""
    table = [index.setdefault(name, len(index)) for name in cloud.sensor_names]
    return cloud.sensor if table == list(range(len(table))) else np.array(table, np.uint16)[cloud.sensor]


def save_clouds(path: str | Path, clouds: Iterable[PointCloud]) -> int:
    """Write the clouds as one file, whole or not at all, and return how many points.

    PLY and PCD are streamed: no more than a cloud is held in memory. Raises CloudError.
    """
    path = Path(path)
    kind = _suffix(path)
    try:
        if kind == ".npz":
            whole = concatenate(list(clouds))
            with replacing(path, "wb") as file:
                names = np.array(whole.sensor_names, np.str_)
                np.savez(file, sensor_names=names, **{key: getattr(whole, key) for key in FIELDS})
            return len(whole.xyz)
        with tempfile.TemporaryFile(dir=path.parent) as body, replacing(path, "wb") as file:
            index: dict[str, int] = {}
            dtype, head = (PLY_ROW, _ply_header) if kind == ".ply" else (PCD_ROW, _pcd_header)
            for cloud in clouds:
                body.write(_rows(cloud, _sensor(cloud, index), dtype).tobytes())
            count = body.tell() // dtype.itemsize
            body.seek(0)
            file.write(head(count, list(index)).encode())
            copyfileobj(body, file, 1 << 20)
        return count
    except OSError as error:
        raise CloudError(f"{path}: {(error.strerror or str(error)).lower()}") from None


def load_cloud(path: str | Path, allow_empty: bool = False) -> PointCloud:
    """The cloud in a file such as `save_clouds` writes. Raises CloudError for anything that no cloud holds."""
    path = Path(path)
    kind = _suffix(path)
    try:
        return checked(path, _read_npz(path) if kind == ".npz" else _read_rows(path, kind), allow_empty)
    except OSError as error:
        raise CloudError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except DAMAGE as error:
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise CloudError(f"{path}: not a whole {kind[1:]} file: {what}") from None


def checked(path: Path, columns: dict[str, Any], allow_empty: bool = False) -> PointCloud:
    """The columns as a cloud. Raises CloudError unless each holds what its field allows."""
    missing = [key for key in (*FIELDS, "sensor_names") if key not in columns]
    if missing:
        raise CloudError(f"{path}: missing: {', '.join(missing)}")
    for key in FIELDS:
        letters, kinds = ("f", "floats") if key == "xyz" else ("iu", "integers")
        if columns[key].dtype.kind not in letters:
            raise CloudError(f"{path}: {key} is of type {columns[key].dtype}; allowed: {kinds}")
    xyz, names = columns["xyz"], _names(path, columns["sensor_names"])
    if xyz.shape == (0, 3) and not allow_empty:
        raise CloudError(f"{path}: the cloud is empty")
    if xyz.shape[1:] != (3,) or any(columns[key].shape != xyz.shape[:1] for key in FIELDS if key != "xyz"):
        raise CloudError(f"{path}: the fields are not of one length")
    far = np.flatnonzero(~(abs(xyz) <= XYZ_MAX_M).all(axis=1))
    if len(far):
        what = f"beyond {XYZ_MAX_M:g} m" if np.isfinite(xyz[far[0]]).all() else "not finite"
        raise CloudError(f"{path}: point {far[0]} is {what}")
    for key, kind in FIELDS.items():
        if key != "xyz":
            column, allowed = columns[key], np.iinfo(kind)
            bad = np.flatnonzero((column < allowed.min) | (column > allowed.max))
            if len(bad):
                what = f"point {bad[0]}: {key} is {column[bad[0]]}"
                raise CloudError(f"{path}: {what}; allowed: {allowed.min} to {allowed.max}")
    if len(xyz) and columns["sensor"].max() >= len(names):
        raise CloudError(f"{path}: a point is of sensor {columns['sensor'].max()}; there are {len(names)}")
    return PointCloud(sensor_names=names, **{key: columns[key].astype(FIELDS[key]) for key in FIELDS})


def _names(path: Path, names: Any) -> tuple[str, ...]:
    """The names of the sensors. Raises CloudError unless they are texts that can be written."""
    if isinstance(names, np.ndarray):
        names = names.tolist() if names.ndim == 1 else [names]
    for name in names:
        if not isinstance(name, str):
            raise CloudError(f"{path}: sensor_names holds something other than a list of texts")
        try:
            name.encode()
        except UnicodeEncodeError:
            raise CloudError(f"{path}: the sensor name {name!r} is not Unicode text") from None
    return tuple(names)


def _suffix(path: Path) -> str:
    if path.suffix.lower() not in SUFFIXES:
        raise CloudError(f"{path}: {path.suffix or 'no suffix'} is not a kind of cloud; allowed: {', '.join(SUFFIXES)}")
    return path.suffix.lower()


def _rows(cloud: PointCloud, sensor: NDArray[np.uint16], dtype: np.dtype[np.void]) -> NDArray[np.void]:
    rows = np.empty(len(cloud.xyz), dtype)
    rows["x"], rows["y"], rows["z"] = cloud.xyz.T
    for key, _ in _BYTES:
        rows[key] = getattr(cloud, key)
    rows["sensor"] = sensor
    if "time_ns" in (dtype.names or ()):
        rows["time_ns"] = cloud.time_ns
    else:
        rows["time_s"], rows["time_rest_ns"] = np.divmod(cloud.time_ns, SECOND_NS)
    return rows


def _ply_header(count: int, names: list[str]) -> str:
    kinds = {np.dtype(kind): name for name, kind in reversed(PLY_TYPES.items())}
    return "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment time is time_s + time_rest_ns",
            *(f"comment sensor {json.dumps(name)}" for name in names),
            f"element vertex {count}",
            *(f"property {kinds[PLY_ROW[key]]} {key}" for key in PLY_ROW.names or ()),
            "end_header\n",
        ]
    )


def _pcd_header(count: int, names: list[str]) -> str:
    kinds = [PCD_ROW[key] for key in PCD_ROW.names or ()]
    return "\n".join(
        [
            "# .PCD v0.7 - Point Cloud Data file format",
            *(f"# sensor {json.dumps(name)}" for name in names),
            "VERSION 0.7",
            f"FIELDS {' '.join(PCD_ROW.names or ())}",
            f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
            f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}",
            f"COUNT {' '.join('1' for _ in kinds)}",
            f"WIDTH {count}",
            "HEIGHT 1",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {count}",
            "DATA binary\n",
        ]
    )


def _read_npz(path: Path) -> dict[str, Any]:
    with open(path, "rb") as file:
        arrays = np.load(file, allow_pickle=False)
        if not isinstance(arrays, np.lib.npyio.NpzFile):
            raise ValueError("allowed is an archive of arrays")
        with arrays:
            return {key: np.asarray(arrays[key]) for key in (*FIELDS, "sensor_names") if key in arrays}


def _read_rows(path: Path, kind: str) -> dict[str, Any]:
    with open(path, "rb") as file:
        lines = _header(file, "end_header" if kind == ".ply" else "DATA")
        dtype, count = _ply_layout(lines) if kind == ".ply" else _pcd_layout(lines)
        there = (os.fstat(file.fileno()).st_size - file.tell()) // max(dtype.itemsize, 1)
        if not 0 <= count <= there:
            raise ValueError(f"{count} points are announced, {there} are there")
        rows = np.fromfile(file, dtype, count)
    fields = dtype.names or ()
    columns: dict[str, Any] = {key: rows[key] for key in FIELDS if key in fields}
    if {"time_s", "time_rest_ns"} <= set(fields):
        columns["time_ns"] = _time_ns(rows["time_s"], rows["time_rest_ns"])
    if {"x", "y", "z"} <= set(fields):
        columns["xyz"] = np.stack([rows["x"], rows["y"], rows["z"]], axis=1)
    names = [line.split(maxsplit=2)[2] for line in lines if line.startswith(("comment sensor ", "# sensor "))]
    return columns | ({"sensor_names": [json.loads(name) for name in names]} if names else {})


def _time_ns(time_s: NDArray[Any], rest_ns: NDArray[Any]) -> NDArray[np.int64]:
    """Whole seconds, which may be floats, and the rest of one, exactly. Raises ValueError."""
    if not (np.isfinite(time_s).all() and ((abs(time_s) < SECONDS_MAX) & (np.floor(time_s) == time_s)).all()):
        raise ValueError(f"allowed for time_s are whole numbers below {SECONDS_MAX}")
    if rest_ns.dtype.kind not in "iu" or not ((rest_ns >= 0) & (rest_ns < SECOND_NS)).all():
        raise ValueError(f"allowed for time_rest_ns are the integers 0 to {SECOND_NS - 1}")
    return time_s.astype(np.int64) * SECOND_NS + rest_ns.astype(np.int64)


def _header(file: IO[bytes], last: str) -> list[str]:
    lines = []
    for _ in range(HEADER_LINES_MAX):
        lines.append(file.readline(4096).decode("ascii").strip())
        if lines[-1].split(" ")[0] == last:
            return lines
    raise ValueError("no header")


def _ply_layout(lines: list[str]) -> tuple[np.dtype[np.void], int]:
    if lines[0] != "ply" or "format binary_little_endian 1.0" not in lines:
        raise ValueError("allowed is the format binary_little_endian 1.0")
    words = [line.split() for line in lines]
    elements = [word for word in words if word[0] == "element"]
    if [element[1] for element in elements] != ["vertex"]:
        raise ValueError("allowed is the element vertex, alone")
    return np.dtype([(word[2], PLY_TYPES[word[1]]) for word in words if word[0] == "property"]), int(elements[0][2])


def _pcd_layout(lines: list[str]) -> tuple[np.dtype[np.void], int]:
    words = {line.split()[0]: line.split()[1:] for line in lines if line}
    lacking = [key for key in ("FIELDS", "TYPE", "SIZE", "POINTS") if not words.get(key)]
    if lacking:
        raise ValueError(f"no {', '.join(lacking)}")
    if words["DATA"] != ["binary"]:
        raise ValueError("allowed is DATA binary")
    if words.get("COUNT", []) != ["1"] * len(words.get("COUNT", [])):
        raise ValueError("allowed is COUNT 1 for each field")
    types = [kind + size for kind, size in zip(words["TYPE"], words["SIZE"], strict=True)]
    if not PCD_TYPES.issuperset(types):
        raise ValueError(f"allowed for TYPE and SIZE are {', '.join(sorted(PCD_TYPES))}")
    columns = zip(words["FIELDS"], types, strict=True)
    return np.dtype([(name, f"<{kind.lower()}") for name, kind in columns]), int(words["POINTS"][0])
