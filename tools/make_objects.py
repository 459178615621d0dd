"""Make the objects of data/objects/: a pedestrian, a child, a cyclist, a car, a dog, a post, and a tyre on the road.

Usage: .venv/bin/python tools/make_objects.py [FOLDER]      (needs the extra `vehicles`)

Each is one closed mesh in metres, facing along x; the origin is on the ground under its middle. Statures: an adult of
1.75 m, a child of five of 1.10 m, whose head is a fifth of it (Snyder and others, Anthropometry of Infants, Children
and Youths, 1977).
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from make_vehicles import along_x, along_z, axle, both, box, drum, save, wheel
from manifold3d import CrossSection, Manifold
from page import argument

FOLDER = Path(__file__).parent.parent / "data/objects"
FACETS = 12  # around a limb
COARSE_M = 0.004  # by which surfaces may move, beyond what vehicles allow
Knot = tuple[float, float, float, float]  # x, y, z, radius


def limb(*knots: Knot) -> Manifold:
    """Round limbs from knot to knot."""
    joints = [Manifold.sphere(r, FACETS).translate([x, y, z]) for x, y, z, r in knots]
    return sum((Manifold.batch_hull(pair) for pair in pairwise(joints)), Manifold())


def mirrored(knots: Sequence[Knot]) -> list[Knot]:
    """The same on the other side."""
    return [(x, -y, z, r) for x, y, z, r in knots]


def foot(x: float, y: float, length: float = 0.26) -> Manifold:
    """A shoe on the ground, its ankle over x, y."""
    sole = [(x - 0.25 * length, y, 0.045, 0.045), (x + 0.3 * length, y, 0.045, 0.05), (x + 0.6 * length, y, 0.02, 0.04)]
    return limb(*sole).trim_by_plane([0, 0, 1], 0.0)


def head(x: float, z: float, height: float) -> Manifold:
    """A head whose middle is at x, z."""
    return Manifold.sphere(1.0, 2 * FACETS).scale([0.42 * height, 0.33 * height, height / 2]).translate([x, 0, z])


def adult() -> Manifold:
    """Someone who walks."""
    left = [(0.0, 0.09, 0.90, 0.09), (0.13, 0.09, 0.49, 0.062), (0.20, 0.09, 0.09, 0.045)]
    right = [(0.0, -0.09, 0.90, 0.09), (0.0, -0.09, 0.48, 0.062), (-0.27, -0.09, 0.11, 0.045)]
    legs = limb(*left) + limb(*right) + foot(0.20, 0.09) + foot(-0.22, -0.09)
    trunk = [(0.0, 0.08, 0.95, 0.105), (0.01, 0.08, 1.12, 0.10), (0.0, 0.10, 1.32, 0.11), (0.0, 0.15, 1.42, 0.07)]
    body = Manifold.batch_hull([limb(*trunk), limb(*mirrored(trunk))])
    ahead = [(0.0, 0.20, 1.41, 0.06), (0.04, 0.25, 1.14, 0.045), (0.20, 0.23, 0.92, 0.04)]
    behind = [(0.0, -0.20, 1.41, 0.06), (-0.10, -0.25, 1.15, 0.045), (-0.14, -0.24, 0.87, 0.04)]
    neck = limb((0.0, 0.0, 1.44, 0.06), (0.02, 0.0, 1.56, 0.055))
    return legs + body + limb(*ahead) + limb(*behind) + neck + head(0.025, 1.635, 0.23)


def child() -> Manifold:
    """A child of five that stands."""
    leg = [(0.0, 0.06, 0.53, 0.068), (0.01, 0.06, 0.29, 0.048), (0.0, 0.06, 0.06, 0.035)]
    trunk = [(0.0, 0.05, 0.56, 0.075), (0.015, 0.05, 0.66, 0.08), (0.0, 0.07, 0.78, 0.075), (0.0, 0.10, 0.84, 0.05)]
    arm = [(0.0, 0.13, 0.83, 0.042), (0.0, 0.165, 0.66, 0.034), (0.04, 0.165, 0.50, 0.03)]
    neck = limb((0.0, 0.0, 0.86, 0.045), (0.01, 0.0, 0.93, 0.045))
    body = Manifold.batch_hull([limb(*trunk), limb(*mirrored(trunk))])
    return body + both(limb(*leg) + foot(0.0, 0.06, 0.17) + limb(*arm)) + neck + head(0.01, 0.99, 0.22)


def ring(x: float, radius: float, width: float) -> Manifold:
    """A wheel of a bicycle: tyre and rim, hub, and six thick spokes for its thin ones."""
    outer = Manifold.cylinder(width, radius, radius, 40)
    tyre = outer - Manifold.cylinder(3 * width, radius - width, radius - width, 40).translate([0, 0, -width])
    hub = Manifold.cylinder(2.4 * width, 0.03, 0.03, 12).translate([0, 0, -0.7 * width])
    spokes = Manifold.cube([2 * radius - width, 0.014, 0.014], True).translate([0, 0, width / 2])
    star = spokes + spokes.rotate([0, 0, 60]) + spokes.rotate([0, 0, 120])
    return (tyre + hub + star).translate([0, 0, -width / 2]).rotate([90, 0, 0]).translate([x, 0, radius])


def cyclist() -> Manifold:
    """Someone on a city bicycle."""
    bicycle = ring(-0.53, 0.34, 0.04) + ring(0.53, 0.34, 0.04)
    crank = (-0.08, 0.0, 0.29, 0.025)
    saddle = (-0.24, 0.0, 0.88, 0.02)
    bars = (0.36, 0.0, 0.98, 0.02)
    front, rear = (0.53, 0.0, 0.34, 0.018), (-0.53, 0.0, 0.34, 0.018)
    bicycle += limb(crank, saddle) + limb(crank, (0.38, 0.0, 0.72, 0.025)) + limb(crank, rear) + limb(front, bars)
    bicycle += limb((-0.2, 0.0, 0.74, 0.018), (0.38, 0.0, 0.78, 0.018)) + limb((-0.2, 0.0, 0.74, 0.015), rear)
    bicycle += limb((-0.36, 0.0, 0.93, 0.05), (-0.14, 0.0, 0.94, 0.03)) + limb(saddle, (-0.25, 0.0, 0.93, 0.03))
    bicycle += both(limb((0.36, 0.0, 0.98, 0.016), (0.38, 0.24, 1.03, 0.016), (0.28, 0.28, 1.03, 0.018)))
    bicycle += box([-0.095, -0.16, 0.275], [-0.065, 0.16, 0.305])
    low = [(-0.24, 0.085, 0.99, 0.10), (0.14, 0.09, 0.80, 0.065), (-0.05, 0.11, 0.22, 0.045), (0.08, 0.11, 0.15, 0.04)]
    high = [(-0.24, -0.085, 0.99, 0.1), (0.2, -0.1, 0.95, 0.065), (0.0, -0.11, 0.55, 0.045), (0.13, -0.11, 0.49, 0.04)]
    crouch = both(limb((-0.23, 0.07, 1.02, 0.11), (-0.16, 0.09, 1.2, 0.10), (-0.06, 0.14, 1.42, 0.075)))
    arm = [(-0.04, 0.19, 1.41, 0.055), (0.09, 0.27, 1.2, 0.042), (0.29, 0.275, 1.06, 0.04)]
    neck = limb((-0.05, 0.0, 1.45, 0.06), (0.0, 0.0, 1.55, 0.055))
    rider = limb(*low) + limb(*high) + Manifold.batch_hull([crouch]) + both(limb(*arm))
    return bicycle + rider + neck + head(0.02, 1.63, 0.24)


def car() -> Manifold:
    """A hatchback of 4.2 m × 1.8 m × 1.45 m."""
    hull = along_x(
        [
            # x, half width, bottom, top
            (-2.100, 0.64, 0.36, 0.90),
            (-2.070, 0.78, 0.28, 0.98),
            (-1.900, 0.87, 0.21, 1.02),
            (-1.300, 0.895, 0.18, 1.00),
            (0.300, 0.900, 0.17, 0.96),
            (1.000, 0.895, 0.18, 0.92),
            (1.600, 0.87, 0.20, 0.82),
            (1.980, 0.80, 0.24, 0.70),
            (2.080, 0.70, 0.30, 0.62),
            (2.100, 0.58, 0.35, 0.56),
        ],
        5.5,
        21,
    )
    cabin = [
        # z, rear, front, half width
        (0.80, -2.04, 1.30, 0.850),
        (0.98, -1.97, 1.00, 0.815),
        (1.20, -1.80, 0.60, 0.750),
        (1.36, -1.64, 0.30, 0.680),
        (1.42, -1.50, 0.12, 0.610),
        (1.45, -1.15, -0.20, 0.400),
    ]
    body = hull + along_z(cabin, 6.0)
    for x in (-1.28, 1.28):
        body -= drum(x, 0.32, 0.365, 0.60, 1.1)
        body += axle(x, 0.31, 0.75) + both(wheel(x, 0.78, 0.315, 0.205, 24))
    mirror = limb((0.62, 0.80, 0.98, 0.03), (0.60, 0.92, 1.02, 0.07))
    return body + both(mirror)


def tyre() -> Manifold:
    """A tyre of 205/55 R16 that lies flat: 0.632 m across, 0.205 m high, a rim of 0.406 m."""
    profile = [
        (0.203, 0.03), (0.22, 0.012), (0.26, 0.0), (0.295, 0.008), (0.316, 0.035),
        (0.316, 0.170), (0.295, 0.197), (0.26, 0.205), (0.22, 0.193), (0.203, 0.175),
        (0.215, 0.16), (0.29, 0.155), (0.29, 0.05), (0.215, 0.045),
    ]  # fmt: skip
    return Manifold.revolve(CrossSection([profile]), 48)


def dog() -> Manifold:
    """A dog of 0.6 m at the shoulder, as large as a German shepherd."""
    fore = [(0.27, 0.08, 0.44, 0.07), (0.25, 0.085, 0.24, 0.035), (0.27, 0.085, 0.03, 0.03)]
    hind = [(-0.29, 0.075, 0.42, 0.075), (-0.24, 0.085, 0.27, 0.045), (-0.36, 0.085, 0.16, 0.03)]
    hind.append((-0.33, 0.085, 0.03, 0.03))
    trunk = limb((0.24, 0.0, 0.47, 0.125), (0.0, 0.0, 0.46, 0.115), (-0.27, 0.0, 0.48, 0.10))
    neck = limb((0.29, 0.0, 0.51, 0.085), (0.42, 0.0, 0.68, 0.075))
    skull = limb((0.42, 0.0, 0.70, 0.085), (0.50, 0.0, 0.68, 0.06), (0.62, 0.0, 0.65, 0.035))
    ears = both(limb((0.40, 0.05, 0.76, 0.025), (0.39, 0.065, 0.83, 0.012)))
    tail = limb((-0.36, 0.0, 0.50, 0.035), (-0.50, 0.0, 0.40, 0.03), (-0.58, 0.0, 0.28, 0.02))
    legs = both(limb(*fore) + limb(*hind)).trim_by_plane([0, 0, 1], 0.0)
    return trunk + neck + skull + ears + tail + legs


def post() -> Manifold:
    """A bollard: a round post of 0.1 m, 1 m high."""
    return Manifold.cylinder(1.0, 0.05, 0.05, 32)


OBJECTS = {
    "pedestrian": adult,
    "child": child,
    "cyclist": cyclist,
    "car": car,
    "tyre": tyre,
    "dog": dog,
    "post": post,
}


def main(folder: Path) -> None:
    """Make all of them."""
    for name, make in OBJECTS.items():
        solid = make()
        path = folder / f"{name}.ply"
        low_x, low_y, low_z, high_x, high_y, _ = solid.bounding_box()
        solid = solid.simplify(COARSE_M).translate([-(low_x + high_x) / 2, -(low_y + high_y) / 2, -low_z])
        print(f"{path}: {save(solid, path):,} triangles, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(argument(__doc__, Path, FOLDER))
