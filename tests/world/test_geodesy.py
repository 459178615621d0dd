"""Where on Earth a point of the world frame is, against 40 digits and against triangles on paper."""

import math

import mpmath
import numpy as np
import pytest

from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.world.geodesy import GeoOrigin, geographic

A_M = mpmath.mpf(6378137)
FLATTENING = 1 / mpmath.mpf("298.257223563")  # WGS 84: NIMA TR8350.2
E2 = FLATTENING * (2 - FLATTENING)


def origin(latitude_deg: float = 0.0, longitude_deg: float = 0.0) -> GeoOrigin:
    return GeoOrigin(latitude_deg=latitude_deg, longitude_deg=longitude_deg)


def by_mpmath(latitude_deg, longitude_deg, xyz_m):
    """Latitude and longitude in radians: along the east, north and up vectors, then the latitude by fixed point."""
    lat, lon = (mpmath.radians(mpmath.mpf(value)) for value in (latitude_deg, longitude_deg))
    sin, cos = mpmath.sin, mpmath.cos
    normal_m = A_M / mpmath.sqrt(1 - E2 * sin(lat) ** 2)
    place = mpmath.matrix([cos(lat) * cos(lon), cos(lat) * sin(lon), (1 - E2) * sin(lat)]) * normal_m
    east = mpmath.matrix([-sin(lon), cos(lon), 0])
    north = mpmath.matrix([-sin(lat) * cos(lon), -sin(lat) * sin(lon), cos(lat)])
    up = mpmath.matrix([cos(lat) * cos(lon), cos(lat) * sin(lon), sin(lat)])
    for step_m, direction in zip(xyz_m, (east, north, up), strict=True):
        place += mpmath.mpf(step_m) * direction
    x, y, z = place
    away_m = mpmath.hypot(x, y)
    found = mpmath.mpf(0)
    for _ in range(40):
        found = mpmath.atan2(z + E2 * A_M * sin(found) / mpmath.sqrt(1 - E2 * sin(found) ** 2), away_m)
    return found, mpmath.atan2(y, x)


@pytest.mark.slow
@pytest.mark.parametrize("away_m", [0, 1, 1e3, 1e5, 5e6, 1e7, COORDINATE_MAX_M])
def test_right_to_a_millimetre_at_any_distance(away_m):
    rng = np.random.default_rng(int(away_m))
    for _ in range(25):
        place = rng.uniform((-89, -180), (89, 180))
        bearing = rng.uniform(0, 2 * np.pi)
        xyz_m = np.array([away_m * math.cos(bearing), away_m * math.sin(bearing), rng.uniform(-500, 9000)])
        latitude_deg, longitude_deg = geographic(origin(*place), xyz_m).tolist()
        with mpmath.workdps(40):
            latitude, longitude = by_mpmath(*place, xyz_m)
            north_m = (mpmath.radians(mpmath.mpf(latitude_deg)) - latitude) * A_M
            turned = mpmath.radians(mpmath.mpf(longitude_deg)) - longitude
            east_m = 2 * mpmath.sin(turned / 2) * A_M * mpmath.cos(latitude)
        assert abs(north_m) < 1e-6
        assert abs(east_m) < 1e-6


def test_triangles_on_paper():
    """Along the equator's plane the ellipsoid is a circle: the longitude is that of a right triangle."""
    for east_m in (1.0, 111_319.4908, 5e6, -1e7):
        latitude, longitude = geographic(origin(0, 10), (east_m, 0.0, 0.0))
        assert latitude == pytest.approx(0, abs=1e-12)
        assert longitude == pytest.approx(10 + math.degrees(math.atan(east_m / 6378137)), abs=1e-12)
    assert geographic(origin(48.5, 9.25), (0.0, 0.0, 250.0)) == pytest.approx([48.5, 9.25], abs=1e-12)


def test_across_the_date_line_and_a_pole():
    """East of 179.999° comes -179.999°; north over the pole the vehicle comes down on the other side of the Earth."""
    assert geographic(origin(0, 179.999), (222.639, 0, 0))[1] == pytest.approx(-179.999, abs=1e-6)
    latitude, longitude = geographic(origin(89, 0), (0, 200_000, 0))
    assert 89 < latitude < 90
    assert abs(longitude) == pytest.approx(180)


def test_many_points_are_as_one_by_one_and_all_finite():
    points = np.random.default_rng(5).uniform(-COORDINATE_MAX_M, COORDINATE_MAX_M, (2000, 3))
    points[:1000] /= 16  # some of them inside the Earth
    found = geographic(origin(-33.9, 18.4), points)
    assert found.shape == (2000, 2)
    assert (abs(found) <= (90, 180)).all()
    for i in (0, 1, 999, 1999):
        assert (found[i] == geographic(origin(-33.9, 18.4), points[i])).all()
