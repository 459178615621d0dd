"""A toy family: all lasers fire together every 0.1 ms; a packet is a counter, a time, a heading and its columns."""

import numpy as np
import yaml

from lidarcfg.config import Model, loads
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import directions
from lidarcfg.packets.codec import Batch, Codec, Decoder, Firings, Pace, Payloads, Returns, Tally
from lidarcfg.packets.network import Header, Network
from lidarcfg.sensor import Sensor

COLUMN_NS, UNIT_M, REVOLUTION = 100_000, 0.005, 2**32
HEAD = np.dtype([("magic", "S4"), ("counter", "<u4"), ("time_ns", "<i8"), ("heading", "<u4"), ("step", "<u4")])
RETURN = np.dtype([("range", "<u2"), ("reflectivity", "u1"), ("unused", "u1")])
NETWORK = Network(source="", mac_prefix="02:00:00", destination_mac="ff:ff:ff:ff:ff:ff", destination_ip="10.0.0.1")
HEADER = Header(ttl=64, dont_fragment=False, numbered=True, checksum=True)


class Facts(Model):
    """All that a sensor's file says under `toy`."""

    columns: int  # in a packet


class Toy(Codec, Decoder):
    """Both ways in one class, as it keeps little."""

    def __init__(self, sensor):
        self.sensor, self.columns = sensor, sensor.section.checked(Facts).columns
        self.dtype = np.dtype([("head", HEAD), ("returns", RETURN, (self.columns, sensor.count))])
        self.period_ns, self.lost, self.passed = self.columns * COLUMN_NS, 0, 0

    def check(self, mount_or_packets):
        if getattr(mount_or_packets, "return_mode", "strongest") != "strongest":
            raise ConfigError(f"sensor {self.sensor.name!r} has no {mount_or_packets.return_mode} returns")

    def pace(self, mount):
        return Pace(self.period_ns, self.columns * self.sensor.count)

    def schedule(self, mount, start_ns, packets, chunk):
        for first in range(0, packets, chunk):
            number = np.arange(first, min(first + chunk, packets))
            since_ns = np.arange(first * self.columns, (number[-1] + 1) * self.columns) * COLUMN_NS
            laser = np.tile(np.arange(self.sensor.count, dtype=np.uint8), len(since_ns))
            since_ns = np.repeat(since_ns, self.sensor.count)
            encoder_rad = since_ns * (mount.rpm / 60e9) % 1 * (2 * np.pi)
            sent_ns = (start_ns + (number + 1) * self.period_ns) // 1000 * 1000
            yield Batch(Firings(start_ns + since_ns, laser, encoder_rad), number, sent_ns)

    def encode(self, mount, batch, range_m, reflectivity):
        packets = np.zeros(len(batch.number), self.dtype)
        first = slice(None, None, self.columns * self.sensor.count)
        head, returns = packets["head"], packets["returns"]
        head["magic"], head["counter"], head["time_ns"] = b"TOY1", batch.number, batch.firings.time_ns[first]
        head["heading"] = (
            np.rint(batch.firings.encoder_rad[first] / (2 * np.pi) * REVOLUTION).astype(np.int64) % REVOLUTION
        )
        head["step"] = round(mount.rpm / 60e9 * COLUMN_NS * REVOLUTION)
        units = np.rint(range_m / UNIT_M).reshape(returns.shape)
        returns["range"] = np.where((units > 0) & (units < 2**16), units, 0)
        returns["reflectivity"] = reflectivity.reshape(returns.shape)
        data = packets.view(np.uint8).reshape(len(packets), -1)
        return Payloads(batch.sent_ns, data, mount.data_port, NETWORK, HEADER, int(batch.number[0]))

    def sent(self, mount, batch, payloads):
        return payloads.data.view(self.dtype)["returns"]["range"].reshape(-1, 1) > 0

    def companions(self, mount):
        return {".toy.yaml": yaml.safe_dump(self.sensor.model_dump(mode="json", exclude_none=True)).encode()}

    @classmethod
    def claims(cls, source, size, payload):
        return payload[:4] == b"TOY1"

    @classmethod
    def recognise(cls, source, packets, known):
        return next(loads(text.decode(), Sensor, name) for name, text in source.companions(".toy.yaml").items())

    def decoder(self, source, packets, known, trusted):
        return self

    def time_ns(self, packets, host_ns):
        return packets.view(self.dtype)[:, 0]["head"]["time_ns"]

    def heading_rad(self, packets):
        return packets.view(self.dtype)[:, 0]["head"]["heading"] * (2 * np.pi / REVOLUTION)

    def count(self, packets, wanted):
        counter = packets.view(self.dtype)[:, 0]["head"]["counter"].astype(np.int64)
        self.lost += int((np.diff(counter)[wanted[1:]] - 1).sum())

    def tally(self):
        return Tally((self.sensor.name,), ("strongest",), self.lost, np.nan)

    def decode(self, packets, host_ns, wanted):
        packets = packets.view(self.dtype)[:, 0][wanted]
        packet, column, laser = np.nonzero(packets["returns"]["range"])
        head, returns = packets["head"][packet], packets["returns"][packet, column, laser]
        azimuth = (head["heading"] + column * head["step"].astype(np.int64)) * (2 * np.pi / REVOLUTION)
        return Returns(
            xyz_m=directions(azimuth, self.sensor.elevation_rad[laser]) * (returns["range"] * UNIT_M)[:, None],
            range_m=returns["range"] * UNIT_M,
            azimuth_rad=azimuth,
            time_ns=head["time_ns"] + column * COLUMN_NS,
            laser=laser.astype(np.uint8),
            ring=self.sensor.ring[laser].astype(np.uint8),
            intensity=returns["reflectivity"],
            return_type=np.zeros(len(laser), np.uint8),
        )

    def firing_ns(self):
        return np.zeros(self.sensor.count, np.int64)
