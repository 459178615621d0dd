"""Units of time in nanoseconds: every time inside is an int64 of these."""

MICROSECOND_NS = 10**3
SECOND_NS = 10**9
MINUTE_NS = 60 * SECOND_NS
HOUR_NS = 3600 * SECOND_NS
