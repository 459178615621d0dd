"""Noise, dropouts and the constant errors of lasers, applied to the echoes of firings.

The figures of real sensors stand in `sensors/*.yaml`; tests/simulate/roughness.py measures them.
"""

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.sensors.realism import Realism
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.simulate.random_numbers import ALONE, DROPOUT, INTENSITY, LASER, NOISE, uniforms

DARK = 2  # reflectivities below are of dark targets


def apply_dropout(found: Echoes, realism: Realism, sensor_index: int, first: int) -> None:
    """Remove all echoes of a fraction of the firings; firings are numbered from `first` on."""
    if realism.dropout_fraction:
        lost = uniforms(realism, sensor_index, DROPOUT, first, len(found.range_m)) < realism.dropout_fraction
        found.range_m[lost] = np.inf
        found.strongest_m[lost] = np.inf


def add_noise(found: Echoes, realism: Realism, sensor_index: int, first: int) -> None:
    """Write the range noise of each candidate, and add noise to its reflectivity; equal echoes get equal noise."""
    dark_m = realism.range_noise_m if realism.dark_noise_m is None else realism.dark_noise_m
    if realism.range_noise_m or dark_m:
        sigma_m = np.where(found.reflectivity < DARK, dark_m, realism.range_noise_m)
        found.noise_m[:] = sigma_m * _normals(realism, sensor_index, NOISE, first, found)
    if realism.intensity_noise:
        levels = realism.intensity_noise * _normals(realism, sensor_index, INTENSITY, first, found)
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


def drop_one_return(pairs: Echoes, realism: Realism, sensor_index: int, first: int) -> None:
    """Drop the strongest or the last of a fraction of dual returns (N, 2), in that order."""
    if realism.last_alone_fraction or realism.strongest_alone_fraction:
        drawn = uniforms(realism, sensor_index, ALONE, first, len(pairs.range_m))
        pairs.range_m[drawn < realism.last_alone_fraction, 0] = np.inf
        pairs.range_m[1 - drawn < realism.strongest_alone_fraction, 1] = np.inf


def _normals(realism: Realism, sensor_index: int, stream: int, first: int, found: Echoes) -> Array:
    """Normal numbers for echoes (N, R): one for the strongest and those at its range, one for the others."""
    from scipy.special import ndtri

    count = len(found.range_m)
    normal = ndtri(uniforms(realism, sensor_index, stream, 2 * first, 2 * count)).reshape(count, 2)
    return np.asarray(np.where(found.range_m == found.strongest_m[:, None], normal[:, :1], normal[:, 1:]))
