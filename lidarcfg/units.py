"""Units of time in nanoseconds: every time inside is an int64 of these."""

MICROSECOND_NS = 10**3
MILLISECOND_NS = 10**6
SECOND_NS = 10**9
MINUTE_NS = 60 * SECOND_NS
HOUR_NS = 3600 * SECOND_NS
START_NS = 1_767_225_600 * SECOND_NS  # 2026-01-01 00:00:00 UTC, when simulated time begins, unless it is said
TIME_END_NS = 2**32 * SECOND_NS  # a pcap counts its seconds in 32 bits: 2106-02-07 06:28:16 UTC
