from .misses import Misses as Misses
from .misses import MissesFound as MissesFound
from .scanners import Scanner as Scanner
from .target import Target as Target
