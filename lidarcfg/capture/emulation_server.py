"""The ports on which emulated sensors answer. A separate thread serves them, so that no client delays the packets.

Clients are not trusted: a request has a greatest size and must end in time, answers must be read, and a port has a
greatest number of connections.
"""

import asyncio
import errno
import signal
import socket
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from threading import Thread
from typing import Any, cast

from lidarcfg.errors import ConfigError, one_line, reason
from lidarcfg.packets.emulator import RequestError, Service, Target

BEGINNING_MAX = 1 << 14  # bytes that must tell the size of a request
REQUEST_MAX = 1 << 20  # bytes
CONNECTIONS_MAX = 64  # open on a port at the same time
PATIENCE_S = 5.0  # with a client that does not end its request, or does not read its answer
MESSAGES_MAX = 100  # of a port
PUSH_S = 1.0  # between two datagrams that nobody asked for
TO_ALL = "255.255.255.255" if sys.platform == "linux" else ""  # where datagrams arrive that are sent to all


class EmulationServer:
    """Answers on ports between entering and leaving it.

    `services` are pairs of an address of this machine and a service there. `on_message` gets lines for the terminal,
    in another thread. Raises ConfigError on entering if an address is not this machine's, or a port is taken or not
    allowed; then none is open.
    """

    def __init__(self, services: Iterable[tuple[str, Service]], on_message: Callable[[str], None]) -> None:
        self._ports = [_Port(address, service, on_message) for address, service in services]
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._thread = Thread(target=self._run, name="services", daemon=True)
        self._running: Future[None] = Future()

    @property
    def asked(self) -> set[str]:
        """The addresses at which a driver has asked."""
        return {port.address for port in self._ports if port.asked}

    def __enter__(self) -> "EmulationServer":
        try:
            for port in self._ports:
                port.bind()
        except ConfigError:
            for port in self._ports:
                port.close()
            self._loop.close()
            raise
        self._thread.start()
        self._running.result()
        return self

    def __exit__(self, *error: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()
        self._loop.close()

    def _run(self) -> None:
        if hasattr(signal, "pthread_sigmask"):  # a client that is gone must not end the command, as a reader's end does
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
        self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        try:
            for port in self._ports:
                await port.open()
            self._running.set_result(None)
            await self._stop.wait()
        except OSError as error:
            self._running.set_exception(error)
        for port in self._ports:
            port.close()
        await asyncio.sleep(0)  # transports close in the loop's next turn


class _Port:
    """A service at an address."""

    def __init__(self, address: str, service: Service, on_message: Callable[[str], None]) -> None:
        self.address = address
        self.service = service
        self.connections: set[_Connection] = set()
        self.asked = False  # by anyone
        self._on_message = on_message
        self._said: set[str] = set()
        self._sockets: list[socket.socket] = []
        self._open: list[asyncio.Server | asyncio.BaseTransport] = []
        self._pushing: asyncio.Task[None] | None = None

    def bind(self) -> None:
        """Take the port. Raises ConfigError."""
        self._sockets.append(_bound(self.address, self.service))
        if self.service.broadcast:
            self._sockets.append(_bound(TO_ALL, self.service, shared=True))

    async def open(self) -> None:
        """Begin to answer."""
        loop = asyncio.get_running_loop()
        if self.service.transport == "tcp":
            self._open.append(await loop.create_server(lambda: _Connection(self), sock=self._sockets[0]))
            return
        own = _Datagrams(self)
        transport, _ = await loop.create_datagram_endpoint(lambda: own, sock=self._sockets[0])
        self._open.append(transport)
        if self.service.push:
            self._pushing = loop.create_task(_push(transport, self.service.push))
        for shared in self._sockets[1:]:
            transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self, own), sock=shared)
            self._open.append(transport)

    def close(self) -> None:
        """Answer no more."""
        if self._pushing:
            self._pushing.cancel()
        for connection in list(self.connections):
            connection.abort()
        for one in self._open or self._sockets:
            one.close()

    def answer(self, request: bytes, client: str) -> tuple[bytes, bool]:
        """The answer to a client's request, and whether the connection ends with it. Raises RequestError."""
        given = self.service.answer(request, client)
        self.asked = self.asked or bool(given.data)
        if given.message:
            self.say(f"{client} {given.message}")
        return given.data, given.close

    def say(self, what: str) -> None:
        """Print a message about the port, once."""
        if what not in self._said and len(self._said) < MESSAGES_MAX:
            self._said.add(what)
            self._on_message(one_line(f"{self.address}, {self.service.name}: {what}"))


