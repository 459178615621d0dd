"""Points: merge, save, load. Our files are .npz, .ply and .pcd, each with every field and exact times."""

import json
import lzma
import struct
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from shutil import copyfileobj
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.errors import CloudError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory, check_regular
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    import open3d

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
# PLY has no 64-bit integers, and Open3D reads neither short nor uint: the time is whole seconds and a remainder.
PLY_ROW = np.dtype([*_XYZ, *_BYTES, ("sensor", "<i4"), ("time_s", "<f8"), ("time_rest_ns", "<i4")])
PCD_ROW = np.dtype([*_XYZ, *_BYTES, ("sensor", "<u2"), ("time_ns", "<i8")])
OBJECT_ROW = [("object", "<i4")]
PLY_TYPES = {np.dtype("<f8"): "double", np.dtype("<i4"): "int", np.dtype("u1"): "uchar"}
UNPACKED_MIN = 1 << 26  # bytes
UNPACKED_RATIO = 20  # times the archive's size: real arrays hardly compress
UNPACKED_COPIES = 3  # of the arrays, in memory at the same time
FILE_COPIES = 4  # of a PLY or PCD file
XYZ_BYTES = 2 * np.dtype(FIELDS["xyz"]).itemsize  # beyond x
XYZ_MAX_M = np.float64(1e9)
# What np.load and the archive's members raise for bytes that are no archive of arrays. zipfile raises RuntimeError for
# encryption and unknown versions, KeyError for a member that is not there; numpy's header parser raises SyntaxError and
# TokenError; absurd sizes are OverflowError and MemoryError.
NPZ_ERRORS = (
    *(ValueError, KeyError, EOFError, OverflowError, MemoryError, RuntimeError, SyntaxError, tokenize.TokenError),
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error),
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
    return_type: NDArray[np.uint8]  # (N,) 0 strongest, 1 last, 2 second strongest if the last is the strongest, 3 first
    driver: Mapping[str, NDArray[Any]] = field(default_factory=dict)  # (N,) what a maker's driver has; no file keeps it
    object: NDArray[np.int32] | None = None  # (N,) index into object_names, -1: none of them; None: not known
    object_names: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<PointCloud: {len(self.xyz):,} points of {', '.join(self.sensor_names) or 'no sensor'}>"

    @classmethod
    def none(cls, sensor_names: tuple[str, ...]) -> "PointCloud":
        """An empty cloud of these sensors."""
        columns: dict[str, Any] = {key: np.empty((0, 3) if key == "xyz" else 0, kind) for key, kind in FIELDS.items()}
        return cls(sensor_names=sensor_names, **columns)

    @classmethod
    def from_open3d(
        cls,
        cloud: "open3d.t.geometry.PointCloud | open3d.geometry.PointCloud",
        sensor_names: Sequence[str] = (),
        object_names: Sequence[str] = (),
        on_warning: Callable[[str], None] = print,
    ) -> "PointCloud":
        """The points of Open3D, with the attributes that `to_open3d` gives or that Open3D reads of our files.

        Times are exact. Names of other programs are understood as those of their files are; what is lacking is 0, and
        `on_warning` gets one line on that. Attributes of one value a point that no field holds are columns of `driver`.
        Sensors and objects without names are called by their numbers. Raises CloudError.
        """
        from lidarcfg.clouds.open3d_tensors import SOURCE, read_tensors

        columns, driver = read_tensors(cloud, sensor_names, object_names, on_warning)
        return replace(checked(SOURCE, columns, allow_empty=True), driver=driver)

    def to_open3d(self) -> "open3d.t.geometry.PointCloud":
        """A copy as Open3D's: `positions` (N, 3) in float64, all other fields (N, 1) by their names and in their types.

        `object` is there if it is known, and so are the columns of `driver`. Names of sensors and objects are not:
        give them to `from_open3d`.
        """
        from lidarcfg.clouds.open3d_tensors import tensors

        columns = {key: getattr(self, key) for key in FIELDS if key != "xyz"}
        if self.object is not None:
            columns["object"] = self.object
        return tensors(self.xyz, columns | dict(self.driver))

    def rows(self, which: slice | NDArray[np.bool_] | NDArray[np.intp]) -> "PointCloud":
        """Some of the points."""
        columns: dict[str, Any] = {key: getattr(self, key)[which] for key in FIELDS}
        columns["driver"] = {key: column[which] for key, column in self.driver.items()}
        return replace(self, object=None if self.object is None else self.object[which], **columns)


