"""What combinations of sensors learn from each other: the best rigs of one are starts for a local search in another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.search.combinations import Combination

CHANGES_MAX = 2  # sensors exchanged, added and removed
DRAWS = 4  # of the pose of a sensor that is new
TRANSFERRED_MAX = 40


@dataclass(frozen=True)
class Example:
    """A rig of some combination, in its unit cube."""

    combination: Combination
    x: Array  # (free coordinates,)
    objective: float


@dataclass(frozen=True, eq=False)
class MovingSensor:
    """A sensor of a combination, or a mirrored pair, and its free coordinates."""

    group: int
    model: str | None
    columns: NDArray[np.int64]


def transferred(combination: Combination, examples: Sequence[Example], rng: np.random.Generator) -> Array:
    """(n, free coordinates) points of a combination's unit cube, made from examples, those of the best one first.

    The rig of another combination fits if at most CHANGES_MAX sensors are exchanged, added or removed. Sensors of the
    same group and model keep their poses, then those of the same group; a sensor that is new stands anywhere within its
    bounds.
    """
    sensors = _sensors(combination)
    found = []
    for example in sorted(examples, key=lambda example: example.objective):
        for _ in range(DRAWS):
            x, is_new = _fitted(sensors, example, rng)
            if x is not None:
                found.append(x)
            if x is None or not is_new:
                break
    return np.array(found[:TRANSFERRED_MAX]).reshape(-1, combination.study.space.free.sum())


def _sensors(combination: Combination) -> list[MovingSensor]:
    study = combination.study
    each = zip(combination.groups, study.slots, strict=True)
    return [
        MovingSensor(group, slot.model, np.flatnonzero(study.space.groups == i))
        for i, (group, slot) in enumerate(each)
        if np.isnan(study.space.mirror[i])
    ]


def _fitted(sensors: Sequence[MovingSensor], example: Example, rng: np.random.Generator) -> tuple[Array | None, bool]:
    """The example's poses for these sensors, and whether one was drawn; None if too many sensors differ."""
    left = _sensors(example.combination)
    left = [left[i] for i in rng.permutation(len(left))]  # which of several is removed
    taken: dict[int, MovingSensor] = {}
    for same in (True, False):  # model and group, then group alone
        for i, sensor in enumerate(sensors):
            if i not in taken:
                fits = [one for one in left if one.group == sensor.group and (one.model == sensor.model or not same)]
                if fits:
                    taken[i] = fits[0]
                    left.remove(fits[0])
    exchanged = sum(one.model != sensors[i].model for i, one in taken.items())
    new = len(sensors) - len(taken)
    if exchanged + new + len(left) > CHANGES_MAX:
        return None, False
    x = rng.random(sum(len(sensor.columns) for sensor in sensors))
    for i, one in taken.items():
        x[sensors[i].columns] = example.x[one.columns]
    return x, new > 0
