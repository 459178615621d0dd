"""Points of MSOP packets."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.packets.codec import Flags, Octets, Returns
from lidarcfg.packets.robosense import decode_kernels as kernels
from lidarcfg.packets.robosense.facts import Unit
from lidarcfg.packets.robosense.layout import packets_of, read_time_ns
from lidarcfg.packets.robosense.slots import slots

SINGLE = {"strongest": 0, "last": 1, "first": 3, "dual": 0}  # types of single returns, as `Returns` has them


@dataclass(frozen=True)
class Reading:
    """How the packets of a source are to be read."""

    unit: Unit
    elevation_rad: Array  # (L,)
    azimuth_offset_rad: Array  # (L,)
    return_mode: str

    @property
    def dual(self) -> bool:
        """Whether each laser's returns come in pairs."""
        return self.return_mode == "dual"


def decode(reading: Reading, octets: Octets, wanted: Flags) -> Returns:
    """The returns of successive packets (P, 1248) that are wanted (P,); the others only say how the head turns."""
    unit, dual = reading.unit, reading.dual
    spin, packets, layout = unit.spin(dual), packets_of(octets), slots(reading.unit, dual)
    azimuth = np.ascontiguousarray(packets["blocks"]["azimuth"][:, :: layout.blocks], np.int64)
    stamp_ns, group_ns = read_time_ns(packets), spin.per_azimuth * spin.sequence_ns
    step, late_ns = kernels.steps(azimuth, stamp_ns, spin.period_ns, group_ns)
    data = np.ascontiguousarray(octets).view()
    data.flags.writeable = False
    size = kernels.count(data, wanted)
    columns = kernels.Columns(
        np.empty((size, 3)), np.empty(size, np.int64), *(np.empty(size, np.uint8) for _ in range(4))
    )
    turning = azimuth, step, late_ns, stamp_ns
    unit_m = unit.range.resolution_m
    found = kernels.points(
        data, wanted, turning, layout, _lasers(reading), group_ns, unit_m, SINGLE[reading.return_mode], columns
    )
    none = np.empty(0)
    kept = columns._asdict()
    return Returns(kept.pop("xyz")[:found], none, none, **{key: column[:found] for key, column in kept.items()})


def _lasers(reading: Reading) -> kernels.Lasers:
    sensor = reading.unit.sensor
    return kernels.Lasers(
        elevation=reading.elevation_rad,
        azimuth_offset=reading.azimuth_offset_rad,
        forward=sensor.forward_offset_m,
        left=sensor.lateral_offset_m,
        up=sensor.vertical_offset_m,
        ring=np.argsort(np.argsort(reading.elevation_rad, kind="stable")).astype(np.uint8),
    )
