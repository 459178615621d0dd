"""CRC-32/MPEG-2: polynomial 0x04C11DB7, most significant bit first, from all ones, nothing inverted at the end."""

import zlib

import numpy as np
from numpy.typing import NDArray

from lidarcfg.packets.codec import Octets

REVERSED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], np.uint8)  # each byte's bits


def crc32(octets: Octets) -> NDArray[np.uint32]:
    """(P,) of octets (P, n): zlib's, which takes bits in the other order and inverts the result."""
    crc = np.array([zlib.crc32(row) for row in REVERSED[octets]], "<u4")
    swapped = REVERSED[np.invert(crc).view(np.uint8)].reshape(-1, 4)
    return swapped.view(">u4")[:, 0].astype(np.uint32)
