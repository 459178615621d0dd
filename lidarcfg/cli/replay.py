"""lidarcfg replay: a capture sent again over the network."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import cloup

from lidarcfg.cli.options import FILE, Factor, from_option, quiet_option, to_option, warn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lidarcfg.capture.pcap import Datagram


def _say_sources(sources: "Mapping[str, str]") -> None:
    """Print from which address each sensor's datagrams came, and warn of those without one of their own."""
    for host, address in sources.items():
        if address:
            click.echo(f"{host} sent from {address}")
    if without := [host for host, address in sources.items() if not address]:
        warn(f"{', '.join(without)}: not addresses of this machine, so their datagrams came from its own")


@cloup.command(
    epilog="""
    \b
    Examples:
      lidarcfg replay out/two.pcap 127.0.0.1:2368
      lidarcfg replay out/two.pcap 127.0.0.1 --speed 2x --from 0.02 --to 0.08
    """
)
@cloup.argument("pcap", type=FILE, help="A capture.")
@cloup.argument("target", metavar="HOST[:PORT]", help="The receiver. Without a port each datagram keeps its own.")
@cloup.option(
    "--speed", type=Factor(10**6), metavar="FACTOR", default=1.0, help="Replay this many times as fast.  [default: 1]"
)
@cloup.option("--loop", is_flag=True, help="Start over at the end, until Ctrl-C.")
@cloup.option_group("Selection", from_option, to_option, help="Send only a part of the capture.")
@quiet_option
def replay(pcap: Path, target: str, speed: float, loop: bool, from_s: float, to_s: float, quiet: bool) -> None:
    """Send a capture's datagrams to a host, to test a driver live.

    The datagrams keep the pace of the recording, times --speed. Each sensor's come from its own address if this machine
    has that; to 127.0.0.1 on Linux from 127.168.1.201 for 192.168.1.201.
    """
    from lidarcfg.capture.replay import read_selected, repeat
    from lidarcfg.capture.replay import replay as send
    from lidarcfg.capture.selection import Selection

    host, _, port = target.partition(":")
    if ":" in target and not (port.isascii() and port.isdigit() and 1 <= int(port) <= 65535):
        raise click.BadParameter(f"{port!r} is not a port, 1 to 65535", param_hint="HOST[:PORT]")
    selection = Selection(from_s, to_s)

    def read() -> "Iterator[Datagram]":
        return read_selected(pcap, warn, selection)

    sent = send(repeat(read) if loop else read(), host, int(port) if port else None, speed)
    if not quiet:
        late = f"at most {sent.latest_s * 1000:.1f} ms late"
        click.echo(f"{sent.packets:,} datagrams to {target} in {sent.seconds:.2f} s, {late}")
        if len(sent.sources) > 1:
            _say_sources(sent.sources)
    if sent.interrupted and not loop:
        sys.exit(130)
