"""The volume-to-surface ratio (VSR) of subspaces, and the largest: the paper's cost of a rig (III-D)."""

from collections.abc import Sequence

from lidarcfg.geometry import Array
from lidarcfg.vsr.cones import Lidar
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Subspaces, segment
from lidarcfg.vsr.visibility import Visibility


def max_vsr(region: Region, lidars: Sequence[Lidar], visibility: Visibility | None = None) -> float:
    """The paper's cost of a rig: the largest VSR of its subspaces, in metres (eq. 10)."""
    subspaces = segment(region, lidars, visibility)
    return float(vsr_m(subspaces).max())


def vsr_m(subspaces: Subspaces) -> Array:
    """(n,) volume-to-surface ratio, a length (paper, eq. 7)."""
    return volume_m3(subspaces) / surface_m2(subspaces)


def volume_m3(subspaces: Subspaces) -> Array:
    """(n,) the cuboids' volume (paper, eq. 8)."""
    ex, ey, ez = subspaces.region.cuboid_m
    volume: Array = subspaces.cuboids * (ex * ey * ez)
    return volume


def surface_m2(subspaces: Subspaces) -> Array:
    """(n,) the cuboids' outer faces: S = 2 Σ_axis (n − internal faces) · face area (paper, algorithm 1).

    Faces against another subspace, an excluded cuboid or the region's wall all count. (The printed algorithm
    skips the last cuboid and counts along one axis; this is its intent.)
    """
    ex, ey, ez = subspaces.region.cuboid_m
    outer = subspaces.cuboids[:, None] - subspaces.internal
    surface: Array = 2.0 * (outer[:, 0] * (ey * ez) + outer[:, 1] * (ex * ez) + outer[:, 2] * (ex * ey))
    return surface
