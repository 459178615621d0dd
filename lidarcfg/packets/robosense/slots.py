"""Where in an MSOP packet each return stands."""

from functools import lru_cache

import numpy as np

from lidarcfg.packets.codec import Times
from lidarcfg.packets.robosense import decode_kernels as kernels
from lidarcfg.packets.robosense.facts import BLOCKS, SLOTS, Unit


@lru_cache
def places(unit: Unit, dual: bool) -> Times:
    """(N,) the byte at which each of a packet's (S, L) returns, or (S, L, 2) dual returns, begins.

    With dual returns, both of 16 lasers stand in one block, one half each; of 32 lasers in two successive blocks.
    """
    sequences, each = unit.spin(dual).sequences, unit.count
    numbers = np.arange(sequences * each * (1 + dual))
    if dual:
        sequence, laser, which = np.unravel_index(numbers, (sequences, each, 2))
        slot = (sequence * 2 + which) * each + laser
    else:
        slot = numbers
    block = slot // SLOTS
    return np.asarray(kernels.FIRST + block * kernels.BLOCK + kernels.HEAD + slot % SLOTS * kernels.RETURN)


@lru_cache
def slots(unit: Unit, dual: bool) -> kernels.Slots:
    """The same for decoding, of those returns that share an azimuth."""
    spin = unit.spin(dual)
    groups = spin.sequences // spin.per_azimuth
    each = 1 + dual
    at = places(unit, dual).reshape(groups, -1)[0]
    order = np.argsort(at)
    sequence, laser = np.divmod(order // each, unit.count)
    offset_ns = sequence * spin.sequence_ns + spin.offset_ns[laser]
    other = at[order ^ 1] - at[order] if dual else np.zeros_like(at)
    return kernels.Slots(
        at=at[order] - at[0],
        laser=laser,
        fraction=(offset_ns - spin.offset_ns.min()) / (spin.per_azimuth * spin.sequence_ns),
        offset_ns=offset_ns,
        kind=(order % each).astype(np.uint8),
        other=other,
        blocks=BLOCKS // groups,
    )
