"""Whose packets are these? The family of a flow's packets, their sensor, their mount.

A flow is what one host sends to one port in datagrams of one size.
"""

import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from glob import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.ethernet import Datagrams
from lidarcfg.capture.pcap import read_batches
from lidarcfg.config.models import Section
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Bytes
from lidarcfg.inputs import read_regular
from lidarcfg.packets.codec import Decoder, KnownSensors, PacketSource
from lidarcfg.packets.families import FAMILIES, codec, family
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import Sensor, catalogue, load_sensor

EXAMINED = 3  # packets of a source, at most, by which its family is found: the first may be damaged
SIDECAR_MAX = 64_000_000  # bytes of a file beside a capture


class Flow(NamedTuple):
    """What one host sends to one port in datagrams of one size."""

    host: str
    port: int
    size: int  # bytes

    @property
    def endpoint(self) -> tuple[str, int]:
        """Its address, and the port that it sends to."""
        return self.host, self.port

    @property
    def name(self) -> str:
        """Its host:port."""
        return f"{self.host}:{self.port}"


class SidecarFile(NamedTuple):
    """A file of a sensor's."""

    name: str
    content: bytes
    suffix: str  # that its name would have beside a capture


class SourceFinder:
    """Finds out who sends the datagrams of a capture. `model` is given for all, or the rig's mounts are.

    `sidecars` are read instead of the files of their kind beside the capture. Raises PacketError for those that are
    no sensor's.
    """

    def __init__(
        self,
        path: Path,
        on_warning: Callable[[str], None],
        rig: Rig | None = None,
        model: str | None = None,
        driver_view: bool = False,
        sidecars: Sequence[str | Path] = (),
    ) -> None:
        self._path = path
        self._on_warning = on_warning
        self._driver_view = driver_view
        self._mounts = rig.mounts if rig else ()
        self._model = load_sensor(model) if model else None
        self._catalogue = cache(_catalogued)
        self._sidecar_files = cache(self._find_sidecar_files)
        self._given_files = [_given_file(Path(one)) for one in sidecars]
        self._asked: set[str] = set()  # suffixes of files that were looked for
        self.flows: list[Flow] = []  # in the order of their appearance
        self._numbers: dict[int, int] = {}  # of the flows, by host, port and size as one integer
        self._families: dict[Flow, str | None] = {}  # None: it is no LiDAR
        self._at: dict[tuple[str, int], Flow] = {}  # the first LiDAR's flow of an endpoint
        self._others: dict[Flow, str] = {}  # the families of LiDARs' packets that are not the given sensor's
        self._skipped: Counter[Flow] = Counter()  # how many of these came
        self.other_sizes: Counter[int] = Counter()  # datagrams that are no LiDAR's, counted by size

    def lidar(self, batch: Datagrams) -> tuple[Datagrams, NDArray[np.intp]]:
        """The datagrams (N,) that hold a LiDAR's returns, and (N,) which of `flows` each is of.

        Raises PacketError if packets of two makers come from one address to one port.
        """
        host, port, size = (column.astype(np.uint64) for column in (batch.host, batch.port, batch.size))
        packed = np.asarray(host << 32 | port << 16 | size, np.uint64)
        found, inverse, counts = np.unique(packed, return_inverse=True, return_counts=True)
        if not self._numbers.keys() >= set(found.tolist()):
            order = np.argsort(inverse, kind="stable")
            ends = np.cumsum(counts)
            for one, count, end in zip(found.tolist(), counts.tolist(), ends.tolist(), strict=True):
                if one not in self._numbers:
                    self._numbers[one] = len(self.flows)
                    self._add_flow(batch, order[end - count : end][:EXAMINED].tolist())
        numbers = [self._numbers[one] for one in found.tolist()]
        for number, count in zip(numbers, counts.tolist(), strict=True):
            if self.flows[number] in self._others:
                self._skipped[self.flows[number]] += count
        is_lidar = np.array([self._families[self.flows[number]] is not None for number in numbers], np.bool_)[inverse]
        self.other_sizes.update(batch.size[~is_lidar].tolist())
        return batch[is_lidar], np.array(numbers, np.intp)[inverse][is_lidar]

    def by_flow(self, numbers: NDArray[np.intp]) -> Iterator[tuple[Flow, NDArray[np.bool_]]]:
        """The flows that datagrams (N,) are of, in the order of their appearance, and (N,) which are of each."""
        for number in dict.fromkeys(numbers.tolist()):
            yield self.flows[number], numbers == number

    @property
    def strangers(self) -> Iterator[str]:
        """Warnings about LiDAR packets that were skipped because they are not the given sensor's."""
        for flow, count in sorted(self._skipped.items()):
            given = self._given(flow)
            assert given
            what = f"{count} packets of {self._others[flow]} ({flow.size} bytes) are skipped"
            yield f"{self._path}: {flow.name}: {what}: they are not {given.name}'s"

    @property
    def unread(self) -> Iterator[str]:
        """Warnings about given files that nothing in the capture needed."""
        for one in self._given_files:
            if one.suffix not in self._asked:
                yield f"{one.name}: is not read: nothing in {self._path} needs it"

    def _find_sidecar_files(self, suffix: str) -> Mapping[str, bytes]:
        self._asked.add(suffix)
        given = {one.name: one.content for one in self._given_files if one.suffix == suffix}
        return given or _files_beside(self._path, suffix)

    def _add_flow(self, batch: Datagrams, first: Sequence[int]) -> None:
        """Find the family of a new flow by its first packets: the given sensor's, or the first that matches."""
        host = socket.inet_ntoa(int(batch.host[first[0]]).to_bytes(4))
        flow = Flow(host, int(batch.port[first[0]]), int(batch.size[first[0]]))
        payloads = [batch.data[batch.start[i] : batch.start[i] + flow.size].tobytes() for i in first]
        given = self._given(flow)
        if given:
            codec(given)  # raises ConfigError for a sensor without packets
        found = self._find_family(flow, payloads, [given.codec or ""] if given else FAMILIES)
        if given and not found:
            if other := self._find_family(flow, payloads, FAMILIES):
                self._others[flow] = other
        elif found:
            before = self._at.setdefault(flow.endpoint, flow)
            if before != flow and self._families[before] != found:
                both = f"{self._families[before]} ({before.size} bytes) and {found} ({flow.size} bytes)"
                raise PacketError(f"{self._path}: {flow.name} sends packets of two makers: {both}")
        self._families[flow] = found
        self.flows.append(flow)

    def _find_family(self, flow: Flow, payloads: Sequence[bytes], names: Iterable[str]) -> str | None:
        """The first of these families that matches one of the payloads; None if none does."""
        source = self.source(flow)
        for payload in payloads:
            for name in names:  # each loaded when it is its turn
                if family(name).matches(source, len(payload), payload):
                    return name
        return None

    def family_of(self, flow: Flow) -> str:
        """The name of the family of a LiDAR's packets."""
        found = self._families[flow]
        assert found
        return found

    def mount(self, flow: Flow) -> tuple[int, Mount | None]:
        """The rig's mount at a flow's endpoint, and its index; -1 and None without one."""
        at = flow.endpoint
        return next(((i, m) for i, m in enumerate(self._mounts) if (m.host, m.data_port) == at), (-1, None))

    def _given(self, flow: Flow) -> Sensor | None:
        """The sensor given for a flow, by the model or by the rig."""
        _, mount = self.mount(flow)
        return self._model or (mount.sensor if mount else None)

    def source(self, flow: Flow) -> PacketSource:
        """What a codec can ask about a flow."""
        _, mount = self.mount(flow)
        return PacketSource(
            where=f"{self._path}: {flow.name}",
            host=flow.host,
            port=flow.port,
            sidecar_files=self._sidecar_files,
            payloads=partial(_payloads, self._path, flow.host),
            on_warning=self._on_warning,
            settings=mount.settings if mount and not self._model else Section({}),
            driver_view=self._driver_view,
        )

    def sensor(self, flow: Flow, packets: Bytes) -> Sensor:
        """The sensor of a flow that begins with these packets (P, size). Raises PacketError."""
        name = self.family_of(flow)
        return self._given(flow) or family(name).identify(self.source(flow), packets, self._known(name))

    def decoder(self, flow: Flow, packets: Bytes) -> Decoder:
        """The decoder for a flow that begins with these packets (P, size). Raises PacketError, ConfigError."""
        known = self._known(self.family_of(flow))
        trusted = self._model is None
        return codec(self.sensor(flow, packets)).decoder(self.source(flow), packets, known, trusted)

    def _known(self, family: str) -> KnownSensors:
        return partial(self._catalogue, family)


