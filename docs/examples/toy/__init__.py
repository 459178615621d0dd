"""A toy maker's packets, whole: what docs/codec.md walks through.

All lasers of a sensor fire together every 0.1 ms. `layout` has the bytes, `model` what a sensor's file says and when
its lasers fire, `encode` and `decode` the returns, `telemetry` what a sensor reports about itself. `Toy` is the codec
that the package uses.
"""

import numpy as np

from lidarcfg.config.models import loads
from lidarcfg.packets.codec import Codec, Payloads
from lidarcfg.sensors.schedule import SequenceTiming
from lidarcfg.sensors.sensor import Sensor

from . import encode, telemetry
from .decode import ToyDecoder
from .layout import HEADER, MAGIC, NETWORK, octets
from .model import Facts, firing_schedule


class Toy(SequenceTiming, Codec):
    """The packets of one sensor."""

    facts_model = Facts

    def __init__(self, sensor):
        self.sensor = sensor
        self.facts = sensor.section.checked(Facts)

    def firing_schedule(self, mount):
        return firing_schedule(self.sensor, self.facts)

    def encode(self, mount, batch, range_m, reflectivity):
        packets = encode.encode(self.sensor.count * self.facts.columns, batch, range_m, reflectivity)
        return Payloads(batch.sent_ns, octets(packets), mount.data_port, NETWORK, HEADER, batch.first)

    def sent(self, mount, batch, payloads):
        return encode.sent(payloads.data)

    def housekeeping(self, mount, trajectory, origin, start_ns, due_ns):
        return telemetry.positions(mount, trajectory, start_ns, due_ns)

    def sidecar_files(self, mount):
        return {".toy.json": self.sensor.model_dump_json(exclude_none=True).encode()}

    @classmethod
    def matches(cls, source, size, payload):
        return payload[:4] == MAGIC

    @classmethod
    def identify(cls, source, packets, known):
        return next(loads(text.decode(), Sensor, name) for name, text in source.sidecar_files(".toy.json").items())

    def decoder(self, source, packets, known, trusted):
        return ToyDecoder(self.sensor, self.firing_schedule(None).period_ns)

    def firing_ns(self):
        return np.zeros(self.sensor.count, np.int64)
