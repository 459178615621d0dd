"""The inverse of encoding: the contents of packets, by their firings."""

import numpy as np

from lidarcfg.packets.codec import Batch, Firings, Measurements, Octets, Times
from lidarcfg.packets.robosense.facts import Unit
from lidarcfg.packets.robosense.layout import RADIANS, octets_of, packets_of, read_time_ns
from lidarcfg.packets.robosense.slots import places


def measurements(unit: Unit, octets: Octets, host_ns: Times, return_mode: str) -> Measurements:
    """All firings of packets (P, size) of one return mode: see `Codec.measurements`."""
    dual = return_mode == "dual"
    packets, spin = packets_of(octets), unit.spin(dual)
    azimuth = packets["blocks"]["azimuth"]
    azimuth = azimuth[:, :: azimuth.shape[1] // (spin.sequences // spin.per_azimuth)].astype(np.float64)
    shape = len(packets), spin.sequences, unit.count
    head = np.broadcast_to(np.repeat(azimuth * RADIANS, spin.per_azimuth, axis=1)[:, :, None], shape)
    time_ns = read_time_ns(packets)[:, None, None] + spin.offsets_ns
    laser = np.broadcast_to(np.arange(unit.count, dtype=np.uint8), shape)
    at, data = places(unit, dual), octets_of(packets)
    high, low, intensity = (data[:, at + byte].reshape(-1, 1 + dual) for byte in range(3))
    distance = high.astype(np.int64) << 8 | low
    range_m = np.where(distance > 0, distance * unit.resolution_m, np.inf)
    batch = Batch(Firings(time_ns.ravel(), laser.ravel(), head.ravel()), packets["count"].astype(np.int64), host_ns)
    return Measurements(return_mode, batch, range_m, intensity)
