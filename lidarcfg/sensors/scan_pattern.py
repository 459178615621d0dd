"""Scan patterns: the firings of a sensor whose beams do not turn with a head, as a table beside its file.

The table is a CSV with a header or an .npz, with a column each of `COLUMNS`: when a firing comes after the pattern's
start, where it points, and which channel fires. It holds one frame, or many, which frames walk through; then it
starts again.

A sensor with a mirror has the file of its angles instead, from which `mirror` tells the firings.

An .npz may be packed: channels fire in turn at `rate_hz`; rows of `azimuth_steps` and `elevation_steps`, one a
channel, hold by how many hundredths of a degree each firing differs from the channel's last one, the first from 0.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config.models import FileName, Model, validation_error
from lidarcfg.errors import ConfigError, has_values
from lidarcfg.geometry import Array, Bytes, Times
from lidarcfg.inputs import read_regular
from lidarcfg.sensors.mirror import UNITS, Mirror, MirrorAngles, mirror_columns, parse_mirror_angles
from lidarcfg.units import MILLISECOND_NS, SECOND_NS

COLUMNS = {  # of the table, and the limits of their values
    "time_ns": (0, 10**12),
    "azimuth_deg": (-360, 360),  # clockwise from the x axis
    "elevation_deg": (-90, 90),
    "channel": (0, 255),
}
WHOLE = "time_ns", "channel"  # columns of whole numbers
PACKED = "rate_hz", "azimuth_steps", "elevation_steps"
HUNDREDTHS = 36000  # of a degree, all around
GAP_DEG = 10.0  # without firings, from which on a pattern is not all around
ROWS_MAX = 10_000_000
CSV_MAX = 1 << 30  # bytes
ANGLES_MAX = 1 << 20  # bytes of a mirror's angles
AHEAD_RAD = np.pi / 2  # a mirror's azimuths begin at the y axis


class PatternFile(Model):
    """Where a sensor's scan pattern is, and how long its frames are."""

    source: str = ""
    file: FileName
    frame_ms: Annotated[float, Field(ge=0.1, le=10_000)]
    mirror: Mirror | None = None  # whose angles the file has

    @model_validator(mode="after")
    def _check(self) -> "PatternFile":
        is_angles = Path(self.file).suffix.lower() == ".dat"
        if is_angles != bool(self.mirror):
            what = "missing; a .dat has a mirror's angles" if is_angles else "needs a .dat, which has its angles"
            raise validation_error(what, "mirror")
        return self

    @property
    def frame_ns(self) -> int:
        """The time from one frame to the next."""
        return round(self.frame_ms * MILLISECOND_NS)


@dataclass(frozen=True, eq=False)
class ScanPattern:
    """F firings, which are repeated; frames of equal length follow each other through them."""

    frame_ns: int
    time_ns: Times  # (F,) after the pattern's start, ascending
    azimuth_rad: Array  # (F,) clockwise from the x axis
    elevation_rad: Array  # (F,)
    channel: Bytes  # (F,)
    angles: MirrorAngles | None = None  # of the mirror that points so

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ScanPattern):
            return NotImplemented
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return self is other or all(np.array_equal(one, another) for one, another in pairs)

    @property
    def frames(self) -> int:
        """The number of frames after which the pattern starts again."""
        return int(self.time_ns[-1]) // self.frame_ns + 1

    @property
    def period_ns(self) -> int:
        """The time after which the pattern starts again: whole frames."""
        return self.frames * self.frame_ns

    @property
    def channels(self) -> int:
        """The number of channels."""
        return int(self.channel.max()) + 1

    @property
    def azimuth_fov_deg(self) -> tuple[float, float] | None:
        """From and to, clockwise, rounded outward: all but the widest gap, if that is wider than GAP_DEG."""
        hundredths = np.floor(np.degrees(self.azimuth_rad) * 100).astype(np.int64) % HUNDREDTHS
        there = np.flatnonzero(np.bincount(hundredths))
        gaps = np.diff(there, append=there[0] + HUNDREDTHS)
        widest = int(gaps.argmax())
        if gaps[widest] <= 100 * GAP_DEG:
            return None
        return float(there[(widest + 1) % len(there)] / 100), float((there[widest] + 1) / 100)

    def count_before(self, elapsed_ns: int) -> int:
        """The number of firings before a time after the start of a pattern that repeats."""
        periods, rest_ns = divmod(elapsed_ns, self.period_ns)
        return periods * len(self.time_ns) + int(np.searchsorted(self.time_ns, rest_ns))

    def walk(self, first: int, end: int) -> tuple[Times, Times]:
        """The firings from number `first` to `end`, counted on as the pattern repeats: times (N,) and rows (N,)."""
        periods, rows = np.divmod(np.arange(first, end), len(self.time_ns))
        return np.asarray(periods * self.period_ns + self.time_ns[rows]), rows


