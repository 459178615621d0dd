"""numba for the loops of this project, with a place to keep what it compiles."""

import atexit
import os
import shutil
import tempfile
from functools import partial
from pathlib import Path

# Compiled loops are kept beside the package or in the user's cache; where neither can be written, for this run only.
# numba reads the variable when it is imported, so this comes first.
if not os.access(Path(__file__).parent, os.W_OK) and not os.access(Path.home(), os.W_OK):
    _cache = tempfile.mkdtemp(prefix="lidarcfg-")
    os.environ.setdefault("NUMBA_CACHE_DIR", _cache)
    atexit.register(shutil.rmtree, _cache, ignore_errors=True)

from numba import njit as njit
from numba.core.options import DefaultOptions

# An array that a loop takes out of a tuple is counted as a reference, and again when it is let go. Inner functions that
# make no arrays need no counting, and some spend a sixth of their time on it. numba's option for that is not in its
# manual: where it is missing, they are as right, and slower.
inner = partial(njit, cache=True, nogil=True, **({"_nrt": False} if hasattr(DefaultOptions, "_nrt") else {}))
