"""Noise and dropouts: random numbers by firing and by laser, repeatable from a seed.

The figures of real sensors stand in `sensors/*.yaml`; tests/simulate/roughness.py measures them.
"""

from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.sensors.realism import Realism

if TYPE_CHECKING:
    from lidarcfg.simulate.echoes import Echoes

DROPOUT, NOISE, CELL, LASER, INTENSITY, ALONE = range(6)  # streams of random numbers
DARK = 2  # reflectivities below are of dark targets


def uniforms(realism: Realism, sensor_index: int, stream: int, first: int, count: int) -> Array:
    """Random numbers `first` to `first` + count of a stream, in (0, 1), independent of how the stream is divided.

    `first` and `count` are multiples of four: Philox generates four at a time.
    """
    assert first % 4 == 0
    assert count % 4 == 0
    philox = np.random.Philox(key=[realism.seed, 8 * sensor_index + stream], counter=[first // 4, 0, 0, 0])
    return np.random.Generator(philox).random(count) + 2.0**-54


def lose(found: "Echoes", realism: Realism, sensor_index: int, first: int) -> None:
    """Remove all echoes of some firings; firings are numbered from `first` on."""
    if realism.dropout_fraction:
        lost = uniforms(realism, sensor_index, DROPOUT, first, len(found.range_m)) < realism.dropout_fraction
        found.range_m[lost] = np.inf


def roughen(found: "Echoes", realism: Realism, sensor_index: int, first: int) -> None:
    """Write the range noise of each candidate, and add noise to its reflectivity; equal echoes get equal noise."""
    dark_m = realism.range_noise_m if realism.dark_noise_m is None else realism.dark_noise_m
    if realism.range_noise_m or dark_m:
        sigma_m = np.where(found.reflectivity < DARK, dark_m, realism.range_noise_m)
        found.noise_m[:] = sigma_m * _normals(realism, sensor_index, NOISE, first, found.range_m)
    if realism.intensity_noise:
        levels = realism.intensity_noise * _normals(realism, sensor_index, INTENSITY, first, found.range_m)
        found.reflectivity[:] = np.clip(np.rint(found.reflectivity + levels), 0, 255)


def laser_errors_m(realism: Realism, sensor_index: int, lasers: int) -> Array:
    """(L,): the constant error of each laser of a unit, whose standard deviation is the one that is asked for.

    They are as evenly spread as those of a normal distribution can be; the seed says which laser has which.
    """
    if not realism.laser_error_m or lasers < 2:
        return np.zeros(lasers)
    from scipy.special import ndtri

    scores = ndtri((np.arange(lasers) + 0.5) / lasers)
    which = np.argsort(uniforms(realism, sensor_index, LASER, 0, -(-lasers // 4) * 4)[:lasers])
    return np.asarray(realism.laser_error_m * (scores / scores.std())[which])


def separate(pairs: "Echoes", realism: Realism, sensor_index: int, first: int) -> None:
    """Empty one slot of some dual returns (N, 2), strongest and last."""
    if realism.last_alone_fraction or realism.strongest_alone_fraction:
        drawn = uniforms(realism, sensor_index, ALONE, first, len(pairs.range_m))
        pairs.range_m[drawn < realism.last_alone_fraction, 0] = np.inf
        pairs.range_m[1 - drawn < realism.strongest_alone_fraction, 1] = np.inf


def _normals(realism: Realism, sensor_index: int, stream: int, first: int, range_m: Array) -> Array:
    """Normal numbers for candidates (N, R): one for the strongest and those at its range, one for the others."""
    from scipy.special import ndtri

    count = len(range_m)
    normal = ndtri(uniforms(realism, sensor_index, stream, 2 * first, 2 * count)).reshape(count, 2)
    return np.asarray(np.where(range_m == range_m[:, :1], normal[:, :1], normal[:, 1:]))
