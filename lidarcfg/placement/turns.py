"""Numbered work that threads share: each one takes the next number as soon as it is done with its last."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, TypeVar

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

Turns = NDArray[np.int64]  # (1,) the next number
T = TypeVar("T")
R = TypeVar("R")


def _take(_: Any, turns: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, context.get_constant(types.int64, 1), "monotonic")

    return types.int64(turns), generate


take: Any = intrinsic(_take)  # the next number, which no other thread has


def share(
    pool: Executor,
    rooms: Sequence[T],
    count: int,
    most: int,
    work: Callable[[Turns, int, T], R],
    on_begun: Callable[[int], None] | None = None,
) -> list[R]:
    """Have a thread in each room call work(turns, most, room), which takes turns until they reach `count`.

    This thread has the first room, and takes at most `most` turns at a time. In between it may be interrupted, and
    tells `on_begun` how many more turns were taken. After an exception other threads take no more. Returns what the
    calls return.
    """
    turns, told, done = np.zeros(1, np.int64), 0, []
    others = [pool.submit(work, turns, count, room) for room in rooms[1:count]]
    try:
        while turns[0] < count:
            done.append(work(turns, most, rooms[0]))
            if on_begun:
                taken = min(int(turns[0]), count)
                on_begun(taken - told)
                told = taken
        if on_begun and told < count:
            on_begun(count - told)
    except BaseException:  # an interrupt, too: other threads stop
        turns[0] = count
        raise
    return done + [other.result() for other in others]
