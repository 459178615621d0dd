"""Points: merge, save, load. Files are .npz, .ply and .pcd, each with every field and exact times."""

import json
import tempfile
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import copyfileobj
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config import replacing
from lidarcfg.errors import CloudError
from lidarcfg.geometry import Array

SUFFIXES = (".ply", ".pcd", ".npz")
SECOND_NS = 10**9
FIELDS = {
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
HEADER_LINES_MAX = 10_000


@dataclass(frozen=True)
class PointCloud:
    """N points, in one frame or, where no rig is known, each in its sensor's."""

    xyz: Array  # (N, 3) in metres
    intensity: NDArray[np.uint8]  # (N,) 0-100 diffuse in per cent, 101-255 retro-reflectors
    ring: NDArray[np.uint8]  # (N,) 0 is the sensor's lowest beam
    time_ns: NDArray[np.int64]  # (N,) device time since 1970
    sensor: NDArray[np.uint16]  # (N,) index into sensor_names
    sensor_names: tuple[str, ...]
    return_type: NDArray[np.uint8]  # (N,) 0 strongest, 1 last


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
    return np.array(table, np.uint16)[cloud.sensor]


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


def load_cloud(path: str | Path) -> PointCloud:
    """The cloud in a file that `save_clouds` wrote. Raises CloudError."""
    path = Path(path)
    kind = _suffix(path)
    try:
        columns = _read_npz(path) if kind == ".npz" else _read_rows(path, kind)
    except OSError as error:
        raise CloudError(f"{path}: {(error.strerror or str(error)).lower()}") from None
    except (ValueError, KeyError, IndexError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise CloudError(f"{path}: not a whole {kind[1:]} file: {' '.join(str(error).split())}") from None
    missing = [key for key in (*FIELDS, "sensor_names") if key not in columns]
    if missing:
        raise CloudError(f"{path}: missing: {', '.join(missing)}")
    if not len(columns["xyz"]):
        raise CloudError(f"{path}: the cloud is empty")
    if columns["xyz"].shape != (len(columns["xyz"]), 3) or any(
        columns[key].shape != (len(columns["xyz"]),) for key in FIELDS if key != "xyz"
    ):
        raise CloudError(f"{path}: the fields are not of one length")
    if not np.isfinite(columns["xyz"]).all():
        raise CloudError(f"{path}: point {np.argwhere(~np.isfinite(columns['xyz']))[0][0]} is not finite")
    names = tuple(str(name) for name in columns.pop("sensor_names"))
    if columns["sensor"].max() >= len(names):
        raise CloudError(f"{path}: a point is of sensor {columns['sensor'].max()}; there are {len(names)}")
    return PointCloud(sensor_names=names, **{key: columns[key].astype(FIELDS[key]) for key in FIELDS})


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
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as arrays:
        return dict(arrays)


def _read_rows(path: Path, kind: str) -> dict[str, Any]:
    with open(path, "rb") as file:
        lines = _header(file, "end_header" if kind == ".ply" else "DATA")
        dtype, count = _ply_layout(lines) if kind == ".ply" else _pcd_layout(lines)
        rows = np.fromfile(file, dtype, count)
    if len(rows) < count:
        raise ValueError(f"{count} points are announced, {len(rows)} are there")
    columns: dict[str, Any] = {key: rows[key] for key in FIELDS if key in (dtype.names or ())}
    if "time_s" in (dtype.names or ()):
        columns["time_ns"] = rows["time_s"].astype(np.int64) * SECOND_NS + rows["time_rest_ns"]
    columns["xyz"] = np.stack([rows["x"], rows["y"], rows["z"]], axis=1)
    names = [line.split(maxsplit=2)[2] for line in lines if line.startswith(("comment sensor ", "# sensor "))]
    return columns | ({"sensor_names": [json.loads(name) for name in names]} if names else {})


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
    if words["DATA"] != ["binary"]:
        raise ValueError("allowed is DATA binary")
    columns = zip(words["FIELDS"], words["TYPE"], words["SIZE"], strict=True)
    return np.dtype([(name, f"<{kind.lower()}{size}") for name, kind, size in columns]), int(words["POINTS"][0])
