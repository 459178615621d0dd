"""lidarcfg live: a rig in a scene, fired in real time."""

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import (
    FILE,
    Seconds,
    StartTime,
    at_option,
    quiet_option,
    scene_option,
    trajectory_option,
    vehicle_option,
    warn,
    warn_of,
)
from lidarcfg.cli.progress import LINE_S
from lidarcfg.cli.replay import say_sources

if TYPE_CHECKING:
    from lidarcfg.capture.live import Live, LiveStatistics

SHOWN_S = 1.0  # between two updates of the line on a terminal


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg live data/rigs/roof.yaml --scene data/scenes/street.yaml \\
          127.0.0.1 --duration 1
      lidarcfg live data/rigs/mixed.yaml --scene data/scenes/street.yaml \\
          127.0.0.1 --emulate --poses 9000
    """
)
@cloup.argument("rig", type=FILE, help="YAML: the sensors and their poses.")
@cloup.argument(
    "targets",
    nargs=-1,
    required=True,
    metavar="HOST[:PORT]...",
    help="The receivers. Without a port each datagram keeps its own.",
)
@cloup.option_group(
    "Scene and motion",
    scene_option,
    at_option,
    trajectory_option,
    cloup.option(
        "--poses",
        metavar="-|[ADDRESS:]PORT",
        help="Move vehicle and objects by lines of text, from stdin or by UDP: NAME x y z qx qy qz qw, in the world; "
        "the vehicle's name is vehicle.",
    ),
    vehicle_option,
    cloup.option("--start", type=StartTime(), metavar="TIME", help="ISO 8601, of the sensors' clocks.  [default: now]"),
    cloup.option("--duration", type=Seconds(), metavar="SECONDS", help="How long.  [default: until Ctrl-C]"),
)
@cloup.option(
    "--emulate",
    is_flag=True,
    help="Also answer drivers as the sensors do, at the addresses that their datagrams come from, as replay does. "
    "Drivers may then set where datagrams go.",
)
@cloup.option("--no-lag", is_flag=True, help="Drop packets rather than slow the clock down if the machine is too slow.")
@quiet_option
def live(
    rig: Path,
    targets: tuple[str, ...],
    scene: Path,
    at: str,
    trajectory: Path | None,
    poses: str | None,
    vehicle: Path | None,
    start: str | None,
    duration: float | None,
    emulate: bool,
    no_lag: bool,
    quiet: bool,
) -> None:
    """Fire a rig in a scene in real time and send its packets.

    The packets are those of `export`, each sent at its time, from the sensor's own address as `replay` has it. It goes
    on until Ctrl-C. Vehicle and objects may be moved meanwhile, by --poses.
    """
    from contextlib import ExitStack

    from lidarcfg.capture.live import Live
    from lidarcfg.capture.manifest import parse_pose, parse_time_ns
    from lidarcfg.capture.pose_reader import PoseLines, PoseReader
    from lidarcfg.study.checks import rig_warnings

    def say(message: str) -> None:
        if not quiet:
            click.echo(f"lidarcfg: {message}", err=True)

    one = Live(
        rig,
        scene,
        *targets,
        at=parse_pose(at),
        trajectory=trajectory,
        vehicle=vehicle,
        start_ns=parse_time_ns(start) if start else None,
        emulate=emulate,
        drop=no_lag,
        on_message=say,
    )
    warn_of(one.drive.vehicle)
    for message in rig_warnings(rig, vehicle=one.drive.vehicle):
        warn(message)
    interrupted = False
    with ExitStack() as stack:
        if poses:
            stack.enter_context(PoseReader(poses, PoseLines(one.move, warn)))
        stack.enter_context(one)
        for sensor in one.emulated:
            say(str(sensor))
        show = Dashboard(one, quiet)
        try:
            while duration is None or one.statistics.time_s < duration:
                one.step()
                show.update()
        except KeyboardInterrupt:
            interrupted = True
        show.close()
    if not quiet:
        click.echo(_summary(one.statistics, " and ".join(targets)))
        if len(one.sources) > 1:
            say_sources(one.sources)
    if interrupted and duration is not None:
        sys.exit(130)


class Dashboard:
    """A line on the terminal that says how it goes, or in a log a line from time to time."""

    def __init__(self, one: "Live", quiet: bool) -> None:
        self._one = one
        self._terminal = sys.stderr.isatty()
        self._every_s = SHOWN_S if self._terminal else LINE_S
        self._quiet = quiet
        self._shown_s = time.monotonic()
        self._packets = 0

    def update(self) -> None:
        """Show the line, if it is time."""
        now_s = time.monotonic()
        if self._quiet or now_s - self._shown_s < self._every_s:
            return
        now = self._one.statistics
        rate = (now.packets - self._packets) / (now_s - self._shown_s)
        self._shown_s = now_s
        self._packets = now.packets
        parts = [f"{now.time_s:.0f} s", f"{rate:,.0f} packets/s", f"lag {now.lag_s * 1000:.1f} ms"]
        if self._one.emulated:
            parts.append(f"{now.asked} of {len(self._one.emulated)} sensors asked by drivers")
        line = ", ".join([*parts, *_losses(now)])
        click.echo(f"\r{line}\x1b[K" if self._terminal else line, err=True, nl=not self._terminal)

    def close(self) -> None:
        """Leave an empty line."""
        if self._terminal and not self._quiet:
            click.echo("\r\x1b[K", err=True, nl=False)


def _losses(now: "LiveStatistics") -> list[str]:
    """What did not go as with sensors."""
    slowed = [f"{now.slowed_s:.2f} s slower than real time"] if now.slowed_s else []
    return slowed + ([f"{now.dropped:,} packets dropped"] if now.dropped else [])


def _summary(now: "LiveStatistics", targets: str) -> str:
    """What was sent, at the end."""
    unsent = [f"{now.unsent:,} not sent, as no driver wanted them or none can get them"] if now.unsent else []
    late = f"at most {now.latest_s * 1000:.1f} ms late"
    return ", ".join([f"{now.packets:,} datagrams to {targets} in {now.time_s:.2f} s", late, *_losses(now), *unsent])
