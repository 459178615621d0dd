"""Names of grid.py as loops know them that are still numba's; it goes with the last of these."""

from lidarcfg.placement.grid import Counts as Counts
from lidarcfg.placement.grid import seen_words as seen_words
from lidarcfg.placement.grid import unpack as unpacked
from lidarcfg.placement.sight import UNLIMITED_SIGHT as EVERYTHING

__all__ = ["EVERYTHING", "Counts", "seen_words", "unpacked"]