def load_scan_pattern(path: Path, frame_ns: int, mirror: Mirror | None = None) -> ScanPattern:
    """The pattern in a file. Raises LidarcfgError: no such file, of another kind, or a row that is not allowed."""
    if mirror:
        try:
            return mirror_pattern(mirror, parse_mirror_angles(str(path), read_regular(path, ANGLES_MAX)), frame_ns)
        except OSError as error:
            raise ConfigError.from_os(path, error) from None
    readers = {".csv": _read_csv, ".npz": _read_npz}
    if path.suffix.lower() not in readers:
        raise ConfigError(f"{path}: is no scan pattern; allowed: {', '.join(readers)}")
    columns = readers[path.suffix.lower()](path)
    count = len(columns["time_ns"])
    if not 1 <= count <= ROWS_MAX:
        raise ConfigError(f"{path}: has {count:,} firings; allowed: 1 to {ROWS_MAX:,}")
    if faults := list(_faults(path, columns)):
        raise ConfigError.all_of(faults)
    return ScanPattern(
        frame_ns=frame_ns,
        time_ns=columns["time_ns"].astype(np.int64),
        azimuth_rad=np.radians(columns["azimuth_deg"], dtype=np.float64),
        elevation_rad=np.radians(columns["elevation_deg"], dtype=np.float64),
        channel=columns["channel"].astype(np.uint8),
    )


def mirror_pattern(mirror: Mirror, angles: MirrorAngles, frame_ns: int) -> ScanPattern:
    """The firings until a mirror is where it was, a frame for each facet. Raises ConfigError for another's angles."""
    facets = len(angles.start)
    if len(mirror.offset_ns) not in (1, facets) or len(mirror.offset_ns[0]) != angles.lasers:
        what = f"is not one for all facets, or {facets}, of {angles.lasers} lasers, which the angles are of"
        raise ConfigError(f"mirror.offset_ns: {what}")
    columns = mirror_columns(mirror, angles)
    frames_ns = frame_ns * facets
    if abs(mirror.columns * mirror.column_ns - frames_ns) > 1:
        what = f"{mirror.rpm:g} rpm are no {facets} frames of {frame_ns / MILLISECOND_NS:g} ms"
        raise ConfigError(f"mirror.rpm: {what}")
    if (
        not (angles.facet(columns.angle, columns.facet) == columns.facet).all()
        or (
            (columns.time_ns + mirror.column_ns).reshape(facets, -1).max(axis=1) > np.arange(1, facets + 1) * frame_ns
        ).any()
    ):
        raise ConfigError("mirror.columns_per_facet: some columns are beyond their facet")
    offset_ns = np.resize(mirror.offset_ns, (facets, angles.lasers))[columns.facet]
    azimuth_deg, elevation_deg = angles.pointing_deg(columns.angle, columns.facet)
    if mirror.turns_while_firing:
        turn = angles.gain * mirror.step / UNITS / mirror.column_ns
        azimuth_deg += turn * angles.way(columns.facet)[:, None] * offset_ns
    order = np.argsort(offset_ns, axis=1, kind="stable")
    return ScanPattern(
        frame_ns=frame_ns,
        time_ns=(columns.time_ns[:, None] + np.take_along_axis(offset_ns, order, axis=1)).ravel(),
        azimuth_rad=np.radians(np.take_along_axis(azimuth_deg, order, axis=1)).ravel() - AHEAD_RAD,
        elevation_rad=np.radians(np.take_along_axis(elevation_deg, order, axis=1)).ravel(),
        channel=order.astype(np.uint8).ravel(),
        angles=angles,
    )


def _faults(path: Path, columns: dict[str, NDArray[Any]]) -> Iterator[ConfigError]:
    """What is wrong with a table's columns: of each the first row that is not allowed, and how many are not."""
    for name, (least, most) in COLUMNS.items():
        values = columns[name]
        allowed = (values >= least) & (values <= most)  # NaN is not
        what = f"{least} to {most:,}"
        if name in WHOLE:
            what = f"whole numbers from {what}"
            if values.dtype.kind == "f":
                allowed &= values == np.rint(values)
        if not allowed.all():
            odd = np.flatnonzero(~allowed)
            more = f"; so are {len(odd):,} rows" if len(odd) > 1 else ""
            yield _fault(path, odd[0], name, f"{values[odd[0]]:.15g} is not allowed; allowed: {what}{more}")
            continue
        if name == "time_ns" and not (rises := values[1:] >= values[:-1]).all():
            late = int(np.argmin(rises)) + 1
            what = f"{values[late]:.15g} comes after {values[late - 1]:.15g}; allowed: ascending times"
            yield _fault(path, late, name, what)
        if name == "channel":
            fires = np.bincount(values.astype(np.int64)) > 0
            if not fires.all():
                which = int(np.argmin(fires))
                what = f"{which} has no firings; allowed: channels 0 to {len(fires) - 1}, each with some"
                yield ConfigError(f"{path}: channel: {what}")


