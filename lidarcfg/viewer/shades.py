"""The colours of a stage's points."""

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import CloudError
from lidarcfg.viewer.colours import BRIGHT, DIFFUSE, RETRO, UNKNOWN, By, colour, rgb, scaled
from lidarcfg.viewer.stage import Stage


def point_colours(stage: Stage, by: By) -> NDArray[np.uint8]:
    """(N, 3) of the cloud's points. Raises CloudError if objects are unknown."""
    cloud = stage.cloud
    if by == "object":
        if stage.objects is None:
            raise CloudError("objects are known only from ground truth; give the .npz of export --truth, too")
        table = rgb([*(colour(i) for i in range(len(stage.objects.names) - 1)), UNKNOWN])
        return _lit(table[stage.objects.index], cloud)
    if by == "sensor":
        return _lit(rgb([stage.colours[name] for name in cloud.sensor_names] or [BRIGHT[0]])[cloud.sensor], cloud)
    low, high = span(stage, by)
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


def span(stage: Stage, by: By) -> tuple[float, float]:
    """The ends of the colour scale: per cent, rings, metres, or seconds since the first point."""
    cloud = stage.cloud
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
