"""Make the meshes of data/scenes/depot.yaml: a semi-trailer, a forklift with its driver, and a loaded pallet.

Usage: .venv/bin/python tools/make_depot.py [FOLDER]      (needs the extra `vehicles`)

Each is one closed mesh in metres, facing along x; the origin is on the ground under its middle. Sizes are those of a
13.6 m curtain-sider of 4 m, a counterbalance truck for 1.5 t, and a euro pallet, 1.2 m × 0.8 m.
"""

from pathlib import Path

from make_objects import head, limb
from make_vehicles import axle, both, box, save, wheel
from manifold3d import Manifold
from page import argument

FOLDER = Path(__file__).parent.parent / "data/scenes/meshes"
COARSE_M = 0.004


def trailer() -> Manifold:
    """A semi-trailer on its legs: 13.6 m × 2.55 m × 4.0 m, three axles behind."""
    solid = box([-6.8, -1.275, 1.15], [6.8, 1.275, 4.0]) + box([-6.7, -0.5, 0.85], [6.6, 0.5, 1.2])
    solid += box([-6.8, -1.2, 0.45], [-6.68, 1.2, 0.62]) + both(box([-6.8, 0.35, 0.5], [-6.68, 0.5, 0.95]))
    solid += both(box([3.9, 0.75, 0.0], [4.1, 0.9, 1.2]) + box([3.8, 0.68, 0.0], [4.2, 0.97, 0.06]))
    solid += both(box([-1.6, 1.2, 0.45], [3.4, 1.25, 0.95]) + box([-1.2, 0.4, 0.9], [-1.1, 1.24, 1.2]))
    for x in (-5.3, -3.99, -2.68):
        solid += axle(x, 0.5, 0.95, 0.08) + both(wheel(x, 1.05, 0.5, 0.36, 24))
    return solid


def forklift() -> Manifold:
    """A forklift, 3.3 m over its forks, 1.2 m × 2.1 m, with its driver."""
    body = box([-1.3, -0.55, 0.2], [-0.45, 0.55, 1.05]) + box([-0.5, -0.5, 0.18], [0.75, 0.5, 0.55])
    body += box([0.45, -0.45, 0.5], [0.75, 0.45, 1.0])
    guard = both(limb((-1.1, 0.48, 1.0, 0.035), (-0.85, 0.45, 2.05, 0.035)))
    guard += both(limb((0.7, 0.45, 0.95, 0.035), (0.35, 0.45, 2.05, 0.035))) + box(
        [-0.9, -0.48, 2.02], [0.4, 0.48, 2.1]
    )
    mast = both(box([0.85, 0.3, 0.1], [0.98, 0.4, 2.1])) + box([0.85, -0.4, 1.9], [0.98, 0.4, 2.0])
    mast += box([0.97, -0.5, 0.1], [1.03, 0.5, 0.6]) + both(box([1.0, 0.2, 0.1], [2.0, 0.32, 0.14]))
    mast += box([0.7, -0.35, 0.2], [0.9, 0.35, 0.3])
    wheels = both(wheel(0.5, 0.5, 0.3, 0.2, 24) + wheel(-0.9, 0.48, 0.25, 0.18, 24)) + axle(0.5, 0.3, 0.4)
    seat = both(limb((-0.45, 0.09, 1.1, 0.1), (0.0, 0.11, 1.08, 0.07), (0.1, 0.11, 0.62, 0.05)))
    driver = (
        seat
        + limb((-0.45, 0.0, 1.1, 0.13), (-0.42, 0.0, 1.5, 0.14))
        + limb((-0.42, 0, 1.5, 0.06), (-0.4, 0, 1.65, 0.06))
    )
    driver += both(limb((-0.42, 0.2, 1.5, 0.055), (-0.25, 0.26, 1.28, 0.045), (0.2, 0.12, 1.2, 0.04)))
    wheel_post = limb((0.5, 0.0, 0.95, 0.03), (0.25, 0.0, 1.2, 0.03))
    return body + guard + mast + wheels + driver + wheel_post + head(-0.39, 1.78, 0.23)


def pallet() -> Manifold:
    """A pallet with boxes on it, 1.4 m high."""
    solid = box([-0.6, -0.4, 0.1], [0.6, 0.4, 0.144]) + box([-0.57, -0.37, 0.14], [0.57, 0.37, 0.95])
    solid += box([-0.5, -0.35, 0.9], [0.1, 0.35, 1.4])
    for y in (-0.35, 0.0, 0.35):
        solid += box([-0.6, y - 0.05, 0.0], [0.6, y + 0.05, 0.022])
        for x in (-0.53, 0.0, 0.53):
            solid += box([x - 0.07, y - 0.05, 0.0], [x + 0.07, y + 0.05, 0.11])
    return solid


MESHES = {"trailer": trailer, "forklift": forklift, "pallet": pallet}


def main(folder: Path) -> None:
    """Make all of them."""
    for name, make in MESHES.items():
        path = folder / f"{name}.ply"
        solid = make().simplify(COARSE_M)
        low_x, low_y, low_z, high_x, high_y, _ = solid.bounding_box()
        solid = solid.translate([-(low_x + high_x) / 2, -(low_y + high_y) / 2, -low_z])
        print(f"{path}: {save(solid, path):,} triangles, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(argument(__doc__, Path, FOLDER))