def concatenate(clouds: Sequence[PointCloud]) -> PointCloud:
    """The clouds as one; sensors of the same name are the same sensor."""
    whole = gather(clouds, sum(len(cloud.xyz) for cloud in clouds))
    names: dict[str, int] = {}
    objects = None
    if any(cloud.object is not None for cloud in clouds):
        objects = np.concatenate([_object(cloud, names) for cloud in clouds])
    return replace(whole, driver=_driver(clouds), object=objects, object_names=tuple(names))


def gather(clouds: Iterable[PointCloud], points: int) -> PointCloud:
    """The clouds as one, of about this many `points` in all. Each may be released before the next is taken.

    Memory that is not filled is given back. Sensors of the same name are the same sensor.
    """
    columns: dict[str, Any] = {
        key: np.empty((points, 3) if key == "xyz" else points, kind) for key, kind in FIELDS.items()
    }
    index = _SensorIndex()
    count = 0
    for cloud in clouds:
        rows = slice(count, count + len(cloud.xyz))
        if rows.stop > points:
            points = 2 * rows.stop
            _resize(columns, points)
        for key, column in columns.items():
            column[rows] = index.numbers(cloud) if key == "sensor" else getattr(cloud, key)
        count = rows.stop
    _resize(columns, count)
    return PointCloud(sensor_names=index.names, **columns)


def _resize(columns: Mapping[str, NDArray[Any]], rows: int) -> None:
    """Lengthen or shorten arrays without other references, in place if memory allows."""
    for column in columns.values():
        column.resize((rows, *column.shape[1:]), refcheck=False)


def _driver(clouds: Sequence[PointCloud]) -> dict[str, NDArray[Any]]:
    """The clouds' columns of their makers' drivers; 0 where a cloud has none of that name."""
    kinds = {key: column.dtype for cloud in clouds for key, column in cloud.driver.items()}
    return {
        key: np.concatenate([c.driver.get(key, np.zeros(len(c.xyz), kind)) for c in clouds])
        for key, kind in kinds.items()
    }


class _SensorIndex:
    """Numbers sensors by their names, in the order in which clouds name them."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._names: tuple[str, ...] = ()  # of the cloud before, and mostly of the next one: with thousands it counts
        self._table: NDArray[np.uint16] | None = None  # the numbers of these; None if they are 0, 1 and on

    @property
    def names(self) -> tuple[str, ...]:
        """All names."""
        return tuple(self._index)

    def numbers(self, cloud: PointCloud) -> NDArray[np.uint16]:
        """(N,) of the sensors of a cloud's points; new names are added."""
        if cloud.sensor_names is not self._names:
            self._names = cloud.sensor_names
            table = [self._index.setdefault(name, len(self._index)) for name in self._names]
            self._table = None if table == list(range(len(table))) else np.array(table, np.uint16)
        return cloud.sensor if self._table is None else self._table[cloud.sensor]


def _object(cloud: PointCloud, index: dict[str, int]) -> NDArray[np.int32]:
    """The cloud's objects as numbers of `index`, to which new names are added; -1 where they are not known."""
    if cloud.object is None:
        return np.full(len(cloud.xyz), -1, np.int32)
    table = np.array([*(index.setdefault(name, len(index)) for name in cloud.object_names), -1], np.int32)
    return np.asarray(table[cloud.object])


# The boxes of objects: which one, when, and where: the middle, the size along its own axes, and how these are turned.
BOX_SIZES = ("length_m", "width_m", "height_m")
BOX = np.dtype(
    [("object", "<i4"), ("time_ns", "<i8"), *_XYZ, *((key, "<f8") for key in (*BOX_SIZES, "qx", "qy", "qz", "qw"))]
)
_BOX_TIME = {"time_ns": [("time_s", "<f8"), ("time_rest_ns", "<i4")]}
PLY_BOX = np.dtype([part for key in BOX.names or () for part in _BOX_TIME.get(key, [(key, BOX[key].str)])])


