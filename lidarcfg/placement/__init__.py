"""Placement: where the LiDARs should sit."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

# Compiled kernels are kept beside the package or in the user's cache; where neither can be written, for this run only.
if not os.access(Path(__file__).parent, os.W_OK) and not os.access(Path.home(), os.W_OK):
    _cache = tempfile.mkdtemp(prefix="lidarcfg-")
    os.environ.setdefault("NUMBA_CACHE_DIR", _cache)
    atexit.register(shutil.rmtree, _cache, ignore_errors=True)