def _fault(path: Path, row: int, name: str, what: str) -> ConfigError:
    where = f"{path}:{row + 2}:1: {name}" if path.suffix.lower() == ".csv" else f"{path}: {name}[{row}]"
    return ConfigError(f"{where}: {what}")


def _read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of an .npz. Raises LidarcfgError."""
    from lidarcfg.clouds.cloud import read_arrays  # with all that archives need, which sensors with beams do not

    columns = read_arrays(path, (*COLUMNS, *PACKED))
    if all(name in columns for name in PACKED):
        columns = _unpacked(path, *(columns[name] for name in PACKED))
    _check_names(path, list(columns))
    for name, array in columns.items():
        if array.ndim != 1 or array.dtype.kind not in "iuf":
            what = f"has {array.ndim} axes of {array.dtype}; allowed: one axis of numbers"
            raise ConfigError(f"{path}: {name}: {what}")
        if len(array) != len(columns["time_ns"]):
            raise ConfigError(f"{path}: {name}: {has_values(len(array))}; time_ns has {len(columns['time_ns']):,}")
    return columns


def _unpacked(path: Path, rate_hz: NDArray[Any], *steps: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The columns of a packed pattern. Raises ConfigError."""
    azimuth, elevation = steps
    whole = all(one.ndim == 2 and one.dtype.kind in "iu" and one.shape == azimuth.shape for one in steps)
    if not whole or not 1 <= len(azimuth) <= COLUMNS["channel"][1] + 1:
        what = "are no tables of whole numbers, as long as each other, with a row for each of 1 to 256 channels"
        raise ConfigError(f"{path}: azimuth_steps, elevation_steps: {what}")
    if rate_hz.ndim or rate_hz.dtype.kind not in "iuf" or not 1 <= rate_hz <= SECOND_NS:
        raise ConfigError(f"{path}: rate_hz: is no number of firings a second; allowed: 1 to {SECOND_NS:,}")
    number = np.arange(azimuth.size)
    hundredths = np.cumsum(azimuth.T, axis=0, dtype=np.int64).ravel() % HUNDREDTHS
    return {
        "time_ns": np.rint(number * (SECOND_NS / float(rate_hz))),
        "azimuth_deg": hundredths / 100,
        "elevation_deg": np.cumsum(elevation.T, axis=0, dtype=np.int64).ravel() / 100,
        "channel": number % len(azimuth),
    }


def _read_csv(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of a CSV, whose header names them. Raises ConfigError with the first line that is wrong."""
    try:
        lines = read_regular(path, CSV_MAX).decode("utf-8-sig").rstrip().splitlines()
    except OSError as error:
        raise ConfigError.from_os(path, error) from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not text in UTF-8") from None
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    _check_names(path, names)
    at = [names.index(name) for name in COLUMNS]
    if len(lines) == 1:
        return {name: np.empty(0) for name in COLUMNS}
    try:
        if not all(lines[1:]):
            raise ValueError("blank lines, which loadtxt passes over")
        table = np.loadtxt(lines[1:], delimiter=",", comments=None, usecols=at, ndmin=2)
    except ValueError:  # one by one, to say which
        table = np.array([_csv_row(path, n, line, at) for n, line in enumerate(lines[1:], 2)])
    return dict(zip(COLUMNS, table.T, strict=True))


def _csv_row(path: Path, number: int, line: str, at: list[int]) -> list[float]:
    try:
        words = line.split(",")
        return [float(words[column]) for column in at]
    except (ValueError, IndexError):
        what = f"{line.strip()[:60]!r} is no firing; allowed: a number for each of {', '.join(COLUMNS)}"
        raise ConfigError(f"{path}:{number}:1: {what}") from None


def _check_names(path: Path, names: list[str]) -> None:
    """Raises ConfigError unless a table has all columns."""
    if missing := [name for name in COLUMNS if name not in names]:
        raise ConfigError(f"{path}: missing: {', '.join(missing)}; allowed: the columns {', '.join(COLUMNS)}")
