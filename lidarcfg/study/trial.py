"""A rig that is evaluated, cut into subspaces only where a term of the objective asks for them."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from lidarcfg.geometry import Array, rotations
from lidarcfg.returns.scanners import Poses
from lidarcfg.study.zones import Weights, weighted_vsr_m
from lidarcfg.vsr.cones import Lidar, placed
from lidarcfg.vsr.cones import poses as poses_of
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Links, Subspaces, segment
from lidarcfg.vsr.visibility import Visibility


class Trial:
    """A rig that is evaluated: its LiDARs, and its subspaces once a term asks for them."""

    def __init__(
        self, region: Region, lidars: Sequence[Lidar], visibility: Visibility | None, poses: Array | None = None
    ) -> None:
        """LiDARs where they are, or at poses (lidars, 6): x, y, z, roll, pitch, yaw."""
        self.region = region
        self.visibility = visibility
        self.kept = tuple(range(len(lidars)))  # the numbers of its LiDARs in the whole rig
        self.is_cut = False  # into subspaces
        self.weighted_vsr_m = np.empty(0)  # of its subspaces; see forget
        self.first = np.empty(0, np.int64)  # cuboid of each
        self._given = lidars
        self._at = poses
        self._whole: Trial | None = None
        self._left: dict[tuple[int, ...], Trial] = {}

    @cached_property
    def lidars(self) -> Sequence[Lidar]:
        """The LiDARs at their poses."""
        if self._at is None:
            return self._given
        return [placed(one, row[:3], row[3:]) for row, one in zip(self._at, self._given, strict=True)]

    @cached_property
    def subspaces(self) -> Subspaces:
        """The subspaces into which the beams cut the region."""
        self.is_cut = True
        if self._whole:
            return self._whole._links.subspaces(self.kept)
        return segment(self.region, self.lidars, self.visibility)

    @cached_property
    def poses(self) -> Poses:
        """Where its LiDARs are."""
        if self._at is None:
            return poses_of(self.lidars)
        return Poses(rotations(self._at[:, 3:]), np.ascontiguousarray(self._at[:, :3]))

    def forget(self, weight: Weights | None) -> None:
        """Drop its subspaces, which are large, but for their weighted VSR and the first cuboid of each."""
        found = self.__dict__.pop("subspaces", None)
        if found:
            self.weighted_vsr_m = weighted_vsr_m(found, weight)
            self.first = found.first

    @cached_property
    def _links(self) -> Links:
        return Links(self.region, self.lidars, self.visibility)

    def left(self, kept: tuple[int, ...]) -> "Trial":
        """The trial of the same rig with only some of its LiDARs."""
        if kept not in self._left:
            some = list(kept)
            at = None if self._at is None else self._at[some]
            one = Trial(self.region, [self._given[i] for i in some], self.visibility, at)
            one.kept = kept
            one._whole = self
            self._left[kept] = one
        return self._left[kept]
