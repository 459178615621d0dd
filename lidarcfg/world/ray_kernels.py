"""Rays that start near each other and point nearly the same way, as a packet whose loops vectorise."""

# mypy: disallow-untyped-decorators=False, disallow-untyped-defs=False, disallow-untyped-calls=False
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.jit import inner
from lidarcfg.world.bvh import DEPTH_MAX
from lidarcfg.world.shapes import FAST

SIZE = 16  # rays in a packet
FACES = 32  # values of `facing`
# Rows of a packet: origin, direction (its largest component last), shear; range and slot of the nearest hit; scratch.
OX, OY, OZ, DX, DY, DZ, SX, SY, SZ, RANGE, SLOT, INSIDE = range(0, 12 * SIZE, SIZE)
# Rows in float32: 1 / direction and range; the boxes of a node; of each 1 / direction the one nearest to zero; what to
# subtract from a node's boxes.
IX, IY, IZ, FAR, EDGES, LEAST, ORIGIN = range(0, 7 * SIZE, SIZE)
NONE = -2.0  # a slot; where something is hit, the shape's number in its tree
WIDER, PAD = np.float32(4e-7), np.float32(1e-9)  # of a box's distance, and m, by which boxes are larger for float32
FLATTEST = np.float32(1e-28)  # of a direction's component: 0 times 1 / that is 0, where 0 times inf is not a number


class Packet(NamedTuple):
    """Working memory of a thread."""

    rays: Array  # (12 SIZE,)
    slabs: NDArray[np.float32]  # (7 SIZE,)
    starts: Array  # (3, SIZE) origins and directions that are gathered for it
    ways: Array
    codes: NDArray[np.int32]  # (DEPTH_MAX,) subtrees to look at
    enter: Array  # (DEPTH_MAX,) from where on
    alone_codes: NDArray[np.int32]  # the same for a ray alone
    alone_enter: Array
    instances: NDArray[np.int32]  # 1 + as many as there may be: how many moving objects the packet may hit, and which


def new_packet(instances: int) -> Packet:
    """Working memory for as many moving objects."""
    return Packet(
        np.zeros(12 * SIZE),
        np.zeros(7 * SIZE, np.float32),
        np.zeros((3, SIZE)),
        np.zeros((3, SIZE)),
        np.zeros(DEPTH_MAX, np.int32),
        np.zeros(DEPTH_MAX),
        np.zeros(DEPTH_MAX, np.int32),
        np.zeros(DEPTH_MAX),
        np.zeros(1 + instances, np.int32),
    )


made_packet = inner(makes_arrays=True)(new_packet)  # for loops that are given none


@inner()
def facing(dx, dy, dz):
    """The largest component of a direction and its octant as one number, which is the same for a packet's rays."""
    x, y, z = abs(dx), abs(dy), abs(dz)
    largest = 2 if z >= x and z >= y else 1 if y >= x else 0
    return largest + 4 * (dx < 0) + 8 * (dy < 0) + 16 * (dz < 0)


@inner()
def alike(directions, first, count):
    """How many rays from `first` on, of (3, count), can be one packet; and what they face."""
    face = facing(directions[0, first], directions[1, first], directions[2, first])
    end = first + 1
    while end < min(first + SIZE, count) and face == facing(directions[0, end], directions[1, end], directions[2, end]):
        end += 1
    return end - first, face


@inner()
def row(face, axis):
    """Where a packet's rows have an axis: 0, SIZE or 2 SIZE further."""
    return (axis - (face & 3) - 1) % 3 * SIZE


@inner(fastmath=FAST, error_model="numpy")
def load(rays, slabs, origins, directions, first, count, face):
    """Fill a packet with rays `first` to `first` + count of (3, N); the last one fills its rest."""
    for axis in range(3):
        start, way, steep = OX + row(face, axis), DX + row(face, axis), IX + axis * SIZE
        low, high = origins[axis, first], origins[axis, first]
        for n in range(count):
            rays[start + n], rays[way + n] = origins[axis, first + n], directions[axis, first + n]
            low, high = min(low, rays[start + n]), max(high, rays[start + n])
        for n in range(count, SIZE):
            rays[start + n], rays[way + n] = rays[start + count - 1], rays[way + count - 1]
        below, above = np.float32(low), np.float32(high)
        slabs[ORIGIN + 3 + axis] = slabs[ORIGIN + 9 + axis] = below - abs(below) * WIDER
        slabs[ORIGIN + axis] = slabs[ORIGIN + 6 + axis] = above + abs(above) * WIDER
        for n in range(SIZE):
            slabs[steep + n] = 1 / max(abs(np.float32(rays[way + n])), FLATTEST)
        least = slabs[steep]
        for n in range(SIZE):
            least = min(least, slabs[steep + n])
        if face & (4 << axis):
            least = -least
            for n in range(SIZE):
                slabs[steep + n] = -slabs[steep + n]
        slabs[LEAST + axis] = least
    for n in range(SIZE):
        rays[SLOT + n] = NONE


@inner(fastmath=FAST, error_model="numpy")
def shear(rays):
    """What turns each ray of a packet into an axis; only rays that come to a leaf need it."""
    for n in range(SIZE):
        rays[SX + n] = rays[DX + n] / rays[DZ + n]
        rays[SY + n] = rays[DY + n] / rays[DZ + n]
        rays[SZ + n] = 1 / rays[DZ + n]


@inner(makes_arrays=True)
def ray_of(rays, n, face):
    """Origin and direction of ray n of a packet, in the order of the axes."""
    k = face & 3
    if k == 2:
        return rays[OX + n], rays[OY + n], rays[OZ + n], rays[DX + n], rays[DY + n], rays[DZ + n]
    if k == 1:
        return rays[OY + n], rays[OZ + n], rays[OX + n], rays[DY + n], rays[DZ + n], rays[DX + n]
    return rays[OZ + n], rays[OX + n], rays[OY + n], rays[DZ + n], rays[DX + n], rays[DY + n]
