"""A rig in a scene, fired in real time: its packets go to hosts on the network, and whoever has a loop gives poses."""

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from types import TracebackType

import numpy as np

from lidarcfg.capture.emulation import EmulatedSensor, emulated_mounts
from lidarcfg.capture.emulation_server import EmulationServer
from lidarcfg.capture.live_packets import LivePackets
from lidarcfg.capture.pcap import Datagram
from lidarcfg.capture.sender import PacedSender, Receiver
from lidarcfg.config.models import Given
from lidarcfg.errors import LidarcfgError
from lidarcfg.files import loaded
from lidarcfg.geometry import Array
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.units import SECOND_NS, TIME_END_NS
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import Scene, load_scene
from lidarcfg.world.vehicle import Vehicle

STEP_S = 0.04
STEPS_S = 0.005, 1.0  # allowed
LATE_S = 0.05  # behind the clock, that are not made up for


@dataclass(frozen=True)
class LiveStatistics:
    """How a live rig does."""

    time_s: float  # of its clock, that were fired so far
    packets: int  # sent
    unsent: int  # while drivers had asked for none, or for a host out of reach
    lag_s: float  # by which the last step was late
    latest_s: float  # the largest delay of a packet
    slowed_s: float  # by which its clock was stopped in all, as it could not keep up
    dropped: int  # packets that were not fired
    asked: int  # sensors that drivers have asked


