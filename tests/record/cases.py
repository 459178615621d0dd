"""All cases; each computes answers that must not change by a single bit."""

from tests.record import captures, studies, world
from tests.record.answers import CASES
from tests.record.captures import RECORDING

__all__ = ["CASES", "RECORDING", "captures", "studies", "world"]
