"""A mirror that moves before lasers that stand still: where each laser points as it moves, and when it fires.

Each facet of a mirror that turns, or each swing of one that goes there and back, sweeps the lasers over the field of
view once: a frame of a scan pattern. The maker's file has the angles: those of Hesai's AT128 and ATX are as in
HesaiLidar_SDK_2.0, libhesai/UdpProtocol/udp_protocol_v4_3.h and udp_protocol_v4_7.h.
"""

import struct
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from lidarcfg.config.models import Model, validation_error
from lidarcfg.errors import ConfigError, has_values
from lidarcfg.geometry import Array, Times
from lidarcfg.units import MINUTE_NS

UNITS = 25600  # of a mirror's angle in a degree: 256ths of a hundredth
CIRCLE = 360 * UNITS
NOWHERE = -1  # an angle between the facets

START = b"\xee\xff"
AT128 = struct.Struct("<2sBBBBB8xB")  # start, version, lasers, facets, frames, a unit of angles in 25600ths of a degree
ATX = struct.Struct("<2sBB2xBH")  # start, version, lasers, units of angles in a degree
AT128_VERSION = 1, 5
ATX_VERSION = 4, 2
KNOT_DEG = 2  # of an AT128's mirror, from one correction to the next
KNOTS = 360 // KNOT_DEG
HASH = 32  # bytes at the end: SHA-256 of those before

Nanoseconds = Annotated[int, Field(ge=0, le=10**9)]
Offsets = Annotated[tuple[Nanoseconds, ...], Field(min_length=1, max_length=256)]


class Mirror(Model):
    """How the mirror moves whose angles a scan pattern's file has, and when the lasers fire."""

    source: str = ""
    rpm: Annotated[float, Field(gt=0, le=1e5)]  # how often a minute it is where it was
    columns: Annotated[int, Field(ge=1, le=100_000)]  # times that all lasers would fire until then
    columns_per_facet: Annotated[int, Field(ge=2, le=100_000, multiple_of=2)]  # or swing, and times that they do
    first_deg: Annotated[float, Field(ge=0, lt=360)]  # of the mirror, after the facet's start
    step_deg: Annotated[float, Field(gt=0, le=10)] | None = None  # of a swing; none: columns are all around
    turns_while_firing: bool = False  # whether lasers that fire later in a column point further
    offset_ns: Annotated[tuple[Offsets, ...], Field(min_length=1)]  # by laser, after a column's start; of each facet,
    # or of all

    @model_validator(mode="after")
    def _check(self) -> "Mirror":
        for k, offsets in enumerate(self.offset_ns):
            if len(offsets) != len(self.offset_ns[0]):
                what = f"{has_values(len(offsets))}; allowed: {len(self.offset_ns[0])}, as the first"
                raise validation_error(what, "offset_ns", k)
            if max(offsets) >= self.column_ns:
                raise validation_error(f"a firing lies beyond the column's {self.column_ns:.0f} ns", "offset_ns", k)
        return self

    @property
    def column_ns(self) -> float:
        """From one firing of all lasers to the next."""
        return MINUTE_NS / self.rpm / self.columns

    @property
    def step(self) -> float:
        """From one column to the next, in `UNITS`."""
        return CIRCLE / self.columns if self.step_deg is None else self.step_deg * UNITS


@dataclass(frozen=True)
class MirrorAngles:
    """Where each of L lasers points, by the mirror's angle in `UNITS` and by its facet, of F, or its swing.

    Clockwise a laser points `gain` times as far as the mirror has turned since the facet's start, and as far as a table
    says further. The table has a row for each `KNOT_DEG` of the mirror's angle, between which angles are linear; of a
    mirror that swings one for each swing.
    """

    content: bytes  # of the file
    start: tuple[int, ...]  # (F,) where facets begin
    end: tuple[int, ...]  # (F,) and end
    gain: int
    swings: bool

    @property
    def lasers(self) -> int:
        """The number of lasers."""
        return int(self.azimuth_deg.shape[1])

    @property
    def azimuth_deg(self) -> Array:
        """(K, L): how much further lasers point."""
        return _tables(self.content)[0]

    @property
    def elevation_deg(self) -> Array:
        """(K, L)."""
        return _tables(self.content)[1]

    def facet(self, angle: Times, frame: Times) -> Times:
        """The facets of the mirror's angles in frames of any shape: the first that has it; `NOWHERE` if none has.

        Swings alternate from frame to frame.
        """
        if self.swings:
            return np.asarray(frame % len(self.start) + 0 * angle)
        found = np.full(angle.shape, NOWHERE)
        for k in reversed(range(len(self.start))):
            width = (self.end[k] - self.start[k]) % CIRCLE
            found[(angle < CIRCLE) & ((angle - self.start[k]) % CIRCLE <= width)] = k
        return found

    def swept_deg(self, angle: Times, facet: Times) -> Array:
        """How far lasers have been turned since the facet's start."""
        return np.asarray(self.gain * ((angle - np.array(self.start)[facet]) % CIRCLE) / UNITS)

    def way(self, facet: Times) -> Times:
        """Which way lasers turn on facets: 1 clockwise, -1 on a swing back."""
        return 1 - 2 * (facet % 2) * self.swings

    def row(self, angle: Times, facet: Times) -> Array:
        """The rows of the tables, between two rows a fraction; NaN: the mirror points nowhere."""
        row = facet if self.swings else angle / (KNOT_DEG * UNITS)
        return np.where(facet == NOWHERE, np.nan, row)

    def pointing_deg(self, angle: Times, facet: Times) -> tuple[Array, Array]:
        """(N, L): azimuths and elevations at the mirror's angles (N,) on facets (N,)."""
        row = self.row(angle, facet)[:, None]
        low = np.floor(row).astype(np.int64)[:, 0]
        high = np.minimum(low + 1, len(self.azimuth_deg) - 1)
        part = row - low[:, None]
        azimuth, elevation = (
            table[low] * (1 - part) + table[high] * part for table in (self.azimuth_deg, self.elevation_deg)
        )
        return self.swept_deg(angle, facet)[:, None] + azimuth, elevation


