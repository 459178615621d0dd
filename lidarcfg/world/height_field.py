"""Height fields: ground from a grid of heights, two triangles a cell."""

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import NPZ_ERRORS
from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import SceneError
from lidarcfg.geometry import Array
from lidarcfg.inputs import check_memory
from lidarcfg.world.meshes import FILE_MAX, Mesh, check_readable
from lidarcfg.world.scene_file import HeightField

SUFFIXES = ".png", ".npy"
CELLS_MAX = 10_000_000
CELL_BYTES = 600  # of memory a cell while the tracer's tree is built
PNG = b"\x89PNG\r\n\x1a\n"
IHDR = struct.Struct(">16xIIBB")  # 16 bytes, then width, height, bits and colour type
GREY = 0
BITS = (8, 16)


def height_field_mesh(item: HeightField, folder: Path) -> Mesh:
    """The triangles of a height field in the world frame, facing up; cells are cut from south-west to north-east.

    Raises SceneError if its file cannot be used.
    """
    heights = read_heights(folder / item.file) if item.file else np.array(item.heights_m)
    high = np.abs(heights * item.scale + item.position_m[2]).max()
    if not high <= COORDINATE_MAX_M:
        raise SceneError(f"{item.file}: a height is {high:g} m; allowed: at most {COORDINATE_MAX_M:g}")
    rows, columns = heights.shape
    vertices = np.empty((rows, columns, 3))
    vertices[..., 0] = np.arange(columns) * item.cell_m
    vertices[..., 1] = np.arange(rows)[::-1, None] * item.cell_m
    vertices[..., 2] = heights * item.scale
    index = np.arange(rows * columns).reshape(rows, columns)
    west = index[:-1, :-1]
    east = index[:-1, 1:]
    low_west = index[1:, :-1]
    low_east = index[1:, 1:]
    triangles = np.stack([low_west, low_east, east, low_west, east, west], axis=-1)
    return vertices.reshape(-1, 3) + item.position_m, triangles.reshape(-1, 3)


def read_heights(path: Path) -> Array:
    """(rows, columns) the grid in a file, unscaled. Raises SceneError."""
    check_readable(path, FILE_MAX)
    if path.suffix.lower() not in SUFFIXES:
        raise SceneError(f"{path}: is no height field; allowed: {', '.join(SUFFIXES)}")
    with _scene_errors(path):
        found = _png(path) if path.suffix.lower() == ".png" else _npy(path)
        if odd := np.argwhere(~np.isfinite(found)).tolist():
            row, column = odd[0]
            raise SceneError(f"{path}: row {row}, column {column} is {found[row, column]:g}; a height must be finite")
    return found


def _npy(path: Path) -> Array:
    """The array of a .npy file, which is read once its size is checked."""
    mapped: NDArray[np.generic] = np.load(path, mmap_mode="r", allow_pickle=False)
    if mapped.ndim != 2 or mapped.dtype.kind not in "iuf":
        raise SceneError(f"{path}: has {mapped.ndim} axes of {mapped.dtype}; allowed: 2, rows and columns, of numbers")
    _check_size(path, *mapped.shape)
    return np.array(mapped, np.float64)


def _png(path: Path) -> Array:
    """The grey levels of an image."""
    from PIL import Image

    with open(path, "rb") as file:
        head = file.read(IHDR.size)
    if not head.startswith(PNG) or len(head) < IHDR.size:
        raise SceneError(f"{path}: is no PNG file")
    columns, rows, bits, colour = IHDR.unpack(head)
    if colour != GREY or bits not in BITS:
        raise SceneError(f"{path}: is not an image in grey of 8 or 16 bits; colours are no heights")
    _check_size(path, rows, columns)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the size is checked
        with Image.open(path, formats=["PNG"]) as image:
            return np.array(image, np.float64)


def _check_size(path: Path, rows: int, columns: int) -> None:
    """Raises SceneError for a grid with no cell, or with too many."""
    if min(rows, columns) < 2:
        raise SceneError(f"{path}: has {rows} × {columns} heights; allowed: at least 2 × 2")
    cells = (rows - 1) * (columns - 1)
    if cells > CELLS_MAX:
        size = f"{cells:,} cells, which take {cells * CELL_BYTES / 1e9:,.0f} GB of memory"
        raise SceneError(f"{path}: has {size}; allowed: at most {CELLS_MAX:,} cells")
    check_memory(f"{path}: a height field of {cells:,} cells", cells * CELL_BYTES)


@contextmanager
def _scene_errors(path: Path) -> Iterator[None]:
    """Turns what NumPy and Pillow raise for a damaged file into SceneError."""
    try:
        yield
    except (*NPZ_ERRORS, OSError) as error:
        raise SceneError.damaged(path, error) from None
