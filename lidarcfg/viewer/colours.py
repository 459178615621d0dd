"""The colours of pages, stills and points: bright on dark, and distinct for colour-blind people."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import CloudError
from lidarcfg.geometry import Array
from lidarcfg.viewer.contents import Contents

By = Literal["sensor", "intensity", "ring", "height", "time", "object"]
COLOUR_BY: tuple[By, ...] = get_args(By)
BACKGROUND = (16, 20, 28)
NIGHT = "#{:02x}{:02x}{:02x}".format(*BACKGROUND)
BRIGHT = (
    "#56B4E9",
    "#E69F00",
    "#2ED9A3",
    "#F5A9D6",
    "#F0E442",
    "#FF7F50",
)  # after Okabe and Ito
SCALE = (
    *("#433e85", "#38588c", "#2d708e", "#25858e", "#1e9b8a"),
    *("#2ab07f", "#52c569", "#86d549", "#c2df23", "#fde725"),
)  # viridis without its darkest sixth, which is lost on NIGHT
RETRO = "#FFFFFF"  # intensities above 100: retro-reflectors
UNKNOWN = "#808890"  # object unknown, or none: rain and fog
WORST = "#FF7F50"
EXCLUDED = "#9AA4B2"
BLIND = "#A98BFF"
VEHICLE = "#C3CAD4"
BASE_AREA = "#2A9D5C"
BASE = "#101418"
ZONE = "#F0E442"
DIFFUSE = 100  # intensities up to here are diffuse, in per cent


def colour(index: int) -> str:
    """The colour of sensor or object number `index`: after all of BRIGHT they come paler, and then darker."""
    share, ground = ((0.0, 0.0), (0.45, 255.0), (0.45, 0.0))[index // len(BRIGHT) % 3]
    mixed = (1 - share) * rgb([BRIGHT[index % len(BRIGHT)]])[0] + share * ground
    return "#{:02X}{:02X}{:02X}".format(*mixed.round().astype(int))


def rgb(colours: Sequence[str]) -> NDArray[np.uint8]:
    """(n, 3) of #rrggbb."""
    return np.array([tuple(bytes.fromhex(code[1:])) for code in colours], np.uint8).reshape(-1, 3)


def scaled(values: ArrayLike, low: float, high: float) -> Array:
    """(N, 3) colours 0 to 255 of values (N,) from low to high along the scale; its ends for values beyond."""
    fraction = np.clip((np.asarray(values, np.float64) - low) / ((high - low) or 1.0), 0.0, 1.0)
    at = np.linspace(0.0, 1.0, len(SCALE))
    return np.stack([np.interp(fraction, at, channel) for channel in rgb(SCALE).T], axis=-1)


def sensor_colours(contents: Contents) -> dict[str, str]:
    """A colour for each sensor's name: the cloud's, then the rigs'."""
    names = [*contents.cloud.sensor_names, *(mount.name for rig in contents.rigs for mount in rig.mounts)]
    return {name: colour(i) for i, name in enumerate(dict.fromkeys(names))}


def point_colours(contents: Contents, by: By) -> NDArray[np.uint8]:
    """(N, 3) of the cloud's points. Raises CloudError if objects are unknown."""
    cloud = contents.cloud
    if by == "object":
        if contents.objects is None:
            raise CloudError("objects are known only from ground truth; give the .npz of export --truth, too")
        table = rgb([*(colour(i) for i in range(len(contents.objects.names) - 1)), UNKNOWN])
        return _lit(table[contents.objects.index], cloud)
    if by == "sensor":
        return _lit(
            rgb([sensor_colours(contents)[name] for name in cloud.sensor_names] or [BRIGHT[0]])[cloud.sensor], cloud
        )
    low, high = span(contents, by)
    values = {
        "intensity": cloud.intensity,
        "ring": cloud.ring,
        "height": cloud.xyz[:, 2],
        "time": (cloud.time_ns - cloud.time_ns.min(initial=2**62)) / 1e9,
    }[by]
    shades = scaled(values, low, high).astype(np.uint8)
    if by == "intensity":
        shades[cloud.intensity > DIFFUSE] = rgb([RETRO])
    return shades


def span(contents: Contents, by: By) -> tuple[float, float]:
    """The ends of the colour scale: per cent, rings, metres, or seconds since the first point."""
    cloud = contents.cloud
    if not len(cloud.xyz) or by == "intensity":
        return 0.0, float(DIFFUSE)
    if by == "ring":
        return 0.0, float(max(cloud.ring.max(), 1))
    if by == "height":
        low, high = np.percentile(cloud.xyz[:: max(len(cloud.xyz) // 100_000, 1), 2], (1, 99)).tolist()
        return low, max(high, low + 0.1)
    return 0.0, max(float(np.ptp(cloud.time_ns)) / 1e9, 1e-6)


def _lit(base: NDArray[np.uint8], cloud: PointCloud) -> NDArray[np.uint8]:
    """Colours (N, 3), darker for dark objects."""
    light = 0.7 + 0.3 * np.sqrt(np.minimum(cloud.intensity, DIFFUSE) / DIFFUSE)
    return np.asarray(base * light[:, None], np.uint8)
