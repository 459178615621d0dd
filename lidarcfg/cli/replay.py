"""lidarcfg replay: a capture sent again over the network."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import FILE, Factor, from_option, quiet_option, sidecar_option, to_option, warn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from contextlib import ExitStack

    from lidarcfg.capture.pcap import Datagram
    from lidarcfg.capture.selection import Selection
    from lidarcfg.packets.emulator import Emulator


def say_sources(sources: "Mapping[str, str]") -> None:
    """Print from which address each sensor's datagrams came, and warn of those without one of their own."""
    for host, address in sources.items():
        if address:
            click.echo(f"{host} sent from {address}")
    if without := [host for host, address in sources.items() if not address]:
        warn(f"{', '.join(without)}: not addresses of this machine, so their datagrams came from its own")


def _emulated(
    stack: "ExitStack",
    pcap: Path,
    host: str,
    port: int | None,
    selection: "Selection",
    sidecars: tuple[Path, ...],
    quiet: bool,
) -> "Mapping[str, Emulator]":
    """The capture's sensors that answer drivers from now on, until the stack closes, by their addresses in it."""
    from lidarcfg.capture.emulation import find_emulated
    from lidarcfg.capture.emulation_server import EmulationServer

    def say(message: str) -> None:
        if not quiet:
            click.echo(f"lidarcfg: {message}", err=True)

    sensors = find_emulated(pcap, host, port, selection, warn, sidecars)
    services = ((one.site.address, service) for one in sensors for service in one.emulator.services)
    stack.enter_context(EmulationServer(services, say))
    for one in sensors:
        say(str(one))
    return {one.host: one.emulator for one in sensors}


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg replay out/sedan.pcap 127.0.0.1:2368
      lidarcfg replay out/sedan.pcap 127.0.0.1 --speed 2x --from 0.02 --to 0.08
    """
)
@cloup.argument("pcap", type=FILE, help="A capture.")
@cloup.argument("target", metavar="HOST[:PORT]", help="The receiver. Without a port each datagram keeps its own.")
@cloup.option(
    "--speed", type=Factor(10**6), metavar="FACTOR", default=1.0, help="Replay this many times as fast.  [default: 1]"
)
@cloup.option("--loop", is_flag=True, help="Start over at the end, until Ctrl-C.")
@cloup.option(
    "--emulate",
    is_flag=True,
    help="Also answer drivers as the sensors do, at the addresses that their datagrams come from: an Ouster's HTTP "
    "(TCP port 80), a Hesai's PTC (TCP 9347), a Livox's commands (UDP 56000 and 56100), a Seyond's HTTP (TCP 8010). "
    "Drivers may then set where datagrams go.",
)
@sidecar_option
@cloup.option_group("Selection", from_option, to_option, help="Send only a part of the capture.")
@quiet_option
def replay(
    pcap: Path,
    target: str,
    speed: float,
    loop: bool,
    emulate: bool,
    sidecars: tuple[Path, ...],
    from_s: float,
    to_s: float,
    quiet: bool,
) -> None:
    """Send a capture's datagrams to a host, to test a driver live.

    The datagrams keep the pace of the recording, times --speed. Those of each sensor come from the sensor's own address
    if this machine has it. On Linux, those that 192.168.1.201 sends to 127.0.0.1 come from 127.168.1.201.
    """
    from contextlib import ExitStack

    from lidarcfg.capture.replay import read_selected, repeat
    from lidarcfg.capture.replay import replay as send
    from lidarcfg.capture.selection import Selection

    host, _, port = target.partition(":")
    if ":" in target and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise click.BadParameter(f"{port!r} is not a port, 1 to 65535", param_hint="HOST[:PORT]")
    if sidecars and not emulate:
        raise click.UsageError("--sidecar needs --emulate: only drivers ask for such files")
    selection = Selection(from_s, to_s)

    def read() -> "Iterator[Datagram]":
        return read_selected(pcap, warn, selection)

    number = int(port) if port else None
    with ExitStack() as stack:
        sensors = _emulated(stack, pcap, host, number, selection, sidecars, quiet) if emulate else {}
        sent = send(repeat(read) if loop else read(), host, number, speed, sensors)
    if not quiet:
        late = f"at most {sent.latest_s * 1000:.1f} ms late"
        click.echo(f"{sent.packets:,} datagrams to {target} in {sent.seconds:.2f} s, {late}")
        if sent.unsent:
            click.echo(f"{sent.unsent:,} not sent, while drivers had asked for none, or for a host out of reach")
        if len(sent.sources) > 1:
            say_sources(sent.sources)
    if sent.interrupted and not loop:
        sys.exit(130)
