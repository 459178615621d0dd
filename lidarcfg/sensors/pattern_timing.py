"""When the channels of a sensor with a scan pattern fire."""

from collections.abc import Iterable, Iterator

import numpy as np

from lidarcfg.geometry import Array, Flags, Times
from lidarcfg.sensors.firing import FiringBatch, Firings, FramePattern, PacketPace, Timing
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.scan_pattern import ScanPattern


class PatternTiming(Timing):
    """The timing of a sensor with a scan pattern and without packets: each firing counts as one."""

    def check(self, mount: Mount) -> None:
        """Each mount can be simulated."""

    def pace(self, mount: Mount) -> PacketPace:
        """By the pattern's mean rate."""
        pattern = mount.sensor.pattern
        return PacketPace(max(pattern.period_ns // len(pattern.time_ns), 1), 1)

    def schedule(self, mount: Mount, start_ns: int, spans: Iterable[range]) -> Iterator[FiringBatch]:
        """The firings of equal times; the pattern begins at `start_ns`."""
        pattern = mount.sensor.pattern
        period_ns = self.pace(mount).period_ns
        for numbers in spans:
            number = np.array(numbers)
            counts = (pattern.count_before(at * period_ns) for at in (numbers.start, numbers.stop))
            fired = firings(pattern, start_ns, *counts)
            yield FiringBatch(fired[in_view(mount, fired.encoder_rad)], number, start_ns + (number + 1) * period_ns)

    def fired_before(self, mount: Mount, start_ns: int, packet: int) -> Times:
        scan = mount.sensor.pattern
        end = scan.count_before(packet * self.pace(mount).period_ns)
        return fired_counts(scan, end, in_view(mount, scan.azimuth_rad))

    def pattern(self, mount: Mount) -> FramePattern:
        return FramePattern(mount.sensor.pattern)


def firings(pattern: ScanPattern, start_ns: int, first: int, end: int) -> Firings:
    """The firings from number `first` to `end` of a pattern that begins at `start_ns`."""
    time_ns, rows = pattern.walk(first, end)
    return Firings(
        time_ns=start_ns + time_ns,
        laser=pattern.channel[rows],
        encoder_rad=pattern.azimuth_rad[rows],
        elevation_rad=pattern.elevation_rad[rows],
    )


def fired_counts(pattern: ScanPattern, end: int, fires: Flags | None = None) -> Times:
    """(L,) how often each channel is among the firings before number `end` of a pattern, or those (F,) that fire."""
    periods, rest = divmod(end, len(pattern.channel))
    channel, first = pattern.channel, pattern.channel[:rest]
    if fires is not None:
        channel, first = channel[fires], first[fires[:rest]]
    whole, part = (np.bincount(some, minlength=pattern.channels) for some in (channel, first))
    return np.asarray(periods * whole + part)


def in_view(mount: Mount, azimuth_rad: Array) -> Flags:
    """(N,) which azimuths are in the mount's horizontal field of view."""
    low, high = mount.azimuth_fov_deg or (0.0, 360.0)
    return np.asarray((np.degrees(azimuth_rad) - low) % 360 <= ((high - low) % 360 or 360.0))
