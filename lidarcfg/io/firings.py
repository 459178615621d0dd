"""Recordings as firings in one .npz, and back: what each laser measured, and all other bytes as they were recorded.

The packets of a source are encoded from its columns again; bytes that the columns do not determine are kept.
"""

import json
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.pcap import SECTION
from lidarcfg.capture.reader import CaptureReader
from lidarcfg.clouds.cloud import read_arrays
from lidarcfg.config.models import COORDINATE_MAX_M, loads
from lidarcfg.errors import CloudError, ConfigError, ConversionError, PacketError
from lidarcfg.files import replacing
from lidarcfg.geometry import Bytes
from lidarcfg.io.repack import CUTS, capture_bytes, read_records
from lidarcfg.packets.codec import Measurements
from lidarcfg.packets.families import codec
from lidarcfg.sensors.firing import Batch, Firings
from lidarcfg.sensors.rig import DATA_PORT, FIRST_HOST, RPM, SINGLE, TELEMETRY_PORT, Mount
from lidarcfg.sensors.sensor import Reported, Sensor

VERSION = 3
COLUMNS = {  # of a source, and their types; N firings in P packets, R returns of each
    "time_ns": "<i8",  # (N,) device time
    "laser": "|u1",  # (N,)
    "encoder_rad": "<f8",  # (N,)
    "range_m": "<f8",  # (N, R) inf: no return
    "reflectivity": "|u1",  # (N, R)
    "number": "<i8",  # (P,)
    "host_ns": "<i8",  # (P,)
    "rest_at": "<i8",  # (K,) offsets, in the concatenated packets, of bytes that the firings do not determine
    "rest": "|u1",  # (K,) these bytes
}
FILE_COLUMNS = CUTS | {"raw": "|u1"}  # the places of the packets in the file, and all its other bytes
KEYS = "name", "sensor", "return_mode", "firings", "order", "packets", "size", "more"  # of a source's description
ANY_RANGE = Reported(source="as recorded", min_m=0, max_m=COORDINATE_MAX_M)

OnWarning = Callable[[str], None]


class ConvertedSize(NamedTuple):
    """The size of a converted recording."""

    firings: int
    packets: int
    rest: int  # bytes of packets that are kept beside firings


@dataclass(frozen=True)
class Source:
    """One sensor of a recording."""

    name: str
    sensor: Sensor
    found: Measurements

    def packets(self) -> Bytes:
        """(P, size): its firings encoded, without the range limits of exports."""
        sensor = self.sensor
        if sensor.range:
            sensor = sensor.model_copy(update={"range": sensor.range.model_copy(update={"reported": ANY_RANGE})})
        mount = Mount(
            name=self.name,
            sensor=sensor,
            position_m=(0, 0, 0),
            rpy_rad=(0, 0, 0),
            model=None,
            host=str(FIRST_HOST),
            data_port=DATA_PORT,
            telemetry_port=TELEMETRY_PORT,
            rpm=RPM,
            return_mode=self.found.return_mode,  # type: ignore[arg-type]  # a text that was checked when it was read
        )
        return codec(sensor).encode_measurements(mount, self.found)


