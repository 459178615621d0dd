"""Latitude and longitude of points in the world frame: WGS 84, by pymap3d."""

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.geometry import Array

# pymap3d's closed form (You 2000) loses accuracy with the height above the ellipsoid: 2 mm of latitude at 3,000 km from
# the origin, where the tangent plane is 670 km up, 1 m at 10,000 km. Two Newton steps leave less than 1e-6 m of that.
NEWTON_STEPS = 2


class GeoOrigin(Model):
    """The place of the world's origin on Earth; x points east and y north."""

    latitude_deg: Annotated[float, Field(ge=-89, le=89)] = 0.0
    longitude_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0


def geographic(origin: GeoOrigin, xyz_m: ArrayLike) -> Array:
    """Latitude and longitude (…, 2) in degrees of points (…, 3) of the world frame.

    The world frame is the east-north-up frame of the origin: its plane z = 0 is tangent to the ellipsoid there. A point
    has the latitude and longitude of the foot of its perpendicular on the ellipsoid. Longitude is within ±180.
    """
    import pymap3d

    place = origin.latitude_deg, origin.longitude_deg, 0.0
    ecef = pymap3d.enu2ecef(*np.moveaxis(np.asarray(xyz_m, np.float64), -1, 0), *place)
    latitude, longitude, height = pymap3d.ecef2geodetic(*ecef)
    for _ in range(NEWTON_STEPS):
        _, north, up = pymap3d.ecef2enu(*ecef, latitude, longitude, height)
        latitude = latitude + np.degrees(north / (pymap3d.rcurve.meridian(latitude) + height))
        height = height + up
    return np.stack([latitude, longitude], axis=-1)
