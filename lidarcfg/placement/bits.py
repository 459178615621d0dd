"""Words of 64 bits, one for each cuboid of a row along x, and what processors count in them by one instruction."""

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

Words = NDArray[np.uint64]

NONE, ONE, ALL = np.uint64(0), np.uint64(1), ~np.uint64(0)
BIT = ONE << np.arange(64, dtype=np.uint64)


def _ones(_: Any, word: Any) -> Any:
    return types.int64(types.uint64), lambda _c, builder, _s, args: builder.ctpop(args[0])


def _lowest(_: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, args: Any) -> Any:
        return builder.cttz(args[0], context.get_constant(types.boolean, False))

    return types.int64(types.uint64), generate


def _highest(_: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, _: Any, args: Any) -> Any:
        leading = builder.ctlz(args[0], context.get_constant(types.boolean, False))
        return builder.sub(context.get_constant(types.int64, 63), leading)

    return types.int64(types.uint64), generate


ones: Any = intrinsic(_ones)  # how many bits of a word are 1
lowest: Any = intrinsic(_lowest)  # the number of the lowest of them; 64 where none is
highest: Any = intrinsic(_highest)  # the number of the highest of them; −1 where none is
