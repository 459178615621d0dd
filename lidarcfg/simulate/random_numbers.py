"""Random numbers by firing and by laser, repeatable from a seed, whatever is computed in parallel."""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.sensors.realism import Realism

DROPOUT, NOISE, CELL, LASER, INTENSITY, ALONE = range(6)  # streams of random numbers


def uniforms(realism: Realism, sensor_index: int, stream: int, first: int, count: int) -> Array:
    """Random numbers `first` to `first` + count of a stream, in (0, 1), independent of how the stream is divided.

    `first` and `count` are multiples of four: Philox generates four at a time.
    """
    assert first % 4 == 0
    assert count % 4 == 0
    philox = np.random.Philox(key=[realism.seed, 8 * sensor_index + stream], counter=[first // 4, 0, 0, 0])
    return np.random.Generator(philox).random(count) + 2.0**-54
