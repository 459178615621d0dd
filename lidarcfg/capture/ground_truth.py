"""The ground truth of a capture: object, exact range and noise of each return; written, and read back."""

import tempfile
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import PointCloud, read_arrays
from lidarcfg.errors import CloudError
from lidarcfg.files import check_replaceable, make_parent, replacing
from lidarcfg.geometry import Bytes, Flags, Times
from lidarcfg.sensors.firing import FIRST, LAST, SECOND, STRONGEST, Firings
from lidarcfg.sensors.rig import Rig
from lidarcfg.simulate.echoes import Echoes

RECORD = np.dtype(
    [
        ("sensor", "<u2"),  # index into sensor_names
        ("time_ns", "<i8"),  # of the firing, exact
        ("laser", "u1"),
        ("return_type", "u1"),  # 0 strongest, 1 last, 3 first; of a pair 0 and 1, of an Ouster's 0 and 2; alike: 0
        ("object", "<i4"),  # index into object_names; -1: rain or fog
        ("range_m", "<f8"),  # exact, along the beam
        ("noise_m", "<f8"),  # added to the range before it is rounded
    ]
)

RECORDS = 1 << 16  # at a time
AWAY_NS = 5_000  # a laser fires at most once in 40 µs, and times on the wire are whole microseconds
LATEST_NS = 2**42  # span of a ground-truth file: 73 minutes; with sensor, ring and return it makes one int64
KINDS = 4  # of returns
NAMES = ("sensor_names", "object_names")
COLUMNS = ("sensor", "time_ns", "laser", "return_type", "object")
OTHER = "rain, fog or unknown"


def records(
    sensor_index: int, types: Bytes, fired: Firings, fired_ns: Times, found: Echoes, sent: Flags
) -> NDArray[np.void]:
    """The records of N firings: echoes, their types, when they were fired, and which of them were sent, are (N, R)."""
    firing, which = np.nonzero(sent)
    out = np.empty(len(firing), RECORD)
    out["sensor"] = sensor_index
    out["time_ns"] = fired_ns[firing, which]
    out["laser"] = fired.laser[firing]
    out["return_type"] = types[firing, which]
    for key in ("object", "range_m", "noise_m"):
        out[key] = getattr(found, key)[firing, which]
    return out


