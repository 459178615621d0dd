"""What a toy's file says, and when its lasers fire."""

import numpy as np

from lidarcfg.config.models import Model
from lidarcfg.sensors.schedule import FiringSchedule


class Facts(Model):
    """All that a sensor's file says under `toy`."""

    columns: int  # in a packet


def firing_schedule(sensor, facts):
    """All lasers at the same time, every 0.1 ms."""
    return FiringSchedule(np.zeros(sensor.count, np.int64), 100_000, facts.columns, per_azimuth=1)
