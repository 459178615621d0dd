"""Labels in 50 digits: what every beam of a LiDAR is to every point, and how near to its cone the point lies.

The sines are first computed in NumPy's longest float. Its rounding stays below SCREEN (a dozen roundings of at most
half its eps each); only what lies nearer to a cone than that is computed anew in 50 digits. Where that float is a
double, more is computed anew, and the answer is the same.
"""

from dataclasses import dataclass

import numpy as np
from mpmath.ctx_mp import MPContext

from lidarcfg.vsr.cones import Lidar, lidar
from lidarcfg.vsr.region import Region

MP = MPContext()
MP.dps = 50
BAND = 8 * 2.0**-52  # in the sine, absolute: no label is wrong farther than this from a cone
SCREEN = 16 * float(np.finfo(np.longdouble).eps)
ULP = 2.0**-52
TURN = 2 * np.pi

# Angles that have gone wrong elsewhere: tiny, gimbal lock, upside down, a turn and its neighbours, many turns.
ANGLES = (
    0.0, 1e-300, -1e-300, 1e-9, np.pi / 2, -np.pi / 2, np.nextafter(np.pi / 2, 4), np.pi, -np.pi,
    TURN, np.nextafter(TURN, 0), np.nextafter(TURN, 7), 1e6, -1e6,
)  # fmt: skip
FANS = (
    tuple(np.arange(-15.0, 16.0, 2.0)),  # VLP-16
    (-90.0, -89.999999999, -60.0, -30.0, -1e-9, 0.0, 1e-9, 30.0, 30.000000001, 60.0, 89.999999999, 90.0),
    (-25.0, -15.639, -11.31, -8.843, -7.254, -5.333, -4.0, -1.333, -0.667, 0.0, 0.333, 1.667, 3.333, 7.0, 15.0),
)

PLACES = {  # of a sensor, in and around the region from (0, 0, 0) to (6, 4, 2) with cuboids of (1, 0.5, 0.25) m
    "on a centre": (2.5, 1.25, 0.625),
    "1e-12 beside it": (2.5 + 1e-12, 1.25 - 1e-12, 0.625),
    "on a wall": (0.0, 1.0, 0.5),
    "1e-12 beside it, outside": (-1e-12, 1.0, 0.5),
    "on a corner": (6.0, 4.0, 2.0),
    "far outside": (-3e6, 1e7, 2e5),
}


@dataclass(frozen=True)
class Exact:
    """A LiDAR in 50 digits, from the numbers that its file gives."""

    position: list
    axis: list
    sine: list  # ascending

    @classmethod
    def of(cls, position_m, rpy_rad, elevation_deg):
        (cr, sr), (cp, sp), (cy, sy) = [(MP.cos(MP.mpf(float(a))), MP.sin(MP.mpf(float(a)))) for a in rpy_rad]
        axis = [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr]
        sine = sorted(MP.sin(MP.mpf(float(e)) * MP.pi / 180) for e in elevation_deg)
        return cls([MP.mpf(float(t)) for t in position_m], axis, sine)

    def above(self, point, beam):
        """By how much the sine of a point's elevation exceeds a beam's; +inf on the apex."""
        d = [MP.mpf(float(x)) - t for x, t in zip(point, self.position, strict=True)]
        distance = MP.sqrt(sum(x * x for x in d))
        return (
            sum(x * a for x, a in zip(d, self.axis, strict=True)) / distance - self.sine[beam] if distance else MP.inf
        )

    def long(self, name):
        """A field in NumPy's longest float."""
        return np.array([np.longdouble(MP.nstr(x, 40)) for x in getattr(self, name)])


