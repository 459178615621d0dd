"""CRC-32/MPEG-2: polynomial 0x04C11DB7, most significant bit first, from all ones, nothing inverted at the end."""

# mypy: disallow-untyped-decorators=False
import numpy as np
from numpy.typing import NDArray

from lidarcfg.jit import njit
from lidarcfg.packets.codec import Octets

POLYNOMIAL, BITS, SLICES = 0x04C11DB7, 0xFFFFFFFF, 4


def _tables() -> NDArray[np.uint32]:
    """(SLICES, 256) the effect on the CRC of a byte at each distance from the end of a slice."""
    out = np.zeros((SLICES, 256), np.uint32)
    for byte in range(256):
        value = byte << 24
        for k in range(SLICES):
            for _ in range(8):
                value = (value << 1 ^ (POLYNOMIAL if value >> 31 else 0)) & BITS
            out[k, byte] = value
    return out


TABLES = _tables()


def crc32(octets: Octets) -> NDArray[np.uint32]:
    """(P,) of octets (P, n)."""
    return np.asarray(_crc32(octets, TABLES))


@njit(cache=True, nogil=True)
def _crc32(octets: Octets, tables: NDArray[np.uint32]) -> NDArray[np.uint32]:
    count, size = octets.shape
    out = np.empty(count, np.uint32)
    sliced = size - size % 4
    for p in range(count):
        row, value = octets[p], np.uint32(BITS)
        for i in range(0, sliced, 4):
            value = (
                tables[3, (value >> np.uint32(24)) ^ row[i]]
                ^ tables[2, ((value >> np.uint32(16)) & np.uint32(255)) ^ row[i + 1]]
                ^ tables[1, ((value >> np.uint32(8)) & np.uint32(255)) ^ row[i + 2]]
                ^ tables[0, (value & np.uint32(255)) ^ row[i + 3]]
            )
        for i in range(sliced, size):
            value = np.uint32(value << np.uint32(8)) ^ tables[0, (value >> np.uint32(24)) ^ row[i]]
        out[p] = value
    return out
