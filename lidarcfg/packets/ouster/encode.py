"""Encodes firings and their measurements as an Ouster's packets."""

import numpy as np

from lidarcfg import maths
from lidarcfg.core import packets as core
from lidarcfg.geometry import Array, Bytes, Flags
from lidarcfg.packets.ouster.layout import (
    ALERTS,
    ColumnHeaders,
    Footer,
    PacketHeaders,
    assemble,
    unpack,
)
from lidarcfg.packets.ouster.model import Mode, OusterUnit, in_window, measurements
from lidarcfg.sensors.firing import FiringBatch

BYTE = np.arange(256.0)
# Per cent of a white target's light that a reflectivity says: above 100 it doubles with each 16, as a recorded OS2's
# medians grow. The maker says of retro-reflectors only that the scale is not linear.
LIGHT = np.where(BYTE <= 100, BYTE, 100 * maths.power(2.0, (BYTE - 100) / 16))
MEASURED = ("range", "reflectivity", "signal", "range2", "reflectivity2", "signal2")
BLOCKED = 255  # in `window`: as a recording of firmware 3.2.0 has it of a unit that sees nothing but its cover


def encode(
    unit: OusterUnit,
    mode: Mode,
    batch: FiringBatch,
    range_m: Array,
    reflectivity: Bytes,
    window: Bytes | None = None,
) -> Bytes:
    """(P, size): as `Codec.encode` says. There is no near-infrared light, no colour, and no point is in a zone.

    Of two returns the nearer comes first, or the stronger, as the metadata says. `window` (N,) is how much the window
    is blocked at each firing, from 0 to `BLOCKED`; none: it is clean.
    """
    layout = mode.layout
    returns = layout.profile.returns
    least_m, most_m = unit.range.reported_m
    field = layout.profile.fields["range"]
    limits = core.OusterLimits(
        least_m=least_m,
        most_m=most_m,
        start_m=unit.start_mm[0] / 1000,
        unit_m=(1 << field.dropped) / 1000,
        most_units=field.most,
    )
    names = MEASURED[: 3 * returns]
    raw = np.empty((len(names), len(range_m)), np.uint32)
    core.quantize_ouster_returns(
        np.ascontiguousarray(range_m),
        np.ascontiguousarray(reflectivity),
        limits,
        unit.facts.signal.scale * LIGHT,
        not mode.nearest_first,
        raw,
    )
    if window is not None:
        names = (*names, "window")
        raw = np.vstack([raw, window])
    measurement = measurements(mode, batch.number)
    valid = in_window(mode, measurement)
    if not valid.all():
        raw[:, np.repeat(~valid.ravel(), layout.pixels)] = 0
    time_ns = batch.firings.time_ns[:: layout.pixels].reshape(measurement.shape)
    headers = PacketHeaders(
        frame=batch.number // layout.packets_per_frame,
        init=mode.init,
        serial=mode.serial,
        alerts=ALERTS if mode.modern else 0,
    )
    footer: Footer = "crc" if mode.modern else "constant"
    if layout.fusa:
        footer = "zero"  # as the one recording has it; ouster-sdk reads no checksum there
    columns = ColumnHeaders(time_ns, measurement, valid)
    return assemble(layout, headers, columns, raw, layout.bits_of(names), footer)


def return_types(unit: OusterUnit, range_m: Array, reflectivity: Bytes) -> Bytes:
    """(N, 2): of two returns that come by their strength, 0 of the stronger and 2 of the other."""
    least_m, most_m = unit.range.reported_m
    there = ((range_m >= least_m) & (range_m <= most_m)).all(axis=1)
    far_m = range_m[there]
    light = LIGHT[reflectivity[there]]
    weaker = np.zeros(len(range_m), np.bool_)
    weaker[there] = light[:, 0] * far_m[:, 1] ** 2 < light[:, 1] * far_m[:, 0] ** 2
    return np.stack([2 * weaker, 2 * ~weaker], axis=1).astype(np.uint8)


def sent(mode: Mode, packets: Bytes) -> Flags:
    """(N, R): which of the firings' returns are in the packets."""
    found = unpack(mode.layout, packets)
    ranges = [name for name in ("range", "range2") if name in found]
    return np.stack([found[name].ravel() > 0 for name in ranges], axis=-1)
