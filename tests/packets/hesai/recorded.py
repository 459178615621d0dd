"""The recordings of Hesai's sensors, and Nebula's clouds of one revolution of each."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.capture.pcap import read_batches
from lidarcfg.config.models import Section
from lidarcfg.packets.families import codec
from lidarcfg.packets.hesai import telemetry
from lidarcfg.packets.hesai.model import HesaiUnit, turning
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import load_sensor
from tests.capture_fixtures import no_warning, recording

BY_BLOCK = Section({"turns_while_firing": False})  # azimuths as Nebula and hydra4 have them


@dataclass(frozen=True)
class Recorded:
    """A recording. All are of mode 0x39, last and strongest."""

    name: str
    model: str
    angles: str
    size: int
    first: int  # packet in which the revolution of Nebula's cloud begins, and the one in which it ends
    last: int
    edge: int = 1  # packets from there on until all lasers are in the revolution, which Nebula cuts by each one's angle
    least_m: float = 0.0  # nearer points Nebula was set to drop

    @property
    def path(self):
        return recording(f"hesai/{self.name}.pcap")

    @property
    def table(self):
        return recording(f"hesai/{self.angles}.csv").read_bytes()

    @property
    def payloads(self):
        return np.concatenate([batch.payloads(self.size) for batch in read_batches(self.path, no_warning)])

    @property
    def unit(self):
        """The model with the unit's own angles, and azimuths by the block, as Nebula has them."""
        nominal = turning(codec(load_sensor(self.model)).unit, False)
        beams = telemetry.parse_corrections(self.angles, self.table)
        return HesaiUnit(nominal.sensor.model_copy(update={"beams": beams}), nominal.facts)

    @property
    def nebula_m(self):
        """(N, 3): the points of Nebula's cloud."""
        head, _, body = recording(f"hesai/{self.name}.pcd").read_bytes().partition(b"DATA binary\n")
        assert b"FIELDS x y z\n" in head
        count = int(head.split(b"POINTS ")[1].split()[0])
        return np.frombuffer(body, "<f4", 3 * count).reshape(-1, 3).astype(np.float64)


XT32 = Recorded("nebula_xt32", "pandar-xt32", "PandarXT32", 1080, 1498, 1998)
XT16 = Recorded("nebula_xt16", "pandar-xt16", "PandarXT16", 568, 625, 1125)
QT128 = Recorded("nebula_qt128", "qt128", "PandarQT128", 1127, 855, 1799, 52, 0.3)
ALL = (XT32, XT16, QT128)


def mount(model, return_mode="dual", **options):
    """A sensor of a model at the origin."""
    given = {"rpm": 600.0, "host": "192.168.1.201", "data_port": 2368, "telemetry_port": 8308} | options
    pose = {"position_m": (0.0, 0.0, 0.0), "rpy_rad": (0.0, 0.0, 0.0)}
    return Mount(name=model, sensor=load_sensor(model), model=model, return_mode=return_mode, **pose, **given)
