"""numba, for the loops that are not yet in the core."""

from typing import Any

import numba

UNCOUNTED: dict[str, Any] = {}


def njit(**options: Any) -> Any:
    """A loop that Python calls."""
    options.pop("makes_arrays", None)
    options.pop("kept", None)
    return numba.njit(**{"cache": True, "nogil": True} | options)


outer = inner = njit
