"""LAS and LAZ files of anyone: what their headers may announce, and the coordinates of their points."""

import os
import struct
from pathlib import Path
from typing import IO, Any

import numpy as np

from lidarcfg.errors import CloudError, missing
from lidarcfg.geometry import Array

# Places in the header and in a VLR, by LAS 1.4 and the LASzip specification: the header's size, where the points begin,
# the number of VLRs, the point format, with its highest bit set in LAZ, and a point's size; in a VLR its user, record
# and length; in LASzip's VLR the number of items, each with two bytes of type, of size and of version.
HEADER_AT = 94
POINTS_AT = 96
VLRS_AT = 100
FORMAT_AT = 104
SIZE_AT = 105
COMPRESSED = 0x80
VLR_USER_AT = 2
VLR_RECORD_AT = 18
VLR_HEAD = 54
LASZIP = b"laszip encoded"
LASZIP_ITEMS_AT = 32
CHUNK_LEAST = 20  # bytes, fewer than any chunk has


def read_xyz(path: Path, most: int) -> Array:
    """(N, 3): where the points are. Raises CloudError, also for more than `most`, and ConversionError without laspy."""
    laspy, lazrs = libraries()
    try:
        check_header(path)
        with laspy.open(path, read_evlrs=False, laz_backend=laspy.LazBackend.Lazrs) as reader:
            count = reader.header.point_count
            if count > most:
                raise CloudError(f"{path}: has {count:,} points; allowed: at most {most:,}")
            rows = reader.read_points(count)
            if len(rows) != count:
                raise ValueError(f"{count} points are announced but missing")
            with np.errstate(over="ignore", invalid="ignore"):  # absurd scales give values that are not finite
                return np.stack([rows.x, rows.y, rows.z], axis=1).astype(np.float64)
    except OSError as error:
        raise CloudError.from_os(path, error) from None
    except (laspy.LaspyException, lazrs.LazrsError, ValueError) as error:
        raise CloudError.damaged(path, error) from None


def check_header(path: Path) -> None:
    """Raises ValueError for numbers that laspy and lazrs would take at their word.

    laspy would look for as many VLRs as are announced; lazrs would allocate memory for as many chunks, and end the
    process, and panic where the items of a point do not add up to its size.
    """
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        vlrs = _unpacked(file, VLRS_AT, "<I")[0]
        points_at = _unpacked(file, POINTS_AT, "<I")[0]
        if vlrs * VLR_HEAD > size:
            raise ValueError(f"{vlrs} VLRs are announced but missing")
        if not _unpacked(file, FORMAT_AT, "<B")[0] & COMPRESSED:
            return
        (table_at,) = _unpacked(file, points_at, "<q")
        if table_at == -1:  # the file was written as a stream, with the table at its end
            (table_at,) = _unpacked(file, size - 8, "<q")
        chunks = _unpacked(file, table_at, "<II")[1]  # after its version
        if chunks * CHUNK_LEAST > size:
            raise ValueError(f"{chunks} chunks are announced but missing")
        (at,) = _unpacked(file, HEADER_AT, "<H")
        for _ in range(vlrs):
            length = _unpacked(file, at + VLR_RECORD_AT, "<HH")[1]
            file.seek(at + VLR_USER_AT)
            if file.read(len(LASZIP)) == LASZIP:
                items_at = at + VLR_HEAD + LASZIP_ITEMS_AT
                (count,) = _unpacked(file, items_at, "<H")
                items = _unpacked(file, items_at + 2, f"<{3 * count}H")
                if not count or sum(items[1::3]) != _unpacked(file, SIZE_AT, "<H")[0]:
                    raise ValueError("its LASzip items are not those of its points")
            at += VLR_HEAD + length


def _unpacked(file: IO[bytes], at: int, form: str) -> tuple[int, ...]:
    """Numbers at a place of the file. Raises ValueError where there is none."""
    end = at + struct.calcsize(form)
    if not 0 <= at < end <= os.fstat(file.fileno()).st_size:
        raise ValueError(f"it has no byte {end - 1}")
    file.seek(at)
    return struct.unpack(form, file.read(end - at))


def libraries() -> tuple[Any, Any]:
    """laspy and lazrs."""
    try:
        import laspy
        import lazrs
    except ImportError:
        raise missing("laspy[lazrs]") from None
    return laspy, lazrs
