"""GPS time as in LAS: seconds since 1980-01-06 including leap seconds, minus 10^9."""

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from lidarcfg.geometry import Array
from lidarcfg.units import SECOND_NS

ADJUSTED_S = 10**9  # "adjusted standard GPS time": LAS 1.4, global encoding, bit 0
# Days that began after a leap second, since the start of GPS time: IERS Bulletin C.
LEAP_DAYS = (
    *("1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01"),
    *("1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01"),
    *("2015-07-01", "2017-01-01"),
)


def _unix_s(day: str) -> int:
    return int(datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp())


SHIFT_S = _unix_s("1980-01-06") + ADJUSTED_S
LEAPS_S = np.array([_unix_s(day) for day in LEAP_DAYS], np.int64)
COUNTED_S = LEAPS_S + np.arange(1, len(LEAPS_S) + 1)  # the same instants on a clock that counts them


def gps_seconds(time_ns: NDArray[np.int64]) -> Array:
    """Adjusted standard GPS time of times in ns since 1970, UTC: to 30 ns until 2028, the resolution of float64."""
    whole_s, rest_ns = np.divmod(time_ns, SECOND_NS)
    leaps = np.searchsorted(LEAPS_S, whole_s, side="right")
    return np.asarray(whole_s - SHIFT_S + leaps + rest_ns / SECOND_NS)


def unix_ns(gps_s: Array) -> NDArray[np.int64]:
    """Times in ns since 1970, UTC, of adjusted standard GPS times."""
    floor_s = np.floor(gps_s)
    whole_s = floor_s.astype(np.int64) + SHIFT_S
    whole_s -= np.searchsorted(COUNTED_S, whole_s, side="right")
    return np.asarray(whole_s * SECOND_NS + np.rint((gps_s - floor_s) * SECOND_NS).astype(np.int64))
