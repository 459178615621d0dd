from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]
Labels = NDArray[np.int32]
Words = NDArray[np.uint64]
Vector = Array | Sequence[float]
Node = Counts | Sequence[int]

LINES_PER_EDGE: int
DIRECTION_BINS: int

class Sheaf(Protocol):
    """A grid as lines along one axis see it."""

    @property
    def axis(self) -> int: ...
    @property
    def label(self) -> NDArray[np.int32]: ...
    @property
    def within(self) -> Flags: ...
    @property
    def low(self) -> Array: ...
    @property
    def edge(self) -> Array: ...
    @property
    def cones(self) -> Array: ...

class Sums(Protocol):
    """What lines add up by subspace, to be written."""

    @property
    def volume(self) -> Array: ...
    @property
    def shadow(self) -> Array: ...
    @property
    def surface(self) -> Array: ...
    @property
    def parent(self) -> Counts: ...

class Lattice(Protocol):
    """The lines along one axis."""

    @property
    def axis(self) -> int: ...
    @property
    def low(self) -> Array: ...
    @property
    def edge(self) -> Array: ...
    @property
    def shape(self) -> tuple[int, int, int]: ...

class Bounds(Protocol):
    """Edges and quadrics that may bound what a LiDAR sees."""

    @property
    def foot(self) -> Array: ...
    @property
    def edges(self) -> Array: ...
    @property
    def quadrics(self) -> Array: ...
    @property
    def first(self) -> Counts: ...
    @property
    def item(self) -> Counts: ...

class Crossings(Protocol):
    """What lines cross, one line after the other."""

    @property
    def first(self) -> Counts: ...
    @property
    def at(self) -> Array: ...
    @property
    def weight(self) -> Array: ...

class Flips(Protocol):
    """Where states change along lines."""

    @property
    def start(self) -> Flags: ...
    @property
    def first(self) -> Counts: ...
    @property
    def at(self) -> Array: ...
    @property
    def weight(self) -> Array: ...

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