def save_firings(path: Path, capture: Path, model: str | None, on_warning: OnWarning) -> ConvertedSize:
    """Write a capture as firings, whole or not at all. Raises LidarcfgError.

    What a sensor sends in several return modes are as many sources. Packets whose family has no way back to firings, or
    of modes that it does not have, are kept as they are, with a warning.
    """
    records = read_records(capture)
    sources = list[dict[str, Any]]()
    kept = list[str]()
    arrays: dict[str, NDArray[Any]] = {}
    counted = ConvertedSize(0, 0, 0)
    for recorded in CaptureReader(capture, on_warning, model=model).recordings():
        mine = records.of(recorded.name, recorded.packets.shape[1])
        maker = codec(recorded.sensor)
        modes = maker.return_modes(recorded.source, mine.packets)
        for mode in dict.fromkeys(modes.tolist()):
            rows = np.flatnonzero(modes == mode)
            packets = mine.packets[rows]
            try:
                found = maker.measurements(recorded.source, packets, mine.host_ns[rows], mode)
            except (ConfigError, PacketError) as error:
                kept.append(f"{recorded.name}: {len(rows)} packets: {error}")
                continue
            one = Source(recorded.name, recorded.sensor, found)
            columns = _columns(one, packets)
            arrays |= {f"{len(sources)}/{key}": value for key, value in columns.items()}
            records.take(mine, rows, len(sources))
            sources.append(_describe_source(one, packets.shape[1]))
            rest = counted.rest + len(columns["rest"])
            counted = ConvertedSize(counted.firings + len(columns["laser"]), counted.packets + len(packets), rest)
    if not sources:
        raise ConversionError(f"{capture}: no packets can be converted to firings; {'; '.join(kept)}")
    if kept:
        on_warning(f"{capture}: packets that are not converted are kept as they are; {'; '.join(kept)}")
    arrays |= {**records.arrays(), "sources": np.array(json.dumps({"version": VERSION, "sources": sources}))}
    with replacing(path, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
    return counted


def save_capture(path: Path, firings: Path) -> int:
    """Write firings, changed or not, as a capture again; return the number of packets.

    Raises LidarcfgError.
    """
    said = _read_descriptions(firings)
    names = [f"{i}/{key}" for i, one in enumerate(said) for key in (*COLUMNS, *(f"more/{key}" for key in one["more"]))]
    columns = read_arrays(firings, (*FILE_COLUMNS, *names))
    records = {key: _checked_column(firings, columns, key, kind) for key, kind in FILE_COLUMNS.items()}
    suffix = ".pcapng" if records["raw"][:4].tobytes() == SECTION else ".pcap"
    if path.suffix.lower() != suffix:
        raise ConversionError(f"{firings}: holds a {suffix[1:]}; the output's suffix must be {suffix}")
    parts = []
    for number, one in enumerate(said):
        mine = {key: _checked_column(firings, columns, f"{number}/{key}", kind) for key, kind in COLUMNS.items()}
        more = {key: _extra_column(firings, columns, f"{number}/more/{key}", kind) for key, kind in one["more"].items()}
        parts.append(_packets(firings, number, one, mine, more))
    with replacing(path, "wb") as file:
        for piece in capture_bytes(firings, records, parts):
            file.write(piece)
    return sum(map(len, parts))


def is_firings(path: Path) -> bool:
    """Whether a .npz holds a recording as firings."""
    return "sources" in read_arrays(path, ("sources",))


def _columns(one: Source, recorded: Bytes) -> dict[str, NDArray[Any]]:
    """The columns of a source, and the bytes of its packets (P, size) that they do not determine."""
    made = one.packets().ravel()
    rest_at = np.flatnonzero(made != recorded.ravel())
    fired = one.found.batch.firings
    batch = one.found.batch
    more = {f"more/{key}": value for key, value in one.found.more.items()}
    return more | {
        "time_ns": fired.time_ns,
        "laser": fired.laser,
        "encoder_rad": fired.encoder_rad,
        "range_m": one.found.range_m,
        "reflectivity": one.found.reflectivity,
        "number": batch.number,
        "host_ns": batch.sent_ns,
        "rest_at": rest_at,
        "rest": recorded.ravel()[rest_at],
    }


def _describe_source(one: Source, size: int) -> dict[str, Any]:
    """What is needed to encode a source's columns as packets again."""
    return {
        "name": one.name,
        "sensor": one.sensor.model_dump(mode="json", exclude_none=True),
        "return_mode": one.found.return_mode,
        "firings": len(one.found.range_m),
        "order": zlib.crc32(one.found.batch.firings.laser.tobytes()),
        "packets": len(one.found.batch.number),
        "size": size,
        "more": {key: [value.dtype.str, value.shape] for key, value in one.found.more.items()},
    }


def _read_descriptions(path: Path) -> list[dict[str, Any]]:
    """The descriptions of the sources in a file."""
    found = read_arrays(path, ("sources",)).get("sources")
    try:
        said = json.loads(str(found))
        sources = [dict(one) for one in said["sources"]]
        known = said["version"] == VERSION and all(
            {*one} == {*KEYS} and isinstance(one["more"], dict) for one in sources
        )
    except (ValueError, TypeError, KeyError):
        known = False
    if not known:
        raise CloudError(f"{path}: sources: not what a recording as firings says")
    return sources


def _checked_column(path: Path, columns: Mapping[str, NDArray[Any]], key: str, kind: str) -> NDArray[Any]:
    """A column of the file, of the right type."""
    if key not in columns:
        raise CloudError(f"{path}: {key}: missing")
    found = columns[key]
    sides = 2 if key.split("/")[-1] in ("range_m", "reflectivity") else 1
    if found.dtype != np.dtype(kind) or found.ndim != sides:
        what = f"{found.dtype} of {found.ndim} dimensions"
        raise CloudError(f"{path}: {key}: {what}; allowed: {np.dtype(kind)} of {sides}")
    return found


def _extra_column(path: Path, columns: Mapping[str, NDArray[Any]], key: str, kind: Any) -> NDArray[Any]:
    """A column of a family's own, as it was recorded but for its values."""
    found = columns.get(key)
    if found is None or [found.dtype.str, list(found.shape)] != kind:
        raise CloudError(f"{path}: {key}: missing, or of another type or shape than recorded")
    return found


def _packets(
    path: Path,
    number: int,
    said: Mapping[str, Any],
    columns: Mapping[str, NDArray[Any]],
    more: Mapping[str, NDArray[Any]],
) -> Bytes:
    """(P, size): the packets of a source."""
    sensor = loads(json.dumps(said["sensor"]), Sensor, f"{path}: {number}/sensor")
    lengths = {"number": "packets", "host_ns": "packets", "rest_at": "", "rest": ""}
    for key, column in columns.items():
        if (many := lengths.get(key, "firings")) and len(column) != said[many]:
            raise CloudError(f"{path}: {number}/{key}: has {len(column)} rows; allowed: {said[many]}, as recorded")
    limits = {
        "time_ns": (0, 2**62),
        "laser": (0, sensor.count - 1),
        "encoder_rad": (-1e6, 1e6),
        "range_m": (0, np.inf),
        "rest_at": (0, said["packets"] * said["size"] - 1),
    }
    for key, (low, high) in limits.items():
        wrong = np.flatnonzero(~((columns[key] >= low) & (columns[key] <= high)))
        if len(wrong):
            value = columns[key].ravel()[wrong[0]]
            raise CloudError(f"{path}: {number}/{key}[{wrong[0]}]: {value} is not allowed; allowed: {low} to {high}")
    if zlib.crc32(columns["laser"].tobytes()) != said["order"]:
        what = "not the lasers as recorded; firings stay in the order of the packets"
        raise CloudError(f"{path}: {number}/laser: {what}; allowed: other times, angles, ranges, reflectivities")
    if len(columns["rest"]) != len(columns["rest_at"]) or columns["range_m"].shape != columns["reflectivity"].shape:
        raise CloudError(f"{path}: {number}: columns that belong together are of different lengths")
    if columns["range_m"].shape[1] != 1 + (said["return_mode"] not in SINGLE):
        raise CloudError(
            f"{path}: {number}/range_m: {columns['range_m'].shape[1]} returns of each firing, but not dual"
        )
    fired = Firings(columns["time_ns"], columns["laser"], columns["encoder_rad"])
    batch = Batch(fired, columns["number"], columns["host_ns"])
    found = Measurements(said["return_mode"], batch, columns["range_m"], columns["reflectivity"], more)
    made = Source(str(said["name"]), sensor, found).packets()
    if made.shape != (said["packets"], said["size"]):
        raise ConversionError(f"{path}: {number}: its firings give packets of a different number or size than recorded")
    made = np.ascontiguousarray(made)
    made.ravel()[columns["rest_at"]] = columns["rest"]
    return made
