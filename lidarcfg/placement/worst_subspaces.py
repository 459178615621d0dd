"""The cost of whole rigs, evaluated in full, without flooding subspaces that cannot be the worst."""

from collections.abc import Sequence

from lidarcfg.core import placement as core
from lidarcfg.placement.cones import Lidar, cone_rows
from lidarcfg.placement.sight import UNLIMITED_SIGHT, Sight


def max_vsr(
    grid: core.Grid,
    lidars: Sequence[Lidar],
    workspace: core.WorstSubspaces | None = None,
    sight: Sight = UNLIMITED_SIGHT,
) -> float:
    """The largest V / S, in metres. `workspace`: the grid's, to be used again."""
    return (workspace or core.WorstSubspaces(grid)).max_vsr(cone_rows(lidars), sight)
