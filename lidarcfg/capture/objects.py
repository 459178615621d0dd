"""Which object each point of a cloud is on, by the ground truth that `export --truth` wrote beside the capture."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import PointCloud, read_arrays
from lidarcfg.errors import CloudError
from lidarcfg.sensors.firing import FIRST, LAST, SECOND, STRONGEST
from lidarcfg.sensors.rig import Rig

AWAY_NS = 5_000  # a laser fires at most once in 40 µs, and times on the wire are whole microseconds
LATEST_NS = 2**42  # span of a ground-truth file: 73 minutes; with sensor, ring and return it makes one int64
KINDS = 4  # of returns
NAMES = ("sensor_names", "object_names")
COLUMNS = ("sensor", "time_ns", "laser", "return_type", "object")
OTHER = "rain, fog or unknown"


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
