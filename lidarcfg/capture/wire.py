"""Faults of the wire: packets that are lost, doubled, late or overtaken between a sensor and the capture.

They hit whole packets, in the order in which the sensor sends them, whatever they hold; packets are not changed, so
that their counters tell what happened. `sensors/faults.py` has the keys.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from heapq import heappop, heappush

import numpy as np

from lidarcfg.capture.ethernet import EthernetFrames, stamped
from lidarcfg.sensors.faults import Doubled, Fault, Late, Lost, Overtaken, WireFault
from lidarcfg.simulate.echoes import drawn
from lidarcfg.simulate.sensor_runs import OnFault


def over_wire(
    frames: Iterator[EthernetFrames], faults: Mapping[int, Fault], start_ns: int, on_fault: OnFault
) -> Iterator[EthernetFrames]:
    """What comes of a sensor's frames, in time order. `faults` are by their numbers in the rig.

    Each fault acts on what the one before it leaves.
    """
    for number, fault in faults.items():
        if isinstance(fault, WireFault):
            frames = _after(frames, number, fault, start_ns, on_fault)
    return frames


def _after(
    frames: Iterator[EthernetFrames], number: int, fault: WireFault, start_ns: int, on_fault: OnFault
) -> Iterator[EthernetFrames]:
    """What one fault leaves."""
    from_ns, to_ns = (start_ns + at_ns for at_ns in fault.span_ns)
    queue = _Queue()
    behind: deque[tuple[int, list[bytes]]] = deque()  # those overtaken, by the number that they wait for
    done = 0
    time_ns = 0
    for some in frames:
        packets = list(some.packets)
        chances = drawn((fault.seed, number), done, len(packets))
        hits = 0
        for n, ((time_ns, records), chance) in enumerate(zip(packets, chances.tolist(), strict=True), done):
            hit = from_ns <= time_ns < to_ns and chance < fault.fraction
            hits += hit
            match fault:
                case Lost() if hit:
                    pass
                case Doubled() if hit:
                    queue.add(time_ns, records)
                    queue.add(time_ns, records)
                case Late() if hit:
                    queue.add(time_ns + round(fault.delay_s * 10**6) * 1000, records)
                case Overtaken() if hit:
                    behind.append((n + fault.by, records))
                case _:
                    queue.add(time_ns, records)
            while behind and behind[0][0] <= n:
                queue.add(time_ns, behind.popleft()[1])
        done += len(packets)
        on_fault(number, hits)
        yield from queue.before(time_ns)
    for _, records in behind:
        queue.add(time_ns, records)
    yield from queue.before(None)


class _Queue:
    """Packets on their way, by when they come; those of one time in the order in which they were added."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, list[bytes]]] = []
        self._added = 0

    def add(self, time_ns: int, records: list[bytes]) -> None:
        """A packet that comes at a time."""
        heappush(self._heap, (time_ns, self._added, records))
        self._added += 1

    def before(self, time_ns: int | None) -> Iterator[EthernetFrames]:
        """Those that come before a time, which are taken from the queue; all of them, if it is None."""
        times = list[int]()
        frames = list[bytes]()
        while self._heap and (time_ns is None or self._heap[0][0] < time_ns):
            at_ns, _, records = heappop(self._heap)
            times += [at_ns] * len(records)
            frames += [stamped(record, at_ns) for record in records]
        if frames:
            yield EthernetFrames(np.array(times, np.int64), frames)
