"""From packets to points."""

import numpy as np

from lidarcfg.geometry import directions
from lidarcfg.packets.codec import DecodedReturns, Decoder, DecodeStatistics

from .layout import RETURN, packets_of


class ToyDecoder(Decoder):
    """Packets of one source."""

    def __init__(self, sensor, period_ns):
        self.sensor = sensor
        self.period_ns = period_ns
        self.lost = 0

    def time_ns(self, packets, host_ns):
        return packets_of(packets)["returns"]["time_ns"][:, 0]

    def heading_rad(self, packets):
        return packets_of(packets)["returns"]["azimuth"][:, 0]

    def count(self, packets, wanted):
        number = packets_of(packets)["number"].astype(np.int64)
        self.lost += int((np.diff(number)[wanted[1:]] - 1).sum())

    def statistics(self):
        return DecodeStatistics((self.sensor.name,), ("strongest",), self.lost, np.nan)

    def decode(self, packets, host_ns, wanted):
        returns = packets_of(packets)["returns"][wanted]
        time_ns, azimuth, range_mm, laser, strength = (returns[returns["range_mm"] > 0][key] for key in RETURN.names)
        xyz_m = directions(azimuth, self.sensor.elevation_rad[laser]) * (range_mm / 1000)[:, None]
        ring = self.sensor.ring[laser].astype(np.uint8)
        return DecodedReturns(xyz_m, range_mm / 1000, azimuth, time_ns, laser, ring, strength, np.zeros_like(laser))
