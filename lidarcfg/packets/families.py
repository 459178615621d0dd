"""The registry of packet families: which codec a sensor has, and when its lasers fire.

The only module that names the makers; simulation, placement and captures ask it for a sensor's codec, timing or
pattern.
"""

from dataclasses import replace
from importlib import import_module
from itertools import count

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.packets.codec import Codec, Payloads
from lidarcfg.sensors.firing import RETURN_TYPES, FramePattern, Pattern, Timing
from lidarcfg.sensors.pattern_timing import PatternTiming
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.schedule import GenericTiming
from lidarcfg.sensors.sensor import Sensor

FAMILIES = {  # module and class, loaded when they are needed
    "velodyne": "lidarcfg.packets.velodyne:Velodyne",
    "hesai": "lidarcfg.packets.hesai:Hesai",
    "hesai_at": "lidarcfg.packets.hesai.at:HesaiAt",
    "robosense": "lidarcfg.packets.robosense:Robosense",
    "emx": "lidarcfg.packets.emx:Emx",
    "livox": "lidarcfg.packets.livox:Livox",
    "ouster": "lidarcfg.packets.ouster:Ouster",
    "seyond": "lidarcfg.packets.seyond:Seyond",
}


def family(name: str) -> type[Codec]:
    """The family with this name. Raises ConfigError."""
    if name not in FAMILIES:
        raise ConfigError(f"no codec is called {name!r}; allowed: {', '.join(sorted(FAMILIES))}")
    module, _, member = FAMILIES[name].partition(":")
    found: type[Codec] = getattr(import_module(module), member)
    return found


def codec(sensor: Sensor) -> Codec:
    """The sensor's codec. Raises ConfigError if it has none, or for invalid facts in its file."""
    if sensor.codec is None:
        raise ConfigError(f"sensor {sensor.name!r} has no codec, and so no packets")
    found = family(sensor.codec)
    if found.scans != bool(sensor.scan_pattern):
        needed = "scan_pattern" if found.scans else "beams"
        raise ConfigError(f"sensor {sensor.name!r} has no {needed}, which codec {sensor.codec} needs")
    return found(sensor)


def timing(sensor: Sensor) -> Timing:
    """The timing of the sensor's lasers, by its codec or without one. Raises ConfigError."""
    if sensor.codec:
        return codec(sensor)
    return PatternTiming() if sensor.scan_pattern else GenericTiming(sensor)


def pattern(mount: Mount) -> Pattern | FramePattern:
    """Where the lasers of a mount's sensor fire in a revolution or a frame. Raises ConfigError if that is not known."""
    sensor = mount.sensor
    if not sensor.fires:
        what = "has no codec, which would say where its lasers fire; add firing to its file"
        raise ConfigError(f"sensor {sensor.name!r} {what}")
    return timing(sensor).pattern(mount)


def first_packet(mount: Mount, start_ns: int = 0) -> Payloads:
    """The first packet that a mount's sensor sends, with no returns. Raises ConfigError."""
    maker = codec(mount.sensor)
    everywhere = replace(mount, azimuth_fov_deg=None)
    one_by_one = (range(n, n + 1) for n in count())
    batch = next(some for some in maker.schedule(everywhere, start_ns, one_by_one) if len(some.number))
    shape = len(batch.firings.time_ns), len(RETURN_TYPES[mount.return_mode])
    return maker.encode(everywhere, batch, np.full(shape, np.inf), np.zeros(shape, np.uint8))
