"""What a rig has to withstand: LiDARs that fail, and mounts that are not quite where they should be.

With `lost` LiDARs gone, a rig is as good as the worst rig that may be left. With mounting errors it is as good as one
of the quantile of some draws: in each, every LiDAR is off by a normally distributed error along x, y and z, and turned
by another about its own x, y and z axes. The draws are the same for every trial, every search and every seed.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from lidarcfg.config.models import Model, validation_error, with_defaults
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, angles, turned
from lidarcfg.sensors.rig import Mount

CASES_MAX = 1000  # rigs that may be left, and draws
SAMPLES = 16  # unless the study says otherwise
QUANTILE = 0.9  # unless the study says otherwise
SEED = 20180913  # of the draws; combined with the LiDAR's number
T = TypeVar("T")
SIGMAS = ("position_sigma_m", "angle_sigma_deg")


class Robust(Model):
    """What a rig has to withstand. The larger of the costs with failed LiDARs and with mounting errors counts."""

    lost: Annotated[int, Field(ge=1)] | None = None  # LiDARs that fail at the same time
    position_sigma_m: Annotated[float, Field(ge=0, le=10)] | None = None  # of every coordinate of every LiDAR
    angle_sigma_deg: Annotated[float, Field(ge=0, le=180)] | None = None  # about every axis of every LiDAR
    samples: Annotated[int, Field(ge=1, le=CASES_MAX)] | None = None  # draws of all LiDARs' errors
    quantile: Annotated[float, Field(gt=0, le=1)] | None = None  # of their costs: the ⌈quantile · samples⌉-th smallest

    @model_validator(mode="before")
    @classmethod
    def _defaults(cls, values: Any) -> Any:
        if isinstance(values, dict) and any(values.get(key) is not None for key in SIGMAS):
            return with_defaults(values, {"samples": SAMPLES, "quantile": QUANTILE})
        return values

    @model_validator(mode="after")
    def _check(self) -> "Robust":
        sigmas = [getattr(self, key) for key in SIGMAS]
        if sigmas == [None, None]:
            for key in ("samples", "quantile"):
                if getattr(self, key) is not None:
                    raise validation_error(f"needs errors to draw; give {' or '.join(SIGMAS)}", key)
            if self.lost is None:
                raise validation_error(f"asks for nothing; allowed: lost, {', '.join(SIGMAS)}")
        elif not any(sigmas):
            key = SIGMAS[0] if self.position_sigma_m is not None else SIGMAS[1]
            raise validation_error("all errors are 0; allowed: at least one of the sigmas above 0", key)
        return self

    @property
    def drawn(self) -> int:
        """The number of draws of mounting errors; 0 if none are asked for."""
        return self.samples or 0

    @property
    def spare(self) -> int:
        """The number of draws that may be worse than the quantile."""
        return self.drawn - max(math.ceil((self.quantile or 1.0) * self.drawn - 1e-9), 1)

    def quantile_of(self, draws: Sequence[T], goodness: Callable[[T], float]) -> T:
        """The one among the results of all draws that is as good as the quantile asks for."""
        return sorted(draws, key=lambda one: -goodness(one))[self.drawn - 1 - self.spare]

    def check(self, lidars: int) -> None:
        """Raises ConfigError unless fewer LiDARs are to be lost than there are."""
        if self.lost is None:
            return
        if self.lost >= lidars:
            which = "the only LiDAR" if lidars == 1 else f"{self.lost} of {lidars} LiDARs"
            allowed = "studies of two LiDARs or more" if lidars == 1 else f"1 to {lidars - 1}"
            raise ConfigError(f"losing {which} leaves none; allowed: {allowed}")
        if (count := math.comb(lidars, self.lost)) > CASES_MAX:
            what = f"{self.lost} of {lidars} LiDARs can fail in {count:,} ways"
            raise ConfigError(f"{what}; allowed: at most {CASES_MAX:,}")

    def kept(self, lidars: int) -> NDArray[np.bool_]:
        """(cases, lidars) the LiDARs left in each case of failure; no cases if none is lost. Raises as `check` does."""
        self.check(lidars)
        ways = list(combinations(range(lidars), self.lost)) if self.lost else []
        out = np.ones((len(ways), lidars), bool)
        for row, lost in zip(out, ways, strict=True):
            row[list(lost)] = False
        return out

    def errors(self, lidars: int) -> Array:
        """(samples, lidars, 6) the draws: metres along x, y and z, radians about the LiDAR's own x, y and z."""
        each = [np.random.default_rng((SEED, number)).standard_normal((self.drawn, 6)) for number in range(lidars)]
        sigma = np.repeat([self.position_sigma_m or 0.0, math.radians(self.angle_sigma_deg or 0.0)], 3)
        out: Array = np.stack(each, axis=1) * sigma
        return out


def mounted(poses: Array, errors: Array) -> Array:
    """(…, lidars, 6) poses (…, lidars, 6) with mounting errors (lidars, 6) added.

    R is that of the pose times that of the error, each Rz(yaw) Ry(pitch) Rx(roll).
    """
    out = poses + errors
    if errors[:, 3:].any():
        out[..., 3:] = angles(turned(poses[..., 3:], errors[:, 3:]))
    else:
        out[..., 3:] = poses[..., 3:]
    return out


def misplaced(mounts: Sequence[Mount], errors: Array) -> tuple[Mount, ...]:
    """The mounts with errors (mounts, 6) added to their poses: metres and radians."""
    poses = np.array([(*mount.position_m, *mount.rpy_rad) for mount in mounts])
    off = mounted(poses, errors).tolist()
    return tuple(
        replace(mount, position_m=tuple(row[:3]), rpy_rad=tuple(row[3:]))
        for mount, row in zip(mounts, off, strict=True)
    )


def off_by_draws(robust: Robust | None, mounts: Sequence[Mount]) -> Iterator[tuple[Mount, ...]]:
    """The mounts with each draw of mounting errors, if any are asked for."""
    if robust and robust.drawn:
        for errors in robust.errors(len(mounts)):
            yield misplaced(mounts, errors)