def save_clouds(
    path: str | Path, clouds: Iterable[PointCloud], boxes: Callable[[], NDArray[np.void]] = lambda: np.empty(0, BOX)
) -> int:
    """Write the clouds as one file, whole or not at all, and return how many points.

    They are streamed: no more than a cloud is held in memory. `boxes` are asked for at the end; PCD has none.
    Raises CloudError.
    """
    path = Path(path)
    kind = _suffix(path)
    try:
        if kind == ".npz":
            return _save_npz(path, clouds, boxes)
        with replacing(path, "wb") as file, tempfile.TemporaryFile(dir=path.parent) as body:
            sensors = _SensorIndex()
            objects: dict[str, int] = {}
            dtype, head = (PLY_ROW, _ply_header) if kind == ".ply" else (PCD_ROW, _pcd_header)
            for number, cloud in enumerate(clouds):
                if number == 0 and cloud.object is not None:
                    dtype = np.dtype([*_fields(dtype), *OBJECT_ROW])
                body.write(_rows(cloud, sensors.numbers(cloud), _object(cloud, objects), dtype).tobytes())
            count = body.tell() // dtype.itemsize
            body.seek(0)
            found = _ply_boxes(boxes()) if kind == ".ply" else np.empty(0, PLY_BOX)
            file.write(head(count, dtype, {"sensor": sensors.names, "object": objects}, len(found)).encode())
            copyfileobj(body, file, 1 << 20)
            file.write(found.tobytes())
        return count
    except OSError as error:
        raise CloudError.from_os(path, error) from None


def _save_npz(path: Path, clouds: Iterable[PointCloud], boxes: Callable[[], NDArray[np.void]]) -> int:
    sensors = _SensorIndex()
    objects: dict[str, int] = {}
    count = 0
    knows_objects = False
    with replacing(path, "wb") as file, ExitStack() as stack:
        kinds = FIELDS | {"object": np.int32}
        bodies = {key: stack.enter_context(tempfile.TemporaryFile(dir=path.parent)) for key in kinds}
        for cloud in clouds:
            columns = {key: getattr(cloud, key) for key in FIELDS}
            columns |= {"sensor": sensors.numbers(cloud), "object": _object(cloud, objects)}
            for key, body in bodies.items():
                body.write(np.ascontiguousarray(columns[key], kinds[key]).data)
            count += len(cloud.xyz)
            knows_objects = knows_objects or cloud.object is not None
        arrays: dict[str, Any] = {}
        for key, body in bodies.items():
            shape = (count, 3) if key == "xyz" else (count,)
            body.flush()
            arrays[key] = np.memmap(body, kinds[key], "r", shape=shape) if count else np.empty(shape, kinds[key])
        if knows_objects:
            arrays["object_names"] = np.array(tuple(objects), np.str_)
        else:
            del arrays["object"]
        if len(found := boxes()):
            arrays["boxes"] = found
        np.savez(file, sensor_names=np.array(sensors.names, np.str_), **arrays)
    return count


def row_bytes(path: str | Path) -> int:
    """The bytes that a point with its object takes in a file of this kind. Raises CloudError."""
    row = {".ply": PLY_ROW, ".pcd": PCD_ROW}.get(_suffix(Path(path)))
    own = row.itemsize if row else sum(np.dtype(kind).itemsize for kind in FIELDS.values()) + XYZ_BYTES
    return own + np.dtype(OBJECT_ROW).itemsize