class Live:
    """A rig on a vehicle in a scene that sends its sensors' packets in real time, step by step.

    Each call of `step` sends those of one step, each packet at its time, while the next is traced: a pose given before
    it holds from that next one on. Vehicle and scene are those of `SceneDrive.load`; `targets` are HOST or HOST:PORT,
    and `start_ns` is by default the time of the system's clock. With `emulate`, drivers are answered, and may set where
    packets go. If steps come too late, the clock is stopped meanwhile; with `drop`, it goes on and packets are lost.
    Raises LidarcfgError.
    """

    def __init__(
        self,
        rig: Rig | Given,
        scene: Scene | Given,
        *targets: str,
        at: Array | None = None,
        trajectory: str | Path | Trajectory | None = None,
        vehicle: Vehicle | Given | None = None,
        start_ns: int | None = None,
        emulate: bool = False,
        drop: bool = False,
        step_s: float = STEP_S,
        on_message: Callable[[str], None] = print,
    ) -> None:
        if not targets or (emulate and len(targets) > 1):
            what = "drivers are answered for one host" if targets else "no host to send to"
            raise LidarcfgError(f"{what}; allowed: {'one' if targets else 'one or more'} HOST[:PORT]")
        if not STEPS_S[0] <= step_s <= STEPS_S[1]:
            raise LidarcfgError(f"step_s is {step_s}; allowed: {STEPS_S[0]} to {STEPS_S[1]}")
        if start_ns is not None and not 0 <= start_ns < TIME_END_NS:
            raise LidarcfgError(f"start_ns is {start_ns}; allowed: from 0 to below {TIME_END_NS}")
        self._step_ns = round(step_s * SECOND_NS)
        self._start_ns = start_ns
        self._drop = drop
        self._on_message = on_message
        receivers = [Receiver.parse(target) for target in targets]
        drive = SceneDrive.load(
            loaded(rig, load_rig, Rig),
            loaded(scene, load_scene, Scene),
            0.0,
            at=at,
            trajectory=trajectory,
            vehicle=vehicle,
            start_ns=start_ns or 0,
        )
        self.drive = drive
        self._packets = LivePackets(drive, self._step_ns)
        self.emulated: list[EmulatedSensor] = []
        if emulate:
            self.emulated = emulated_mounts(drive.rig.mounts, receivers[0], on_message)
        self._server: EmulationServer | None = None
        self._sender = PacedSender(receivers, emulators={one.host: one.emulator for one in self.emulated})
        self._opened: ExitStack | None = None
        self._lock = Lock()
        self._poses: dict[str, Array] = {}  # that came since the last step
        self._coming: Future[list[Datagram]] | None = None  # the step that is traced
        self._fired = 0  # steps
        self._sent = 0
        self._skip = 0  # steps to come that are left out
        self._lag_s = 0.0
        self._slowed_s = 0.0

    def __enter__(self) -> "Live":
        with ExitStack() as opened:
            opened.enter_context(self._sender)
            if self.emulated:
                services = ((one.site.address, service) for one in self.emulated for service in one.emulator.services)
                self._server = opened.enter_context(EmulationServer(services, self._on_message))
            self._tracing = opened.enter_context(ThreadPoolExecutor(os.cpu_count() or 1))
            self._planning = opened.enter_context(ThreadPoolExecutor(1))
            self._sending = opened.enter_context(ThreadPoolExecutor(1))  # which Ctrl-C does not interrupt
            self._opened = opened.pop_all()
        self._start_ns = time.time_ns() if self._start_ns is None else self._start_ns
        self._packets.start(self._start_ns)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        opened, self._opened = self._opened, None
        assert opened
        with opened:
            if kind is None and self._coming:
                self._sending.submit(self._send, self._coming, last=True).result()

    def move(self, name: str, T_world_object: Array) -> None:
        """Have the `vehicle`, or an object of the scene, move to a pose (4, 4). Any thread may call this.

        It gets there in the time that passed between this call and the one before, but 0.2 s at most; the first pose
        holds at once. Raises ConfigError for an unknown name and for what is no pose.
        """
        try:
            T = np.array(T_world_object, np.float64)
        except (TypeError, ValueError):
            T = np.empty(0)
        self._packets.check(name, T)
        with self._lock:
            self._poses[name] = T

    def step(self) -> None:
        """Send what was fired in a step, and trace the next one meanwhile; the first call only traces.

        Raises PacketError if a host cannot be reached.
        """
        if not self._opened:
            raise LidarcfgError("a rig is live from entering to leaving it: with Live(…) as live")
        with self._lock:
            poses, self._poses = self._poses, {}
        before = self._coming
        self._coming = self._planning.submit(self._packets.step, poses, self._tracing, self._skip > 0)
        self._fired += 1
        self._skip = max(self._skip - 1, 0)
        if before:
            self._sending.submit(self._send, before).result()

    @property
    def statistics(self) -> LiveStatistics:
        """How it has gone so far."""
        return LiveStatistics(
            time_s=self._fired * self._step_ns / SECOND_NS,
            packets=self._sender.sent,
            unsent=self._sender.unsent,
            lag_s=self._lag_s,
            latest_s=self._sender.latest_s,
            slowed_s=self._slowed_s,
            dropped=self._packets.dropped,
            asked=len(self._server.asked) if self._server else 0,
        )

    @property
    def sources(self) -> Mapping[str, str]:
        """By a sensor's address, the one that its packets come from; empty: this machine's."""
        return self._sender.sources

    def _send(self, fired: Future[list[Datagram]], last: bool = False) -> None:
        """Send a step's datagrams, and wait for its end."""
        assert self._start_ns is not None
        datagrams = fired.result()
        begin_ns = self._start_ns + self._sent * self._step_ns
        self._lag_s = max(self._sender.late_s(begin_ns), 0.0)
        if self._lag_s > LATE_S:
            self._make_up()
        for datagram in [*datagrams, *(self._packets.rest() if last else ())]:
            self._sender.send(datagram)
        self._sender.wait(begin_ns + self._step_ns)
        self._sent += 1

    def _make_up(self) -> None:
        """Leave out steps, or stop the clock, for as long as this step is late."""
        first = not (self._packets.dropped or self._skip or self._slowed_s)
        if self._drop:
            self._skip = self._skip or round(self._lag_s * SECOND_NS / self._step_ns)
        else:
            self._slowed_s += self._lag_s
            self._sender.postpone(self._lag_s)
        if first:
            what = "packets are dropped" if self._drop else "its clock slows down"
            self._on_message(f"{self._lag_s * 1000:.0f} ms behind real time: {what}")
