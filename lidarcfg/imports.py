"""Imports of libraries without others that these load for what nobody here does."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def without(*modules: str) -> Iterator[None]:
    """While some modules cannot be imported, as if they were not installed; what is imported already stays so."""
    absent = [name for name in modules if name not in sys.modules]
    sys.modules.update(dict.fromkeys(absent))  # type: ignore[arg-type]  # None is Python's way to say so
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


def load_cma() -> None:
    """Import cma, which takes SciPy's statistics for its surrogates and Matplotlib for its plots if it finds them.

    Half a second before a search. Where cma no longer does without, whoever imports it next gets all of it.
    """
    with without("scipy.stats", "matplotlib"), suppress(ImportError), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Could not import matplotlib")
        import cma  # noqa: F401
