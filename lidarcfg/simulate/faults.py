"""What the faults of a sensor do to its firings, to what it sees, to its clock, and to what it knows of itself.

`sensors/faults.py` has their keys. All is a function of time and of the numbers of firings, so that it does not depend
on how a drive is divided. Clocks are wrong by one amount in each packet.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array, Flags, Times
from lidarcfg.packets.condition import Condition, Dirt
from lidarcfg.sensors.faults import (
    ClockDrift,
    ClockFault,
    ClockJump,
    ClockLost,
    DirtyWindow,
    Fault,
    SlowHead,
    Temperature,
    Unplugged,
    Voltage,
    WireFault,
)
from lidarcfg.sensors.firing import FiringBatch, Timing
from lidarcfg.sensors.rig import Mount, rotation_errors
from lidarcfg.simulate.echoes import Echoes, drawn
from lidarcfg.units import MINUTE_NS, SECOND_NS

DIRT = 1 << 32  # the first of the streams of random numbers of dirt


@dataclass(frozen=True)
class SensorFaults:
    """The faults of one mounted sensor, by their numbers in the rig, in a drive from `start_ns` to `end_ns`."""

    mount: Mount
    faults: Mapping[int, Fault]
    start_ns: int
    end_ns: int
    by_encoder: bool  # whether the encoder triggers firings; else the sensor's clock does
    restarts: int = 0

    @classmethod
    def of(
        cls, mount: Mount, faults: Mapping[int, Fault], timing: Timing, start_ns: int, end_ns: int
    ) -> "SensorFaults":
        """Those of a sensor. Raises ConfigError for what it cannot have."""
        for _, what in rotation_errors(mount, faults):
            raise ConfigError(what)
        turns = any(isinstance(fault, SlowHead) for fault in faults.values())
        by_encoder = turns and getattr(timing.pattern(mount), "start_rad", None) is not None
        return cls(mount, faults, start_ns, end_ns, by_encoder)

    @property
    def of_sensor(self) -> bool:
        """Whether there are faults of the sensor itself, and not of the wire only."""
        return any(not isinstance(fault, WireFault) for fault in self.faults.values())

    def plugged(self, begin_ns: int) -> list[tuple[int, int]]:
        """From, to: when the sensor, which starts at `begin_ns`, is not unplugged."""
        gaps = sorted(self._span(fault) for fault in self.faults.values() if isinstance(fault, Unplugged))
        spans = []
        for from_ns, to_ns in gaps:
            spans.append((begin_ns, min(from_ns, self.end_ns)))
            begin_ns = max(begin_ns, to_ns)
        spans.append((begin_ns, self.end_ns))
        return [(begin, end) for begin, end in spans if begin < end]

    def restarted(self, begin_ns: int, times: int) -> "SensorFaults":
        """Those of the sensor from a time on at which it is switched on again; its head has turned from there only."""
        kept = {
            number: fault
            for number, fault in self.faults.items()
            if not (isinstance(fault, SlowHead) and self._span(fault)[0] < begin_ns)
        }
        return replace(self, faults=kept, restarts=times)

    def costs(self, period_ns: int) -> dict[int, int]:
        """How many packets, sent once a period, do not come of a sensor that is unplugged, by the fault."""
        spans = {i: self._span(fault) for i, fault in self.faults.items() if isinstance(fault, Unplugged)}
        return {i: max(min(to_ns, self.end_ns) - from_ns, 0) // period_ns for i, (from_ns, to_ns) in spans.items()}

    def hits(self, sent_ns: Times) -> dict[int, int]:
        """How many of the packets, sent at times (P,), each fault of the sensor itself hits."""
        return {
            number: int(self._during(fault, sent_ns).sum())
            for number, fault in self.faults.items()
            if not isinstance(fault, WireFault | Unplugged)
        }

    # rotation

    def fired(self, batch: FiringBatch) -> FiringBatch:
        """The firings of packets as the head really turns; of those that are complete before the end."""
        turns = [fault for fault in self.faults.values() if isinstance(fault, SlowHead)]
        if not turns or not len(batch.sent_ns):
            return batch
        turns.sort(key=lambda turn: turn.start_s)
        fired = batch.firings
        if not self.by_encoder:
            first = np.append(True, np.diff(fired.encoder_rad) != 0)  # all that fire where the head is at one time
            group = np.cumsum(first) - 1
            behind = self._behind(turns, fired.time_ns[first])[group]
            encoder_rad = np.mod(fired.encoder_rad - behind * (2 * math.pi), 2 * math.pi)
            return replace(batch, firings=replace(fired, encoder_rad=encoder_rad))
        time_ns = self._delayed(turns, fired.time_ns)
        sent_ns = -(-self._delayed(turns, batch.sent_ns) // 1000) * 1000
        count = int(np.searchsorted(sent_ns, self.end_ns, "right"))
        each = len(time_ns) // len(sent_ns)
        kept = replace(fired, time_ns=time_ns)[: count * each]
        return FiringBatch(kept, batch.number[:count], sent_ns[:count], None, batch.first)

    def _behind(self, turns: list[SlowHead], time_ns: Times) -> Array:
        """How many revolutions the head is behind where it would be without faults, at times of any shape."""
        behind = np.zeros(time_ns.shape)
        for turn in turns:
            from_ns, to_ns = self._span(turn)
            past = np.clip(time_ns - from_ns, 0, to_ns - from_ns).astype(np.float64)
            slow = [self.mount.rpm - rpm for rpm in turn.rpm]
            mean = slow[0] + (slow[1] - slow[0]) * past / (2 * (to_ns - from_ns))
            behind += past * mean / MINUTE_NS
        return behind

    def _delayed(self, turns: list[SlowHead], time_ns: Times) -> Times:
        """When the head is where it would be at these times, of any shape, without faults."""
        late_ns = np.zeros(time_ns.shape, np.int64)  # by the faults before
        for turn in turns:
            from_ns, to_ns = self._span(turn)
            length = to_ns - from_ns
            first, last = (rpm / self.mount.rpm for rpm in turn.rpm)
            todo = (time_ns + late_ns - from_ns).astype(np.float64)  # nanoseconds of turning at the full speed
            done = (first + last) / 2 * length  # in the fault
            left = np.clip(todo, 0, done)
            root = np.sqrt(first * first + 2 * (last - first) / length * left)
            within = np.divide(2 * left, first + root, out=np.zeros_like(left), where=left > 0)
            inside = (todo > 0) & (todo < done)
            late = np.where(inside, np.rint(within - todo), np.where(todo >= done, length - done, 0))
            late_ns = late_ns + np.where(todo > 0, late, 0).astype(np.int64)
        return time_ns + late_ns

    def _rpm(self, time_ns: Times) -> Array:
        """(P,): the speed of the head."""
        rpm = np.full(len(time_ns), self.mount.rpm)
        for fault in self.faults.values():
            if isinstance(fault, SlowHead):
                from_ns, to_ns = self._span(fault)
                share = (time_ns - from_ns) / (to_ns - from_ns)
                during = self._during(fault, time_ns)
                rpm[during] = (fault.rpm[0] + (fault.rpm[1] - fault.rpm[0]) * share)[during]
        return rpm

    # the window

    def seen(self, found: Echoes, batch: FiringBatch, first: int) -> Echoes:
        """What is seen of echoes (N, R) of firings, numbered from `first` on, through the window."""
        if not any(isinstance(fault, DirtyWindow) for fault in self.faults.values()):
            return found
        lost = np.zeros(len(found.range_m), np.bool_)
        fired = batch.firings
        azimuth_deg = np.degrees(fired.encoder_rad + self.mount.sensor.azimuth_offset_rad[fired.laser])
        for number, fault in self.faults.items():
            if isinstance(fault, DirtyWindow):
                during = self._during(fault, fired.time_ns)
                dirt = Dirt(fault.azimuth_deg, fault.fraction, during)
                chance = drawn((fault.seed, DIRT + number), first, len(lost))
                lost |= during & dirt.covers(azimuth_deg) & (chance < fault.fraction)
        if not lost.any():
            return found
        return replace(
            found,
            range_m=np.where(lost[:, None], np.inf, found.range_m),
            strongest_m=np.where(lost, np.inf, found.strongest_m),
        )

    # the clock

    def ahead_ns(self, time_ns: Times) -> Times:
        """How far the clock is ahead at times of any shape."""
        ahead_ns = np.zeros(time_ns.shape, np.int64)
        for fault in self.faults.values():
            during = self._during(fault, time_ns)
            if isinstance(fault, ClockDrift):
                past_ns = time_ns - self._span(fault)[0]
                ahead_ns += np.where(during, np.rint(past_ns * (fault.ppm / 1e6)), 0).astype(np.int64)
            elif isinstance(fault, ClockJump | ClockLost):
                by_s = fault.by_s if isinstance(fault, ClockJump) else fault.apart_s
                ahead_ns += during * round(by_s * SECOND_NS)
        return np.maximum(ahead_ns, -time_ns)  # no earlier than 1970

    def stamped(self, batch: FiringBatch) -> FiringBatch:
        """The firings as the clock has their times."""
        if not any(isinstance(fault, ClockFault) for fault in self.faults.values()) or not len(batch.sent_ns):
            return batch
        fired = batch.firings
        time_ns = fired.time_ns.reshape(len(batch.sent_ns), -1)
        ahead_ns = self.ahead_ns(time_ns.min(axis=1))[:, None]
        return replace(batch, firings=replace(fired, time_ns=(time_ns + ahead_ns).ravel()))

    def steps(self, due_ns: range, begin_ns: int, step_ns: int) -> Iterator[tuple[range, int]]:
        """Parts of a span of times since `begin_ns` in which the clock is ahead by one amount, and by how much."""
        edges = {due_ns.start, due_ns.stop}
        for fault in self.faults.values():
            if isinstance(fault, ClockFault):
                from_ns, to_ns = (at_ns - begin_ns for at_ns in self._span(fault))
                edges |= {from_ns, to_ns}
                if isinstance(fault, ClockDrift):
                    edges |= set(range(max(from_ns, due_ns.start), min(to_ns, due_ns.stop), step_ns))
        for begin, end in pairwise(sorted(edge for edge in edges if due_ns.start <= edge <= due_ns.stop)):
            yield range(begin, end), int(self.ahead_ns(np.array(begin_ns + begin)))

    # what it knows

    def condition(self, time_ns: Times) -> Condition:
        """What is wrong when packets are sent at times (P,)."""
        temperature_c, hot_s, voltage_v = (np.full(len(time_ns), np.nan) for _ in range(3))
        synchronised = np.ones(len(time_ns), np.bool_)
        dirt = []
        for fault in self.faults.values():
            during = self._during(fault, time_ns)
            if isinstance(fault, Temperature):
                temperature_c[during] = fault.celsius
                hot_s[during] = (time_ns[during] - self._span(fault)[0]) / SECOND_NS
            elif isinstance(fault, Voltage):
                voltage_v[during] = fault.volts
            elif isinstance(fault, ClockLost):
                synchronised &= ~during
            elif isinstance(fault, DirtyWindow):
                dirt.append(Dirt(fault.azimuth_deg, fault.fraction, during))
        return Condition(self._rpm(time_ns), temperature_c, hot_s, voltage_v, synchronised, tuple(dirt), self.restarts)

    def _span(self, fault: Fault) -> tuple[int, int]:
        from_ns, to_ns = fault.span_ns
        return self.start_ns + from_ns, self.start_ns + to_ns

    def _during(self, fault: Fault, time_ns: Times) -> Flags:
        from_ns, to_ns = self._span(fault)
        return np.asarray((time_ns >= from_ns) & (time_ns < to_ns))
