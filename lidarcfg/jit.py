"""numba for the loops of this project: where compiled ones are kept, and a start without what none of them needs."""

import atexit
import gc
import importlib
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

# They are kept beside the package or in the user's cache; where neither can be written, for this run only.
if not os.access(Path(__file__).parent, os.W_OK) and not os.access(Path.home(), os.W_OK):
    _cache = tempfile.mkdtemp(prefix="lidarcfg-")
    os.environ.setdefault("NUMBA_CACHE_DIR", _cache)
    atexit.register(shutil.rmtree, _cache, ignore_errors=True)

# numba makes many objects that stay: it is loaded a tenth sooner if they are not looked through meanwhile.
if _collecting := gc.isenabled():
    gc.disable()

import numba.np.linalg
from numba import njit as njit

# With the first kernel numba asks whether there is a BLAS, by importing all of scipy.linalg, which takes as long as
# numba itself. No loop here multiplies matrices; what multiplies them elsewhere imports it when it is compiled.
with suppress(AttributeError):
    _ensure_blas, numba.np.linalg.ensure_blas = numba.np.linalg.ensure_blas, lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        numba.np.linalg.ensure_blas = _ensure_blas
if _collecting:
    gc.enable()
