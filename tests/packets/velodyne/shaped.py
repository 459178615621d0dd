"""The package's functions for arrays that are shaped as packets are: P packets of S sequences of L lasers."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.geometry import directions
from lidarcfg.packets.velodyne import decode as decoding
from lidarcfg.packets.velodyne import encode as encoding
from lidarcfg.packets.velodyne.model import unit
from lidarcfg.sensors import schedule
from lidarcfg.sensors.firing import Firings


@dataclass(frozen=True)
class Fired:
    """Firings, (P, S, L)."""

    time_ns: np.ndarray
    azimuth_rad: np.ndarray

    @property
    def flat(self):
        laser = np.broadcast_to(np.arange(self.time_ns.shape[2], dtype=np.uint8), self.time_ns.shape)
        return Firings(self.time_ns.ravel(), laser.ravel(), self.azimuth_rad.ravel())


def facts(sensor):
    """What the sensor's file says under `velodyne`."""
    return unit(sensor).facts


def with_facts(sensor, **parts):
    """The sensor with some of its facts changed, part by part."""
    section = dict(sensor.velodyne)
    for part, values in parts.items():
        section[part] = section.get(part, {}) | values if values is not None else None
    return sensor.model_copy(update={"velodyne": section})


def shaped(sensor, fired, dual=False):
    shape = -1, *unit(sensor).offsets_ns(dual).shape
    return Fired(fired.time_ns.reshape(shape), fired.encoder_rad.reshape(shape))


def firings(sensor, rpm, start_ns, packets, dual=False, phase_deg=None):
    return shaped(sensor, schedule.firings(unit(sensor).firing_schedule(dual), rpm, start_ns, packets, phase_deg), dual)


def rays(sensor, fired):
    """Origins and directions (P, S, L, 3) in the sensor frame: by the formula, not by the package."""
    azimuth = fired.azimuth_rad + sensor.azimuth_offset_rad
    elevation = np.broadcast_to(sensor.elevation_rad, azimuth.shape)
    along = directions(azimuth.ravel(), elevation.ravel()).reshape(*azimuth.shape, 3)
    left = sensor.lateral_offset_m
    up = np.broadcast_to(sensor.vertical_offset_m, azimuth.shape)
    return np.stack([left * np.sin(azimuth), left * np.cos(azimuth), up], axis=-1), along


def encode(sensor, mode, fired, range_m, reflectivity, pps="locked"):
    columns = 2 if mode == "dual" else 1
    measured = range_m.reshape(-1, columns), reflectivity.reshape(-1, columns)
    return encoding.encode(unit(sensor), mode, fired.flat, *measured, pps)


def sent_returns(sensor, mode, packets):
    return encoding.returned(unit(sensor), mode, packets)


def decode(sensor, packets, host_ns, wanted=None):
    return decoding.decode(unit(sensor), packets, host_ns, wanted)


def packet_period_ns(sensor, dual=False):
    return unit(sensor).period_ns(dual)


def packet_stamps_ns(sensor, fired):
    """When each packet (P,) is stamped, and when it is complete."""
    firing = facts(sensor).firing
    first, last = (fired.time_ns[:, sequence, 0] - firing.offset_ns[0] for sequence in (0, -1))
    return first, last + firing.sequence_ns
