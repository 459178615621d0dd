"""A rig that a search tries: sensors that are known, at poses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from lidarcfg.geometry import Array
from lidarcfg.returns.known import RigAt
from lidarcfg.sensors.rig import Mount


@dataclass(frozen=True)
class TrialRig:
    """Sensors at poses (S, 6): x, y, z, roll, pitch, yaw."""

    poses: Array  # (S, 6)
    at: RigAt  # as their returns are kept
    still: Sequence[Mount]  # the sensors, wherever they are

    @cached_property
    def mounts(self) -> tuple[Mount, ...]:
        """The sensors at their poses."""
        return tuple(
            replace(mount, position_m=tuple(row[:3]), rpy_rad=tuple(row[3:]))
            for mount, row in zip(self.still, self.poses.tolist(), strict=True)
        )