class TruthFile:
    """Collects the records of all sensors; `save` writes them sensor by sensor to a .npz. Memory stays constant."""

    def __init__(self, path: str | Path, sensor_names: Sequence[str], object_names: Sequence[str]) -> None:
        path = Path(path)
        check_replaceable(path)
        make_parent(path)
        self._path = path
        self._names = {"sensor_names": sensor_names, "object_names": object_names}
        self._bodies: list[IO[bytes]] = [tempfile.TemporaryFile(dir=path.parent) for _ in sensor_names]  # noqa: SIM115

    def __enter__(self) -> "TruthFile":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for body in self._bodies:
            with suppress(OSError):  # of a full disk: `add` has raised it
                body.close()

    def add(self, found: NDArray[np.void]) -> None:
        """Append records of one sensor. Raises OSError with the name of the .npz."""
        if len(found):
            try:
                self._bodies[found["sensor"][0]].write(found.tobytes())
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(self._path)) from None

    def save(self) -> int:
        """Write the file, complete or not at all; returns the number of records."""
        counts = [body.tell() // RECORD.itemsize for body in self._bodies]
        with replacing(self._path, "wb") as file, zipfile.ZipFile(file, "w") as archive:
            for key, names in self._names.items():
                with archive.open(f"{key}.npy", "w") as out:
                    np.lib.format.write_array(out, np.array(names, np.str_))
            for key in RECORD.names or ():
                with archive.open(f"{key}.npy", "w", force_zip64=True) as out:
                    head = {"descr": RECORD[key].str, "fortran_order": False, "shape": (sum(counts),)}
                    np.lib.format.write_array_header_1_0(out, head)
                    for body in self._bodies:
                        body.seek(0)
                        while piece := body.read(RECORDS * RECORD.itemsize):
                            out.write(np.frombuffer(piece, RECORD)[key].tobytes())
        return sum(counts)


def is_truth(path: Path) -> bool:
    """Whether a .npz is ground truth and no cloud."""
    try:
        return read_arrays(path, ("object_names", "intensity")).keys() == {"object_names"}  # a cloud may have both
    except CloudError:  # loading it will say what is wrong
        return False


@dataclass(frozen=True)
class Objects:
    """The object that each point is on."""

    names: tuple[str, ...]  # the last is for points on no object
    index: NDArray[np.uint16]  # (N,) of names


@dataclass(frozen=True)
class GroundTruth:
    """The returns of a ground-truth file, by sensor, ring, return and time."""

    path: Path
    names: tuple[str, ...]  # of the objects
    sensors: tuple[str, ...]
    by_strength: NDArray[np.bool_]  # (S + 1,) sensors whose pairs are the strongest and the second strongest
    start_ns: int
    known: NDArray[np.int64]  # (N,) one number of each return, ascending
    object: NDArray[np.int64]  # (N,) -1: rain or fog

    @classmethod
    def read(cls, path: Path, rig: Rig) -> "GroundTruth":
        """Read the file. Raises CloudError if it is not ground truth, or not of this rig."""
        record = read_arrays(path, (*NAMES, *COLUMNS))
        if lacking := [key for key in (*NAMES, *COLUMNS) if key not in record]:
            raise CloudError(f"{path}: is not a ground-truth file: it has no {', '.join(lacking)}")
        if any(record[key].dtype.kind not in "iu" for key in COLUMNS):
            raise CloudError(f"{path}: is not a ground-truth file: its columns are not integers")
        if any(record[key].dtype.kind != "U" or record[key].ndim != 1 for key in NAMES):
            raise CloudError(f"{path}: is not a ground-truth file: its names are not lists of texts")
        sensors, names = (tuple(record.pop(key).tolist()) for key in NAMES)
        if len({column.shape for column in record.values()}) != 1 or record["time_ns"].ndim != 1:
            raise CloudError(f"{path}: the fields differ in length")
        ring = _rings(path, sensors, rig)
        if len(record["time_ns"]) == 0:
            raise CloudError(f"{path}: no return has an object")
        limits = {
            "sensor": (0, len(sensors)),
            "object": (-1, len(names)),
            "laser": (0, ring.shape[1]),
            "return_type": (0, KINDS),
        }
        for key, (first, end) in limits.items():
            if not ((record[key] >= first) & (record[key] < end)).all():
                raise CloudError(f"{path}: {key} holds a number outside {first} to {end - 1}")
        start_ns = int(record["time_ns"].min()) - 2 * AWAY_NS
        if int(record["time_ns"].max()) - start_ns >= LATEST_NS:
            raise CloudError(f"{path}: is longer than {LATEST_NS / 6e10:.0f} minutes")
        by_strength = np.zeros(len(sensors) + 1, np.bool_)
        by_strength[record["sensor"][record["return_type"] == SECOND]] = True
        by_strength[record["sensor"][np.isin(record["return_type"], (FIRST, LAST))]] = False
        kind = _kind(record["return_type"], by_strength[record["sensor"]])
        known = _key(record["sensor"], ring[record["sensor"], record["laser"]], kind, record["time_ns"] - start_ns)
        order = np.argsort(known)
        return cls(path, names, sensors, by_strength, start_ns, known[order], record["object"][order].astype(np.int64))

    def objects(self, cloud: PointCloud) -> NDArray[np.int32]:
        """(N,) of names, of a cloud's points; -1: none. Raises CloudError if none of the points is a return here."""
        sensor = np.array(
            [self.sensors.index(name) if name in self.sensors else len(self.sensors) for name in cloud.sensor_names],
            np.int64,
        )
        since_ns = np.clip(cloud.time_ns - self.start_ns, 0, 2 * LATEST_NS - 2 * AWAY_NS)
        by_strength = self.by_strength[sensor[cloud.sensor]]
        wanted = _key(sensor[cloud.sensor], cloud.ring, _kind(cloud.return_type, by_strength), since_ns)
        known = self.known
        after = np.searchsorted(known, wanted).clip(1, len(known) - 1) if len(known) > 1 else np.zeros_like(wanted)
        near = np.where(wanted - known[after - 1] < known[after] - wanted, after - 1, after)
        found = abs(known[near] - wanted) <= AWAY_NS
        if not found.any():
            raise CloudError(f"{self.path}: none of the points has a return in it; it belongs to another capture")
        return np.where(found, self.object[near], -1).astype(np.int32)


def _rings(path: Path, sensors: tuple[str, ...], rig: Rig) -> NDArray[np.int64]:
    """(S, 256): the ring of each laser. Raises CloudError for a sensor that the rig does not have."""
    mounts = {mount.name: mount for mount in rig.mounts}
    missing = [name for name in sensors if name not in mounts]
    if missing:
        raise CloudError(f"{path}: its sensor {missing[0]!r} is not in the rig {rig.name!r}")
    ring = np.zeros((max(len(sensors), 1), 256), np.int64)
    for i, name in enumerate(sensors):
        ring[i, : mounts[name].sensor.count] = mounts[name].sensor.ring
    return ring


def load_objects(path: Path, cloud: PointCloud, rig: Rig) -> Objects:
    """The objects of a cloud's points from a ground-truth file, matched by sensor, ring, return and time.

    Raises CloudError if the file is not ground truth, or belongs to another capture.
    """
    truth = GroundTruth.read(path, rig)
    if len(cloud.xyz) == 0:
        raise CloudError(f"{path}: no return has an object")
    index = truth.objects(cloud)
    if (index < 0).all():
        raise CloudError(f"{path}: none of the points has a return in it; it belongs to another capture")
    return Objects((*truth.names, OTHER), np.where(index < 0, len(truth.names), index).astype(np.uint16))


def own_objects(cloud: PointCloud) -> Objects | None:
    """The objects stored in a cloud, if there are any."""
    if cloud.object is None:
        return None
    names = cloud.object_names
    return Objects((*names, OTHER), np.where(cloud.object < 0, len(names), cloud.object).astype(np.uint16))


def with_objects(path: Path, cloud: PointCloud, rig: Rig) -> PointCloud:
    """The cloud with the objects of its points. Raises as `load_objects` does."""
    found = load_objects(path, cloud, rig)
    known = found.index < len(found.names) - 1
    return replace(cloud, object=np.where(known, found.index, -1).astype(np.int32), object_names=found.names[:-1])


def _kind(return_type: NDArray[np.generic], by_strength: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Which of a firing's returns: of a pair with a first or a last, the second strongest stands for the strongest."""
    return np.where((return_type == SECOND) & ~by_strength, STRONGEST, return_type).astype(np.int64) % KINDS


def _key(
    sensor: NDArray[np.generic], ring: NDArray[np.generic], kind: NDArray[np.int64], since_ns: NDArray[np.int64]
) -> NDArray[np.int64]:
    """One number per return; two are close only if sensor, ring and kind are the same."""
    high = (np.asarray(sensor, np.int64) * 256 + np.asarray(ring, np.int64)) * KINDS + kind
    key: NDArray[np.int64] = high * (2 * LATEST_NS) + since_ns
    return key
