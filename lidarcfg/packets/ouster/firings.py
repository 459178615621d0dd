"""The contents of packets, by their firings, and packets from these contents."""

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Batch, Firings, Measurements, Octets, Times
from lidarcfg.packets.ouster import pixels
from lidarcfg.packets.ouster.layout import PROFILES, Columns, Heads, Layout, columns, heads
from lidarcfg.packets.ouster.pixels import CONSTANT, Footer, crc64

MEASURED = "range", "reflectivity"  # of each return; the other fields are in `more`
END = "", "2"  # the ends of the names of the first and of the second return's fields


def measurements(layout: Layout, packets: Octets, host_ns: Times) -> Measurements:
    """All pixels of packets (P, size), in the order of columns: see `Codec.measurements`.

    Ranges are what the fields say. Beside them are the other fields (N,), what columns say (P, C), and the headers.
    """
    found, said, top = pixels.fields(layout, packets), columns(layout, packets), heads(layout, packets)
    ends = END[: layout.profile.returns]
    millimetres, reflectivity = (np.stack([found[name + end].ravel() for end in ends], axis=-1) for name in MEASURED)
    angle = 2 * np.pi * said.measurement / layout.columns_per_frame
    fired = Firings(
        time_ns=np.repeat(said.time_ns.ravel(), layout.pixels),
        laser=np.tile(np.arange(layout.pixels, dtype=np.uint8), said.time_ns.size),
        encoder_rad=np.repeat(angle.ravel(), layout.pixels),
    )
    once = {key: value for key, value in asdict(top).items() if key != "frame"}
    facts = {"layout": asdict(layout), "heads": once, "footer": _footer(layout, packets)}
    others = {name: one.ravel() for name, one in found.items() if name.rstrip("2") not in MEASURED}
    columns_said = {"measurement": said.measurement, "valid": said.valid}
    batch = Batch(fired, top.frame, host_ns)
    return Measurements(
        return_mode="dual" if len(ends) == 2 else "strongest",
        batch=batch,
        range_m=np.where(millimetres > 0, millimetres / 1000, np.inf),
        reflectivity=reflectivity.astype(np.uint8),
        more={"said": np.array(json.dumps(facts)), **columns_said, **others},
    )


def packed(found: Measurements) -> Octets:
    """(P, size): packets of measurements, as `measurements` has them of recordings. Raises PacketError."""
    facts = _facts(found)
    layout, more = Layout(**facts["layout"]), found.more
    shape = more["measurement"].shape
    if len(found.range_m) != more["valid"].size * layout.pixels or shape[1:] != (layout.columns_per_packet,):
        raise PacketError("an Ouster's columns and pixels do not belong together")
    given = {}
    for name, field in layout.profile.fields.items():
        kind, slot = name.rstrip("2"), int(name.endswith("2"))
        if kind == "range":
            millimetres = np.nan_to_num(np.rint(found.range_m[:, slot] * 1000), posinf=0)
            most = ((1 << field.bits) - 1) << field.dropped
            given[name] = np.where(millimetres <= most, millimetres, 0)
        else:
            given[name] = found.reflectivity[:, slot] if kind == "reflectivity" else more[name]
    time_ns = found.batch.firings.time_ns[:: layout.pixels].reshape(shape)
    said = Columns(time_ns, more["measurement"], more["valid"])
    return pixels.packed(layout, Heads(frame=found.batch.number, **facts["heads"]), said, given, facts["footer"])


def _facts(found: Measurements) -> dict[str, Any]:
    """What is said of layout and headers. Raises PacketError if it makes no sense."""
    try:
        facts: dict[str, Any] = json.loads(str(found.more["said"]))
        sizes = {key: value for key, value in facts["layout"].items() if key != "name"}
        sound = facts["layout"]["name"] in PROFILES and facts["footer"] in ("crc", "constant", "zero")
        sound = sound and all(type(one) is int and 0 < one < 1 << 16 for one in sizes.values())
        sound = sound and all(type(one) is int and 0 <= one < 1 << 40 for one in facts["heads"].values())
        Layout(**facts["layout"]), Heads(frame=found.batch.number, **facts["heads"])
    except (ValueError, TypeError, KeyError, AttributeError):
        sound = False
    if not sound:
        raise PacketError("the description of an Ouster's packets is invalid")
    return facts


def _footer(layout: Layout, packets: Octets) -> Footer:
    if layout.legacy or not packets[:, -8:].any():
        return "zero"
    if (packets[:, -8:] == np.frombuffer(CONSTANT, np.uint8)).all():
        return "constant"
    return "crc" if (crc64(packets) == np.ascontiguousarray(packets[:, -8:]).view("<u8")[:, 0]).all() else "zero"
