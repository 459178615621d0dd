"""A toy family: all lasers fire together every 0.1 ms; a packet is a number and its firings, one by one."""

import numpy as np

from lidarcfg.config.models import Model, loads
from lidarcfg.geometry import directions
from lidarcfg.packets.codec import Codec, DecodedReturns, Decoder, DecodeStatistics, Payloads
from lidarcfg.packets.facts import Header, Network
from lidarcfg.sensors.schedule import FiringSchedule, SequenceTiming
from lidarcfg.sensors.sensor import Sensor

RETURN = np.dtype([("time_ns", "<i8"), ("azimuth", "<f8"), ("range_mm", "<u4"), ("laser", "u1"), ("strength", "u1")])
NETWORK = Network(source="", mac_prefix="02:00:00", destination_mac="ff:ff:ff:ff:ff:ff", destination_ip="10.0.0.1")
HEADER = Header(ttl=64, dont_fragment=False, numbered=True, checksum=True)


class Facts(Model):
    """All that a sensor's file says under `toy`."""

    columns: int  # in a packet


class Toy(SequenceTiming, Codec):
    """The packets of one sensor."""

    facts_model = Facts

    def __init__(self, sensor):
        self.sensor = sensor
        self.columns = sensor.section.checked(Facts).columns
        self.dtype = np.dtype([("magic", "S4"), ("number", "<u4"), ("returns", RETURN, self.columns * sensor.count)])

    def firing_schedule(self, mount):
        return FiringSchedule(np.zeros(self.sensor.count, np.int64), 100_000, self.columns, per_azimuth=1)

    def encode(self, mount, batch, range_m, reflectivity):
        packets = np.zeros(len(batch.number), self.dtype)
        packets["magic"] = b"TOY1"
        packets["number"] = batch.number
        millimetres = np.rint(np.where(range_m < 1e6, range_m, 0) * 1000)
        columns = batch.firings.time_ns, batch.firings.encoder_rad, millimetres, batch.firings.laser, reflectivity
        for key, column in zip(RETURN.names, columns, strict=True):
            packets["returns"][key] = column.reshape(len(packets), -1)
        octets = packets.view(np.uint8).reshape(len(packets), -1)
        return Payloads(batch.sent_ns, octets, mount.data_port, NETWORK, HEADER, batch.first)

    def sent(self, mount, batch, payloads):
        return payloads.data.view(self.dtype)["returns"]["range_mm"].reshape(-1, 1) > 0

    def sidecar_files(self, mount):
        return {".toy.json": self.sensor.model_dump_json(exclude_none=True).encode()}

    @classmethod
    def matches(cls, source, size, payload):
        return payload[:4] == b"TOY1"

    @classmethod
    def identify(cls, source, packets, known):
        return next(loads(text.decode(), Sensor, name) for name, text in source.sidecar_files(".toy.json").items())

    def decoder(self, source, packets, known, trusted):
        return ToyDecoder(self)


class ToyDecoder(Decoder):
    """Packets of one source."""

    def __init__(self, toy):
        self.sensor = toy.sensor
        self.dtype = toy.dtype
        self.period_ns = toy.firing_schedule(None).period_ns
        self.lost = 0

    def time_ns(self, packets, host_ns):
        return packets.view(self.dtype)["returns"]["time_ns"][:, 0, 0]

    def heading_rad(self, packets):
        return packets.view(self.dtype)["returns"]["azimuth"][:, 0, 0]

    def count(self, packets, wanted):
        self.lost += int((np.diff(packets.view(self.dtype)["number"][:, 0].astype(np.int64))[wanted[1:]] - 1).sum())

    def statistics(self):
        return DecodeStatistics((self.sensor.name,), ("strongest",), self.lost, np.nan)

    def decode(self, packets, host_ns, wanted):
        returns = packets.view(self.dtype)["returns"][wanted]
        time_ns, azimuth, range_mm, laser, strength = (returns[returns["range_mm"] > 0][key] for key in RETURN.names)
        xyz_m = directions(azimuth, self.sensor.elevation_rad[laser]) * (range_mm / 1000)[:, None]
        ring = self.sensor.ring[laser].astype(np.uint8)
        return DecodedReturns(xyz_m, range_mm / 1000, azimuth, time_ns, laser, ring, strength, np.zeros_like(laser))