def load_cloud(path: str | Path, on_warning: Callable[[str], None], allow_empty: bool = False) -> PointCloud:
    """The cloud in a file, ours or, of PLY and PCD, another program's.

    `on_warning` gets one line on what a file lacks and what is assumed instead. Raises CloudError for anything that no
    cloud holds.
    """
    path = Path(path)
    if _suffix(path) == ".npz":
        return checked(path, read_arrays(path, (*FIELDS, "sensor_names", "object", "object_names")), allow_empty)
    from lidarcfg.clouds.ply_pcd import read_columns

    try:
        check_memory(str(path), FILE_COPIES * check_regular(path))
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    return checked(path, read_columns(path, on_warning), allow_empty)


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """The arrays of these names that a .npz holds. Raises CloudError."""
    try:
        size = check_regular(path)
        with open(path, "rb") as file:
            if not zipfile.is_zipfile(file):
                raise CloudError(f"{path}: not a whole npz file: allowed is an archive of arrays")
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                wanted = [name for name in names if name in arrays]
                _check_unpacked(path, size, [arrays.zip.getinfo(_member(arrays, name)).file_size for name in wanted])
                found = {name: arrays[name] for name in wanted}
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    except NPZ_ERRORS as error:
        raise CloudError.damaged(path, error) from None
    if odd := [name for name, array in found.items() if not isinstance(array, np.ndarray)]:
        raise CloudError(f"{path}: not a whole npz file: {odd[0]} is no array")
    return found


def _member(arrays: Any, name: str) -> str:
    """The name of an array's file in the archive."""
    return name if name in arrays.zip.namelist() else f"{name}.npy"


def _check_unpacked(path: Path, packed: int, sizes: Sequence[int]) -> None:
    """Raises LidarcfgError for arrays that unpack to far more than arrays do, or that memory does not hold."""
    unpacked = sum(sizes)
    if unpacked > UNPACKED_MIN + UNPACKED_RATIO * packed:
        raise CloudError(f"{path}: {packed:,} bytes that say they unpack to {unpacked:,} are no cloud or log")
    check_memory(str(path), UNPACKED_COPIES * unpacked)


def checked(path: Path | str, columns: dict[str, Any], allow_empty: bool = False) -> PointCloud:
    """The columns as a cloud. Raises CloudError unless each holds what its field allows."""
    missing = [key for key in (*FIELDS, "sensor_names") if key not in columns]
    if missing:
        raise CloudError(f"{path}: missing: {', '.join(missing)}")
    for key in FIELDS:
        letters, kinds = ("f", "floats") if key == "xyz" else ("iu", "integers")
        if columns[key].dtype.kind not in letters:
            raise CloudError(f"{path}: {key} is of type {columns[key].dtype}; allowed: {kinds}")
    xyz = columns["xyz"]
    names = _names(path, columns["sensor_names"])
    if xyz.shape == (0, 3) and not allow_empty:
        raise CloudError(f"{path}: the cloud is empty")
    if xyz.shape[1:] != (3,) or any(columns[key].shape != xyz.shape[:1] for key in FIELDS if key != "xyz"):
        raise CloudError(f"{path}: the fields differ in length")
    far = np.flatnonzero(~(abs(xyz) <= XYZ_MAX_M).all(axis=1))
    if len(far):
        what = f"beyond {XYZ_MAX_M:g} m" if np.isfinite(xyz[far[0]]).all() else "not finite"
        raise CloudError(f"{path}: point {far[0]} is {what}")
    for key, kind in FIELDS.items():
        if key != "xyz":
            column = columns[key]
            allowed = np.iinfo(kind)
            bad = np.flatnonzero((column < allowed.min) | (column > allowed.max))
            if len(bad):
                what = f"point {bad[0]}: {key} is {column[bad[0]]}"
                raise CloudError(f"{path}: {what}; allowed: {allowed.min} to {allowed.max}")
    if len(xyz) and columns["sensor"].max() >= len(names):
        raise CloudError(f"{path}: a point is of sensor {columns['sensor'].max()}; there are {len(names)}")
    fields: dict[str, Any] = {key: np.ascontiguousarray(columns[key], FIELDS[key]) for key in FIELDS}
    if "object" in columns:
        fields["object_names"] = _names(path, columns.get("object_names", ()), "object")
        fields["object"] = _checked_objects(path, columns["object"], len(xyz), len(fields["object_names"]))
    return PointCloud(sensor_names=names, **fields)


