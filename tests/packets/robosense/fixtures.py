"""What the tests of RoboSense's packets share."""

from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import load_sensor


def mount(model: str, **options) -> Mount:
    """A sensor at the vehicle's origin, 2 m up, with the maker's ports."""
    given = {
        "name": "front",
        "sensor": load_sensor(model),
        "position_m": (0.0, 0.0, 2.0),
        "rpy_rad": (0.0, 0.0, 0.0),
        "model": model,
        "host": "192.168.1.200",
        "data_port": 6699,
        "telemetry_port": 7788,
        "rpm": 600.0,
        "return_mode": "strongest",
    }
    return Mount(**given | options)
