"""The interface by which a maker answers drivers as its sensors do: `replay --emulate`.

A maker's part is bytes in, bytes out: it opens no sockets and knows no threads. To plug one in:

1. Write `packets/MAKER/emulator.py` with a class that implements `Emulator`. Its `services` are the ports that the
   sensor answers on. A `Service` on TCP says with `size` how long a request is, as soon as its beginning tells;
   a datagram is a request as it is. `answer` gets a whole request and the address of who asks, and gives an `Answer`.
   What is no request of the protocol raises `RequestError`: the connection is closed, the datagram is left unanswered.
   What the sensor does not have, or a capture cannot do, is answered with the sensor's own error, and said in
   `Answer.message`: a line for the terminal, printed once.
2. `destination` says where the datagrams captured for a port go now: to `NetworkSite.target` at first, then where a
   driver had them sent; None while the sensor does not send, which discards them.
3. `payload` lets counters and stamps go on when a capture is sent again and again; a family whose drivers do not mind
   has no need of it, if its class derives from `Emulator`.
4. Override `Codec.emulator`, which makes one from the first packets of a source and the files beside the capture.
   It raises PacketError or ConfigError for what is missing.

`capture/emulation.py` has the sockets: it opens all ports before the first datagram is sent, or none; calls `answer`
in one thread of its own, apart from the one that sends; and closes them when the replay ends. `destination` and
`payload` are called in the thread that sends: let `answer` replace what they read by one assignment.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

Target = tuple[str, int]  # an IPv4 address and a port


class RequestError(Exception):
    """What a client sent is no request of the protocol. The message says what it is instead."""


@dataclass(frozen=True)
class NetworkSite:
    """The place of an emulated sensor on the network."""

    address: str  # its own, one of this machine's: datagrams come from it
    host: str  # the address that the command sends to
    port: int | None  # the port; None: each datagram keeps its own

    def target(self, port: int) -> Target:
        """Where a datagram that was captured for a port goes until a driver says otherwise."""
        return self.host, self.port or port


@dataclass(frozen=True)
class Answer:
    """The sensor's answer to a request."""

    data: bytes  # empty: none
    message: str = ""  # a line for the terminal: what a driver changed, or asked for in vain
    close: bool = False  # whether the connection ends with it


@dataclass(frozen=True)
class Service:
    """A port on which the sensor answers. Functions are called in one thread and return at once."""

    name: str  # of the protocol, for the terminal
    transport: Literal["tcp", "udp"]
    port: int
    answer: Callable[[bytes, str], Answer]  # to a request from an address. Raises RequestError
    size: Callable[[bytes], int | None] = (
        len  # of the request that begins so; None: more is needed. Raises RequestError
    )
    broadcast: bool = False  # whether datagrams to 255.255.255.255 are answered, too
    push: Callable[[], tuple[bytes, Target]] | None = None  # on UDP: what the sensor sends unasked once a second


class Emulator(Protocol):
    """A sensor that answers drivers."""

    name: str  # of its model
    services: Sequence[Service]
    own_ports: bool = False  # whether drivers know its datagrams by the port they come from, though they may open it

    def destination(self, port: int) -> Target | None:
        """Where datagrams captured for a port go now; None: the sensor does not send."""

    def payload(self, captured: bytes, later_ns: int) -> bytes:
        """What a datagram holds that is sent again so much later: its stamps and counters go on, if drivers ask that.

        `later_ns` is 0 in the first pass of a capture, and grows from pass to pass. Called in the thread that sends.
        """
        return captured