@dataclass
class Tally:
    """What came of a comparison with the truth; worst: the farthest from a cone that a label was wrong, in 2⁻⁵²."""

    pairs: int = 0
    near: int = 0  # within 1e-15
    computed: int = 0  # in 50 digits
    wrong_inside: int = 0
    wrong_outside: int = 0
    worst: float = 0.0

    def add(self, exact: Exact, points, digit) -> None:
        """Compare the digits (N,) of points (N, 3)."""
        d = np.asarray(points, np.longdouble) - exact.long("position")
        distance = np.sqrt((d * d).sum(axis=1))
        with np.errstate(invalid="ignore"):
            sine = np.where(distance > 0, (d * exact.long("axis")).sum(axis=1) / distance, np.inf)
        gap = sine[:, None] - exact.long("sine")
        claimed = np.arange(len(exact.sine)) < digit[:, None]
        distance_to_cone = np.abs(gap)
        wrong = claimed != (gap >= 0)
        for n, beam in np.argwhere(distance_to_cone <= SCREEN).tolist():
            above = exact.above(points[n], beam)
            wrong[n, beam] = claimed[n, beam] != (above >= 0)
            distance_to_cone[n, beam] = abs(above)
            self.computed += 1
        self.pairs += gap.size
        self.near += int((distance_to_cone <= 1e-15).sum())
        self.wrong_inside += int((wrong & (distance_to_cone <= BAND)).sum())
        self.wrong_outside += int((wrong & (distance_to_cone > BAND)).sum())
        if wrong.any():
            self.worst = max(self.worst, float(distance_to_cone[wrong].max()) / ULP)


class Line(Region):
    """A region whose centres stand on a line along x, y or z, as near to each other as one likes."""

    def __init__(self, points, along) -> None:
        shape = [1, 1, 1]
        shape[along] = len(points)
        super().__init__(points.min(axis=0), points.max(axis=0) + 1.0, np.ones(shape, bool))
        object.__setattr__(self, "points", (points, along))

    def centres(self):
        """As given."""
        points, along = self.points
        x, y, z = (points[:, axis] if axis == along else points[:1, axis] for axis in range(3))
        return x.copy(), y.copy(), z.copy()


def points_of(region):
    return np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1).reshape(-1, 3)


def angles(rng):
    """Roll, pitch, yaw: any, or some that have gone wrong elsewhere."""
    return np.where(rng.random(3) < 0.5, rng.choice(ANGLES, 3), rng.uniform(-np.pi, np.pi, 3))


def sensor(position_m, rpy_rad, elevation_deg) -> tuple[Lidar, Exact]:
    """A LiDAR as the project has it, and exactly."""
    sine = np.sort(np.sin(np.radians(np.array(elevation_deg, np.float64))))
    return lidar(position_m, rpy_rad, sine), Exact.of(position_m, rpy_rad, elevation_deg)


def along_a_cone(rng, count=64):
    """Neighbouring points on a line that cuts a beam's cone, most of them within 1e-15 of it.

    Returns the LiDAR, the LiDAR in 50 digits, points (count, 3) and the line's axis.
    """
    while True:
        fan = FANS[rng.integers(len(FANS))]
        rpy = angles(rng)
        beam = int(rng.integers(len(fan)))
        along = int(rng.integers(3))
        elevation = np.radians(fan[beam])
        azimuth = rng.uniform(0, TURN)
        distance = 10 ** rng.uniform(-1, 2.5)
        a = lidar((0, 0, 0), rpy, np.zeros(1)).axis
        side = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        side /= np.linalg.norm(side)
        round_ = np.cos(azimuth) * side + np.sin(azimuth) * np.cross(a, side)
        way = distance * (np.sin(elevation) * a + np.cos(elevation) * round_)
        point = rng.uniform(-1, 1, 3) * 10.0 ** rng.integers(-3, 2)
        known, exact = sensor(point - way, rpy, fan)
        t = exact.long("position")
        axis = exact.long("axis")
        sine = exact.long("sine")[beam]
        x = point.astype(np.longdouble)
        slope = np.longdouble(0)
        for _ in range(4):  # Newton along the line
            d = x - t
            r = np.sqrt((d * d).sum())
            s = (d * axis).sum() / r
            slope = (axis[along] - s * d[along] / r) / r
            if not abs(slope) > 1e-6 / distance:
                break
            x[along] -= (s - sine) / slope
        if not abs(slope) > 1e-6 / distance or not abs(x - point).max() < 0.1 * distance:
            continue
        middle = np.float64(x[along])
        step = max(int(1e-15 / (count // 2) / float(abs(slope)) / np.spacing(abs(middle))), 1)
        ladder = (np.arange(count) - count // 2) * step
        points = np.repeat(point[None], count, axis=0)
        points[:, along] = middle + ladder * np.spacing(abs(middle))
        if (np.diff(points[:, along]) > 0).all():
            return known, exact, points, along
