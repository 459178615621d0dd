"""What the tests of Seyond's packets share."""

import numpy as np

from lidarcfg.files import shipped
from lidarcfg.packets.families import codec
from lidarcfg.packets.seyond.telemetry import table_packet
from lidarcfg.sensors.rig import Mount, ports
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.units import START_NS

MODELS = "falcon-k1", "falcon-k2", "robin-w"
TYPES = {"falcon-k1": 1, "falcon-k2": 9, "robin-w": 13}
RETURN_MODES = {"strongest": 1, "two-strongest": 2, "dual": 3}
UNITS_PER_M = {"falcon-k1": 200, "falcon-k2": 400, "robin-w": 400}


def mount(model: str = "falcon-k1", return_mode: str = "strongest", **options) -> Mount:
    """A sensor at the vehicle's origin, 2 m up, with the maker's port."""
    sensor = load_sensor(model)
    data_port, telemetry_port = ports(sensor)
    given = {
        "name": "front",
        "sensor": sensor,
        "position_m": (0.0, 0.0, 2.0),
        "rpy_rad": (0.0, 0.0, 0.0),
        "model": model,
        "host": "172.168.1.10",
        "data_port": data_port,
        "telemetry_port": telemetry_port,
        "rpm": 600.0,
        "return_mode": return_mode,
    }
    return Mount(**given | options)


def encoded(of: Mount, packets: range, seed: int = 1, start_ns: int = START_NS):
    """Random measurements, a tenth without return, as packets: batch, ranges, reflectivities, payloads."""
    maker = codec(of.sensor)
    rng = np.random.default_rng(seed)
    (batch,) = maker.schedule(of, start_ns, [packets])
    shape = len(batch.firings.time_ns), 1 + of.dual
    range_m = np.where(rng.random(shape) < 0.1, np.inf, rng.uniform(2, 140, shape))
    reflectivity = rng.integers(1, 256, shape, np.uint8)
    if of.dual:  # a firing with one return has it twice
        alone = rng.random(shape[0]) < 0.3
        range_m[alone, 1] = range_m[alone, 0]
        reflectivity[alone, 1] = reflectivity[alone, 0]
    return batch, range_m, reflectivity, maker.encode(of, batch, range_m, reflectivity)


def starts() -> dict[str, np.ndarray]:
    """Where beams start, as the file has it."""
    with np.load(shipped("sensors") / "seyond-starts.npz") as tables:
        return dict(tables)


def table(model: str) -> bytes:
    """The packet with a Robin W's angles; of others none."""
    if model != "robin-w":
        return b""
    unit = codec(load_sensor(model)).unit
    return table_packet(unit, unit.angle_table).tobytes()