def _catalogued(codec: str, name: str | None = None) -> list[Sensor]:
    """The catalogue's sensors with this codec, or that of this name, if it has this codec."""
    return [load_sensor(one) for one in catalogue(codec) if name in (None, one)]


def _given_file(path: Path) -> SidecarFile:
    try:
        content = read_regular(path, SIDECAR_MAX)
    except OSError as error:
        raise PacketError.from_os(path, error) from None
    for name in FAMILIES:
        if suffix := family(name).sidecar_suffix(str(path), content):
            return SidecarFile(str(path), content, suffix)
    raise PacketError(f"{path}: no file of a sensor's; allowed: an Ouster's metadata, a Hesai's angles or firing times")


def _files_beside(path: Path, suffix: str) -> Mapping[str, bytes]:
    """The files beside a capture NAME.pcap that match NAME, NAME-*, NAME.* or NAME_<number>, followed by `suffix`.

    NAME_0.json is what Ouster's recorder writes beside NAME.pcap; with a NAME_0.pcap there it is that one's.
    """
    stem = escape(path.stem)
    end = escape(suffix)
    found = {file for between in ("", "-*", ".*") for file in path.parent.glob(stem + between + end)}
    for file in path.parent.glob(f"{stem}_*{end}"):
        number = file.name.removeprefix(f"{path.stem}_").removesuffix(suffix)
        if number.isdecimal() and not path.with_stem(f"{path.stem}_{number}").exists():
            found.add(file)
    try:
        return {str(one): read_regular(one, SIDECAR_MAX) for one in sorted(found)}
    except OSError as error:
        raise PacketError.from_os(error.filename, error) from None


def _payloads(path: Path, host: str, port: int | None, size: int) -> Iterator[Bytes]:
    """All payloads of one size that a host sends to a port, or to any port."""
    number = int.from_bytes(socket.inet_aton(host))
    for batch in read_batches(path, lambda warning: None):
        mine = (batch.host == number) & (batch.size == size)
        yield batch[mine if port is None else mine & (batch.port == port)].payloads(size)
