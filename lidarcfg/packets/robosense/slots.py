"""Where in an MSOP packet each return stands."""

from functools import lru_cache

import numpy as np

from lidarcfg.packets import blocks
from lidarcfg.packets.codec import Times
from lidarcfg.packets.robosense.facts import SLOTS, Unit
from lidarcfg.packets.robosense.layout import BLOCK, MSOP, RETURN


@lru_cache
def numbers(unit: Unit, dual: bool) -> Times:
    """(N,) the slot, numbered block by block, of each of a packet's (S, L) returns, or (S, L, 2) dual returns.

    With dual returns, both of 16 lasers stand in one block, one half each; of 32 lasers in two successive blocks.
    """
    sequences, each = unit.spin(dual).sequences, unit.count
    slots = np.arange(sequences * each * (1 + dual))
    if dual:
        sequence, laser, which = np.unravel_index(slots, (sequences, each, 2))
        slots = (sequence * 2 + which) * each + laser
    return np.asarray(slots)


@lru_cache
def places(unit: Unit, dual: bool) -> Times:
    """(N,) the byte at which each of a packet's returns begins."""
    fields = MSOP.fields
    assert fields
    first = fields["blocks"][1]
    block, slot = np.divmod(numbers(unit, dual), SLOTS)
    return np.asarray(first + block * BLOCK.itemsize + 4 + slot * RETURN.itemsize)


@lru_cache
def slots(unit: Unit, dual: bool) -> blocks.Slots:
    """The core's table of a packet's slots."""
    spin = unit.spin(dual)
    groups = spin.sequences // spin.per_azimuth
    each = 1 + dual
    at = numbers(unit, dual).reshape(groups, -1)[0]
    order = np.argsort(at)
    sequence, laser = np.divmod(order // each, unit.count)
    offset_ns = sequence * spin.sequence_ns + spin.offset_ns[laser]
    group_ns = spin.per_azimuth * spin.sequence_ns
    fraction = (offset_ns - spin.offset_ns.min()) / group_ns
    return blocks.Slots(
        laser=laser,
        fraction=np.tile(fraction, (groups, 1)),
        offset_ns=np.arange(groups)[:, None] * group_ns + offset_ns,
        kind=(order % each).astype(np.uint8),
        other=at[order ^ 1] if dual else np.empty(0, np.int64),
    )
