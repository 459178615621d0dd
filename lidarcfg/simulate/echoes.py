"""Echoes of a wide beam: what its rays hit, merged, and what rain and fog send back; with noise and dropouts.

The power of an echo follows the LiDAR equation for extended Lambertian targets, P ~ ρ cos θ exp(-2 α r) / r²
(Jelalian, Laser Radar Systems, 1992, ch. 1; Rasshofer, Spies and Spies, Adv. Radio Sci. 9, 2011, 49-60).
A retro-reflector (byte above 100) reflects independently of the angle; its ρ is taken as byte / 100.

Random numbers come by firing and by laser, repeatable from a seed, whatever is computed in parallel. The noise of real
sensors stands in `sensors/*.yaml`; tests/simulate/roughness.py measures it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg import maths
from lidarcfg.core import simulate
from lidarcfg.geometry import Array
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Sensor
from lidarcfg.world.scene_file import Weather

DROPOUT, NOISE, CELL, LASER, INTENSITY, ALONE = range(6)  # streams of random numbers
PULSE_M = 0.75  # half the length of a 5 ns pulse: a guess, no maker states it
CELLS = 24  # of PULSE_M, from the sensor's minimum range on, that rain and fog can send an echo from
# Extinction to backscatter of water droplets (Pinnick et al., Appl. Opt. 22, 1983; O'Connor 2004).
LIDAR_RATIO_SR = 18.8
KOSCHMIEDER = 3.912  # -ln(0.02): extinction times visibility (WMO-No. 8), at 903 nm as in visible light
RAIN_DB_KM = 1.076  # Carbonneau and Wisely 1998, as in ITU-R P.1814: dB/km = 1.076 R^0.67
RAIN_EXPONENT = 0.67
DECIBEL = 10 / maths.log(10)
# A Gaussian beam by Gauss-Hermite quadrature with three nodes per direction; the divergence is the full angle at 1/e²
# of the intensity (a guess, the makers do not say), which is four sigma.
NODES = np.array([-math.sqrt(3), 0, math.sqrt(3)]) / 4
WEIGHTS = np.array([1, 4, 1]) / 6
# What a return mode may report of a firing: the strongest echo; the strongest, or the second strongest if the strongest
# is the last; the last; the first; the strongest, or the second strongest if the strongest is the first; the second
# strongest, or the strongest if it is alone.
STRONGEST, STRONGEST_BUT_LAST, LAST, FIRST, STRONGEST_BUT_FIRST, SECOND = CANDIDATES = tuple(range(6))
REPORTED = {
    "strongest": (STRONGEST,),
    "last": (LAST,),
    "first": (FIRST,),
    "dual": (STRONGEST_BUT_LAST, LAST),
    "first-last": (FIRST, LAST),
    "first-strongest": (FIRST, STRONGEST_BUT_FIRST),
    "two-strongest": (STRONGEST, SECOND),
}
EXACT = Realism()
DARK = 2  # reflectivities below are of dark targets


def uniforms(realism: Realism, sensor_index: int, stream: int, first: int, count: int) -> Array:
    """Random numbers `first` to `first` + count of a stream, in (0, 1), independent of how the stream is divided."""
    return drawn((realism.seed, 8 * sensor_index + stream), first, count)


def drawn(key: tuple[int, int], first: int, count: int) -> Array:
    """The same of any stream, which a seed and a number name."""
    before = first % 4  # Philox generates four at a time
    philox = np.random.Philox(key=list(key), counter=[first // 4, 0, 0, 0])
    return np.random.Generator(philox).random(before + count)[before:] + 2.0**-54


@dataclass(frozen=True)
class Echoes:
    """Echoes of N firings, (N, R)."""

    range_m: Array  # exact; inf: none
    noise_m: Array  # to be added
    reflectivity: NDArray[np.uint8]
    object: NDArray[np.int32]  # -1: none, or rain and fog
    strongest_m: Array  # (N,) the exact range of the strongest echo, reported or not


def thin_beam_echoes(
    range_m: Array, reflectivity: NDArray[np.uint8], objects: NDArray[np.int32], return_mode: str
) -> Echoes:
    """Exact echoes of thin beams, (N, 1), or (N, 2) for dual returns: the only echo, twice."""
    shape = len(range_m), len(REPORTED[return_mode])
    return Echoes(
        range_m=np.broadcast_to(range_m, shape),
        noise_m=np.broadcast_to(0.0, shape),
        reflectivity=np.broadcast_to(reflectivity, shape),
        object=np.broadcast_to(objects, shape),
        strongest_m=range_m[:, 0],
    )


def beam_rays(sensor: Sensor, realism: Realism) -> tuple[Array, Array, Array]:
    """The K rays of a beam: tangents of their angles to its axis (K,), across and up; weights (K,)."""
    if not realism.divergence:
        return np.zeros(1), np.zeros(1), np.ones(1)
    across, above = (np.array(_width_mrad(sensor, realism)) / 1000)[:, None] * NODES
    return np.repeat(across, len(NODES)), np.tile(above, len(NODES)), np.outer(WEIGHTS, WEIGHTS).ravel()


def _width_mrad(sensor: Sensor, realism: Realism) -> tuple[float, float]:
    if isinstance(realism.divergence, tuple):
        return realism.divergence
    assert sensor.optics
    return sensor.optics.divergence_mrad


def extinction_per_m(weather: Weather) -> float:
    """The extinction coefficient of fog and rain together."""
    fog = KOSCHMIEDER / weather.fog_visibility_m if weather.fog_visibility_m else 0.0
    if not weather.rain_mm_h:
        return fog
    rain_db_km = RAIN_DB_KM * maths.power(weather.rain_mm_h, RAIN_EXPONENT)
    return float(fog + rain_db_km / DECIBEL / 1000)


def wide_beam_echoes(
    sensor: Sensor,
    realism: Realism,
    weather: Weather,
    sensor_index: int,
    first: int,
    weights: Array,
    rays: simulate.SubRays,
    candidates: Sequence[int] = CANDIDATES,
) -> Echoes:
    """Exact candidates (N, C) of firings `first` to `first` + N, whose beams are rays with weights (K,)."""
    assert sensor.range
    count = len(rays.range_m)
    alpha = extinction_per_m(weather)
    with_strongest = candidates if candidates[0] == STRONGEST else (STRONGEST, *candidates)
    extra = len(with_strongest) - len(candidates)  # columns that are computed for `strongest_m` alone
    which = np.array(with_strongest, np.uint8)
    least = 0.1 / realism.range_10_percent_m**2 if realism.range_10_percent_m else 0.0
    if alpha and not least:
        least = 0.1 / sensor.range.max_m**2
    droplets = np.empty((0, 2))
    fade = np.empty((0, 0))
    if alpha:
        droplets = np.stack(_droplets(sensor, realism, sensor_index, first, count, alpha), axis=1)
        fade = maths.exp(-2 * alpha * np.column_stack([rays.range_m, droplets[:, :1]]))
    found = simulate.Candidates(
        range_m=np.empty((count, len(which))),
        reflectivity=np.empty((count, len(which)), np.uint8),
        object=np.empty((count, len(which)), np.int32),
    )
    range_max_m = sensor.range.reported_m[1]
    simulate.merge_echoes(rays, weights, range_max_m, _step_rad(sensor, realism), least, droplets, fade, which, found)
    return Echoes(
        range_m=np.ascontiguousarray(found.range_m[:, extra:]),
        noise_m=np.zeros((count, len(candidates))),
        reflectivity=np.ascontiguousarray(found.reflectivity[:, extra:]),
        object=np.ascontiguousarray(found.object[:, extra:]),
        strongest_m=found.range_m[:, 0].copy(),
    )


def _step_rad(sensor: Sensor, realism: Realism) -> float:
    """The largest angle between neighbouring rays of a beam."""
    known = sensor.optics or isinstance(realism.divergence, tuple)
    return max(_width_mrad(sensor, realism)) / 1000 * float(NODES[-1]) if known else 0.0


def _droplets(
    sensor: Sensor, realism: Realism, sensor_index: int, first: int, count: int, alpha: float
) -> tuple[Array, Array]:
    """The strongest echo from rain and fog: its range (N,) and the albedo (N,) of an equally bright target.

    A cell of length PULSE_M reflects as much as a target of albedo π PULSE_M α / LIDAR_RATIO_SR (Rasshofer
    et al. 2011, soft targets), times an exponentially distributed number: the speckle of many droplets (Goodman, 1975).
    """
    assert sensor.range
    middle = sensor.range.min_m + (np.arange(CELLS) + 0.5) * PULSE_M
    speckle = -maths.log(uniforms(realism, sensor_index, CELL, CELLS * first, CELLS * count)).reshape(count, CELLS)
    albedo = math.pi * PULSE_M * alpha / LIDAR_RATIO_SR * speckle
    best = np.argmax(albedo * maths.exp(-2 * alpha * middle) / middle**2, axis=1)
    return middle[best], albedo[np.arange(count), best]


class SensorErrors:
    """What the sensor number `index` of a rig adds to exact echoes: dropouts, noise, and its lasers' own errors."""

    def __init__(self, index: int, mount: Mount) -> None:
        self._index = index
        self._realism = mount.realism or EXACT
        self._return_mode = mount.return_mode
        self._lasers_m = laser_errors_m(self._realism, index, mount.sensor.count)

    def add(self, found: Echoes, laser: NDArray[np.uint8], first: int) -> None:
        """Change the echoes of N firings of lasers (N,), numbered from `first` on."""
        apply_dropout(found, self._realism, self._index, first)
        add_noise(found, self._realism, self._index, first)
        found.noise_m[:] += self._lasers_m[laser][:, None]
        if self._return_mode == "dual":
            drop_one_return(found, self._realism, self._index, first)


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
