"""The colours of pages and stills: bright on dark, and distinct for colour-blind people."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lidarcfg.geometry import Array

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
SEAT = "#2A9D5C"
BASE = "#101418"
ZONE = "#F0E442"
DIFFUSE = 100  # intensities up to here are diffuse, in per cent


def colour(index: int) -> str:
    """Of sensor or object number `index`."""
    return BRIGHT[index % len(BRIGHT)]


def rgb(colours: Sequence[str]) -> NDArray[np.uint8]:
    """(n, 3) of #rrggbb."""
    return np.array([tuple(bytes.fromhex(code[1:])) for code in colours], np.uint8).reshape(-1, 3)


def scaled(values: ArrayLike, low: float, high: float) -> Array:
    """(N, 3) colours 0 to 255 of values (N,) from low to high along the scale; its ends for values beyond."""
    fraction = np.clip((np.asarray(values, np.float64) - low) / ((high - low) or 1.0), 0.0, 1.0)
    at = np.linspace(0.0, 1.0, len(SCALE))
    return np.stack([np.interp(fraction, at, channel) for channel in rgb(SCALE).T], axis=-1)