def _bound(address: str, service: Service, shared: bool = False) -> socket.socket:
    """A socket of the service's port; `shared` with other sensors. Raises ConfigError."""
    stream = service.transport == "tcp"
    opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM if stream else socket.SOCK_DGRAM)
    try:
        if shared or (stream and sys.platform != "win32"):  # a closed connection would keep its port for a while
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((address, service.port))
        if stream:
            opened.listen()
    except OSError as error:
        opened.close()
        what = {
            errno.EADDRINUSE: "another program has this port",
            errno.EACCES: "only a privileged user may open this port; on Linux root, or anyone after "
            f"`sysctl net.ipv4.ip_unprivileged_port_start={service.port}`",
            errno.EADDRNOTAVAIL: "not an address of this machine; give it to it (`ip address add`), "
            "or send to 127.0.0.1 on Linux",
        }.get(error.errno or 0, reason(error))
        where = f"{address or 'all addresses'}, {service.transport.upper()} port {service.port}"
        raise ConfigError(f"{where}, on which {service.name} is answered: {what}") from None
    return opened


class _Connection(asyncio.Protocol):
    """A client's connection, on which requests follow one another."""

    _transport: asyncio.Transport

    def __init__(self, port: _Port) -> None:
        self._port = port
        self._client = ""
        self._received = bytearray()
        self._size: int | None = None  # of the first request in it, if that is known
        self._full = False  # whether the client has answers to read before it gets more
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._client = transport.get_extra_info("peername")[0]
        self._port.connections.add(self)
        if len(self._port.connections) > CONNECTIONS_MAX:
            self.abort(f"{self._client} opens more than {CONNECTIONS_MAX} connections")

    def connection_lost(self, error: Exception | None) -> None:
        self._port.connections.discard(self)
        self._stop_timer()

    def data_received(self, data: bytes) -> None:
        self._received += data
        self._answer_all()

    def pause_writing(self) -> None:
        self._full = True
        self._transport.pause_reading()
        self._start_timer("does not read its answer")

    def resume_writing(self) -> None:
        self._full = False
        self._stop_timer()
        if not self._transport.is_closing():
            self._transport.resume_reading()
            self._answer_all()

    def abort(self, why: str = "") -> None:
        """Close the connection at once."""
        if why:
            self._port.say(why)
        self._transport.abort()

    def _answer_all(self) -> None:
        """Answer the whole requests received, as long as the client reads the answers."""
        try:
            while not self._full and not self._transport.is_closing() and (request := self._next_request()):
                self._stop_timer()
                answer, last = self._port.answer(request, self._client)
                self._transport.write(answer)
                if last:
                    self._transport.close()
        except RequestError as error:
            self.abort(f"{self._client} sends {error}")
        if self._received and not self._timer and not self._transport.is_closing():
            self._start_timer("does not end its request")

    def _next_request(self) -> bytes | None:
        """The first request received; None: it is not there or not whole. Raises RequestError."""
        if self._size is None and self._received:
            self._size = self._port.service.size(bytes(self._received[:BEGINNING_MAX]))
            if self._size is None and len(self._received) >= BEGINNING_MAX:
                raise RequestError(f"{BEGINNING_MAX:,} bytes that begin no request")
            if self._size is not None and self._size > REQUEST_MAX:
                raise RequestError(f"a request of {self._size:,} bytes; allowed: {REQUEST_MAX:,}")
        if self._size is None or len(self._received) < self._size:
            return None
        request = bytes(self._received[: self._size])
        del self._received[: self._size]
        self._size = None
        return request

    def _start_timer(self, what: str) -> None:
        self._stop_timer()
        why = f"{self._client} {what} in {PATIENCE_S:g} s"
        self._timer = asyncio.get_running_loop().call_later(PATIENCE_S, self.abort, why)

    def _stop_timer(self) -> None:
        if self._timer:
            self._timer.cancel()
            self._timer = None


async def _push(transport: asyncio.DatagramTransport, made: Callable[[], tuple[bytes, Target]]) -> None:
    """Send what a sensor sends unasked."""
    while True:
        await asyncio.sleep(PUSH_S)
        transport.sendto(*made())


class _Datagrams(asyncio.DatagramProtocol):
    """Requests that are a datagram each, and answers from the sensor's own address."""

    _transport: asyncio.DatagramTransport

    def __init__(self, port: _Port, own: "_Datagrams | None" = None) -> None:
        self._port = port
        self._own = own or self  # from which answers are sent
        self._full = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)  # Python 3.11's does not derive from it

    def pause_writing(self) -> None:
        self._full = True

    def resume_writing(self) -> None:
        self._full = False

    def datagram_received(self, data: bytes, client: tuple[str | Any, int]) -> None:
        try:
            answer, _ = self._port.answer(data, client[0])
        except RequestError as error:
            self._port.say(f"{client[0]} sends {error}")
            return
        if answer and not self._own._full:
            self._own._transport.sendto(answer, client)