@dataclass(frozen=True)
class MirrorColumns:
    """The C columns until the mirror is where it was: when all lasers fire, one after the other."""

    angle: Times  # (C,) of the mirror, in `UNITS`
    facet: Times  # (C,)
    time_ns: Times  # (C,) when each starts; the first facet's first is at 0, or soon after


@lru_cache(16)
def mirror_columns(mirror: Mirror, angles: MirrorAngles) -> MirrorColumns:
    """The columns of a mirror that moves evenly: each facet's lie in a frame of their own."""
    facets = len(angles.start)
    frame_ns = mirror.columns * mirror.column_ns / facets
    column = np.arange(mirror.columns_per_facet)
    if angles.swings:
        there = mirror.first_deg * UNITS + column * mirror.step
        angle = np.stack([there, there[::-1]])
        time_ns = np.arange(facets)[:, None] * frame_ns + column * mirror.column_ns
    else:
        start = np.array(angles.start)
        start = start[0] + (start - start[0]) % CIRCLE
        first = np.ceil((start + mirror.first_deg * UNITS) / mirror.step)
        early_ns = np.arange(facets) * frame_ns - (first - first[0]) * mirror.column_ns
        number = first[:, None] + column
        angle = number * mirror.step
        time_ns = (number - first[0]) * mirror.column_ns + early_ns.max()
    return MirrorColumns(
        angle=np.rint(angle).astype(np.int64).ravel() % CIRCLE,
        facet=np.repeat(np.arange(facets), mirror.columns_per_facet),
        time_ns=np.rint(time_ns).astype(np.int64).ravel(),
    )


def parse_mirror_angles(name: str, content: bytes) -> MirrorAngles:
    """The angles in a file. Raises ConfigError: of another kind, cut off, or damaged."""
    if len(content) < AT128.size or not content.startswith(START):
        raise ConfigError(f"{name}: is no angle correction file of an AT128 or ATX, which begins with EE FF")
    version = content[2], content[3]
    if version not in (AT128_VERSION, ATX_VERSION):
        allowed = " or ".join(f"{major}.{minor}" for major, minor in (AT128_VERSION, ATX_VERSION))
        raise ConfigError(f"{name}: has version {version[0]}.{version[1]}; allowed: {allowed}")
    swings = version == ATX_VERSION
    if swings:
        *_, lasers, unit = ATX.unpack_from(content)
        facets = 2
        size = ATX.size + 6 * lasers + HASH
    else:
        *_, lasers, facets, _, unit = AT128.unpack_from(content)
        size = AT128.size + 8 * facets + 8 * lasers + 2 * lasers * KNOTS + HASH
    if not lasers or not facets or not unit or len(content) != size:
        what = f"has {len(content):,} bytes, {lasers} lasers, {facets} facets and angles in {unit} units"
        raise ConfigError(f"{name}: {what}; allowed: at least 1 each, and {size:,} bytes")
    if sha256(content[:-HASH]).digest() != content[-HASH:]:
        raise ConfigError(f"{name}: is damaged: the checksum at its end is not that of the bytes before")
    if max(np.abs(table).max() for table in _tables(content)) > 360:
        raise ConfigError(f"{name}: an angle is beyond 360 degrees")
    if swings:
        return MirrorAngles(content, (0, 0), (CIRCLE, CIRCLE), 1, swings)
    edges = np.frombuffer(content, "<u4", 2 * facets, AT128.size).astype(np.int64) * unit
    if not (edges < CIRCLE).all():
        raise ConfigError(f"{name}: a facet is beyond 360 degrees")
    starts, ends = edges.reshape(2, facets).tolist()
    return MirrorAngles(content, tuple(starts), tuple(ends), 2, swings)


@lru_cache(16)
def _tables(content: bytes) -> tuple[Array, Array]:
    """(K, L) azimuths and elevations in a file; an AT128's with the first row once more at the end."""
    if (content[2], content[3]) == ATX_VERSION:
        *_, lasers, units = ATX.unpack_from(content)
        even, odd, elevation = np.frombuffer(content, "<i2", 3 * lasers, ATX.size).reshape(3, lasers) / units
        return np.stack([even, odd]), np.stack([elevation, elevation])
    *_, lasers, facets, _, unit = AT128.unpack_from(content)
    at = AT128.size + 8 * facets
    azimuth, elevation = np.frombuffer(content, "<i4", 2 * lasers, at).reshape(2, lasers) * (unit / UNITS)
    corrections = np.frombuffer(content, "i1", 2 * lasers * KNOTS, at + 8 * lasers).reshape(2, lasers, KNOTS)
    further, higher = np.moveaxis(corrections, 1, 2)[:, np.arange(KNOTS + 1) % KNOTS] * (unit / 100)
    return further - azimuth, higher + elevation
