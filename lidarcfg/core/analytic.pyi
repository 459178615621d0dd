from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.placement.analytic import Sheaf, Sums
from lidarcfg.placement.boundaries import Bounds, Crossings, Flips, Lattice

Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]
Labels = NDArray[np.int32]
Words = NDArray[np.uint64]
Vector = Array | Sequence[float]
Node = Counts | Sequence[int]

LINES_PER_EDGE: int
DIRECTION_BINS: int

def cross_cones(across: Vector, cone: Array, low: float, high: float) -> tuple[Array, Array]:
    """Where the line at (u, v) crosses cones (6 + beams) between low and high, ascending; and |n·e| there."""

def sweep_lines(sheaf: Sheaf, gap: Counts, rows: Array, flips: Flips, sums: Sums) -> None:
    """Add what the lines see of subspaces whose beam gaps are `gap` (n, lidars); rows: cone_rows."""

def find_candidates(
    lattice: Lattice, lines: tuple[int, int], bounds: Bounds, surfaces: Crossings
) -> tuple[Counts, Array, Array]:
    """The fields of Crossings where lines [begin, end) may leave or enter what a LiDAR sees; surfaces: of all lines."""

def find_middles(lattice: Lattice, lines: tuple[int, int], crossed: Crossings) -> Array:
    """(C + lines, 3) the midpoints of what lies between crossings, and the walls, of lines [begin, end)."""

def find_flips(crossed: Crossings, states: Flags, start: Flags) -> tuple[Counts, Array, Array]:
    """The fields of Crossings where states (C + L,) of `find_middles` change; start (L,) gets the first ones."""

def find_solid_flips(
    lattice: Lattice, surfaces: Crossings, part: Counts, parts: int, start: Flags
) -> tuple[Counts, Array, Array]:
    """The fields of Crossings where lines enter the first of all closed parts, or leave the last; part (C,).

    Writes whether each line (L,) starts outside.
    """

def cross_triangles(lattice: Lattice, triangles: Array) -> Array:
    """(N, 4) line, place, |n·e|, triangle: where lines pass through triangles (T, 3, 3)."""

def cross_rounds(lattice: Lattice, rounds: Array) -> Array:
    """(N, 4) the same of spheres and upright cylinders (R, 5): centre or base, radius, height (NaN: a sphere)."""

def detected_positions(
    labels: Labels, size: tuple[int, int, int], threshold: int, layers: int, misses: int, held: Flags
) -> tuple[Counts, Counts]:
    """At how many places (mx, my) a box of cuboids touches more than `threshold` subspaces; how many places there are.

    labels (nx, ny, nz), −1 where excluded; the box's lowest layer is one of the first `layers`. Ends after so many
    misses. held (n,) is set for subspaces that a box lies in, if it is not empty.
    """

def detected_boxes(
    labels: Labels, low: Vector, edge: Vector, boxes: Array, size: Vector, threshold: int
) -> tuple[int, int]:
    """How many boxes (n, 4: centre x, y, bottom, heading) touch more than `threshold` subspaces; how many are free."""

def find_ends(label: Labels) -> Words:
    """(nx, ny, words) a bit for each cuboid, in columns along z: set where the next one is in another subspace."""

def largest_sphere(
    label: Labels, ends: Words, half: Vector, number: int, low: Node, high: Node
) -> tuple[float, tuple[int, int, int]]:
    """The square of the radius, and the centre, of the largest sphere in a subspace (−1: in any) from low to high."""

def clearance(label: Labels, half: Vector, node: Node) -> float:
    """The squared distance of a node from the nearest face; 0 on one."""
