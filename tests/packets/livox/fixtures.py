"""What the tests of Livox's packets share."""

import numpy as np

from lidarcfg.config.models import Section
from lidarcfg.packets.families import codec
from lidarcfg.sensors.rig import Mount, ports
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS

KINDS = {"cartesian_mm": 1, "cartesian_cm": 2, "spherical": 3}


def mount(model: str = "mid-360", data_type: str = "cartesian_mm", **options) -> Mount:
    """A sensor at the vehicle's origin, 2 m up, with the maker's ports."""
    sensor = load_sensor(model)
    data_port, telemetry_port = ports(sensor)
    given = {
        "name": "front",
        "sensor": sensor,
        "position_m": (0.0, 0.0, 2.0),
        "rpy_rad": (0.0, 0.0, 0.0),
        "model": model,
        "host": "192.168.1.121",
        "data_port": data_port,
        "telemetry_port": telemetry_port,
        "rpm": 600.0,
        "return_mode": "strongest",
        "settings": Section({"data_type": data_type}),
    }
    return Mount(**given | options)


def encoded(of: Mount, packets: int, seed: int = 1, start_ns: int = START_NS):
    """Random measurements, a tenth without return, as packets: batch, ranges, reflectivities, payloads."""
    maker = codec(of.sensor)
    rng = np.random.default_rng(seed)
    (batch,) = maker.schedule(of, start_ns, [range(packets)])
    shape = len(batch.firings.time_ns), 1
    range_m = np.where(rng.random(shape) < 0.1, np.inf, rng.uniform(0.6, 69, shape))
    reflectivity = rng.integers(0, 256, shape, np.uint8)
    return batch, range_m, reflectivity, maker.encode(of, batch, range_m, reflectivity)