def _checked_objects(path: Path | str, column: NDArray[Any], points: int, names: int) -> NDArray[np.int32]:
    """The objects of points. Raises CloudError unless each is -1 or has a name."""
    if column.dtype.kind not in "iu" or column.shape != (points,):
        raise CloudError(f"{path}: object is not {points:,} integers, one a point")
    bad = np.flatnonzero((column < -1) | (column >= names))
    if len(bad):
        raise CloudError(f"{path}: point {bad[0]}: object is {column[bad[0]]}; allowed: -1 to {names - 1}")
    return np.ascontiguousarray(column, np.int32)


def _names(path: Path | str, names: Any, kind: str = "sensor") -> tuple[str, ...]:
    """The names of sensors or objects. Raises CloudError unless they are texts that can be written."""
    if isinstance(names, np.ndarray):
        names = names.tolist() if names.ndim == 1 else [names]
    for name in names:
        if not isinstance(name, str):
            raise CloudError(f"{path}: {kind}_names holds something other than a list of texts")
        try:
            name.encode()
        except UnicodeEncodeError:
            raise CloudError(f"{path}: the {kind} name {name!r} is not Unicode text") from None
    return tuple(names)


def _suffix(path: Path) -> str:
    if path.suffix.lower() not in SUFFIXES:
        raise CloudError(f"{path}: {path.suffix or 'no suffix'} is not a kind of cloud; allowed: {', '.join(SUFFIXES)}")
    return path.suffix.lower()


def _fields(dtype: np.dtype[np.void]) -> list[tuple[str, str]]:
    return [(key, dtype[key].str) for key in dtype.names or ()]


def _rows(
    cloud: PointCloud, sensor: NDArray[np.uint16], objects: NDArray[np.int32], dtype: np.dtype[np.void]
) -> NDArray[np.void]:
    rows = np.empty(len(cloud.xyz), dtype)
    rows["x"], rows["y"], rows["z"] = cloud.xyz.T
    for key, _ in _BYTES:
        rows[key] = getattr(cloud, key)
    rows["sensor"] = sensor
    if "object" in (dtype.names or ()):
        rows["object"] = objects
    if "time_ns" in (dtype.names or ()):
        rows["time_ns"] = cloud.time_ns
    else:
        rows["time_s"], rows["time_rest_ns"] = np.divmod(cloud.time_ns, SECOND_NS)
    return rows


def _comments(mark: str, names: Mapping[str, Iterable[str]]) -> list[str]:
    """A line for each name of a sensor or an object."""
    return [f"{mark} {kind} {json.dumps(name)}" for kind, all_ in names.items() for name in all_]


def _ply_boxes(boxes: NDArray[np.void]) -> NDArray[np.void]:
    rows = np.empty(len(boxes), PLY_BOX)
    for key in PLY_BOX.names or ():
        if key in (BOX.names or ()):
            rows[key] = boxes[key]
    rows["time_s"], rows["time_rest_ns"] = np.divmod(boxes["time_ns"], SECOND_NS)
    return rows


def _ply_header(count: int, dtype: np.dtype[np.void], names: Mapping[str, Iterable[str]], boxes: int) -> str:
    return "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            "comment time is time_s + time_rest_ns",
            *_comments("comment", names),
            f"element vertex {count}",
            *(f"property {PLY_TYPES[dtype[key]]} {key}" for key in dtype.names or ()),
            *([f"element box {boxes}"] * bool(boxes)),
            *(f"property {PLY_TYPES[PLY_BOX[key]]} {key}" for key in PLY_BOX.names or () if boxes),
            "end_header\n",
        ]
    )


def _pcd_header(count: int, dtype: np.dtype[np.void], names: Mapping[str, Iterable[str]], boxes: int) -> str:
    kinds = [dtype[key] for key in dtype.names or ()]
    return "\n".join(
        [
            "# .PCD v0.7 - Point Cloud Data file format",
            *_comments("#", names),
            "VERSION 0.7",
            f"FIELDS {' '.join(dtype.names or ())}",
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
