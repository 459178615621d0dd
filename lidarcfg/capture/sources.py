"""Whose packets are these? The sources of a capture: the family of their packets, their sensor, their mount.

A source is what one host sends to one port in datagrams of one size. Inside the reader it is one number, so that numpy
can sort datagrams by it.
"""

import socket
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from glob import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.frames import Datagrams
from lidarcfg.capture.pcap import read_batches
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Bytes
from lidarcfg.inputs import read_regular
from lidarcfg.packets.codec import Decoder, KnownSensors, PacketSource
from lidarcfg.packets.families import FAMILIES, codec, family
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import Sensor, catalogue, load_sensor

EXAMINED = 3  # packets of a source, at most, by which its family is found: the first may be damaged
SIDECAR_MAX = 64_000_000  # bytes of a file beside a capture


class SourceFinder:
    """Finds out who sends the datagrams of a capture. `model` is given for all, or the rig's mounts are."""

    def __init__(
        self,
        path: Path,
        on_warning: Callable[[str], None],
        rig: Rig | None = None,
        model: str | None = None,
        driver_view: bool = False,
    ) -> None:
        self._path = path
        self._on_warning = on_warning
        self._driver_view = driver_view
        self._mounts = rig.mounts if rig else ()
        self._model = load_sensor(model) if model else None
        self._catalogue = cache(_catalogued)
        self._sidecar_files = cache(partial(_sidecar_files, path))
        self._families: dict[int, str | None] = {}  # by source; None: it is no LiDAR
        self._at: dict[int, int] = {}  # the first LiDAR's source of an address and port
        self._others: dict[int, str] = {}  # the families of LiDARs' packets that are not the given sensor's, by source
        self._skipped: Counter[int] = Counter()  # how many of these came, by source
        self.other_sizes: Counter[int] = Counter()  # datagrams that are no LiDAR's, counted by size

    def lidar(self, batch: Datagrams) -> tuple[Datagrams, NDArray[np.uint64]]:
        """The datagrams that hold a LiDAR's returns, and the source of each.

        Raises PacketError if packets of two makers come from one address to one port.
        """
        host, port, size = (column.astype(np.uint64) for column in (batch.host, batch.port, batch.size))
        keys = np.asarray(host << 32 | port << 16 | size, np.uint64)
        sources, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        if not self._families.keys() >= set(sources.tolist()):
            order = np.argsort(inverse, kind="stable")
            ends = np.cumsum(counts)
            for key, count, end in zip(sources.tolist(), counts.tolist(), ends.tolist(), strict=True):
                if key not in self._families:
                    rows = order[end - count : end][:EXAMINED].tolist()
                    payloads = [batch.data[batch.start[i] : batch.start[i] + batch.size[i]].tobytes() for i in rows]
                    self._add_source(key, payloads)
        if self._others:
            here = dict(zip(sources.tolist(), counts.tolist(), strict=True))
            self._skipped.update({key: here[key] for key in self._others.keys() & here.keys()})
        is_lidar = np.array([self._families[key] is not None for key in sources.tolist()], np.bool_)[inverse]
        self.other_sizes.update(batch.size[~is_lidar].tolist())
        return batch[is_lidar], keys[is_lidar]

    @property
    def strangers(self) -> Iterator[str]:
        """Warnings about LiDAR packets that were skipped because they are not the given sensor's."""
        for key, count in sorted(self._skipped.items()):
            given = self._given(key)
            assert given
            what = f"{count} packets of {self._others[key]} ({_size(key)} bytes) are skipped"
            yield f"{self._path}: {endpoint_name(key)}: {what}: they are not {given.name}'s"

    def _add_source(self, key: int, payloads: Sequence[bytes]) -> None:
        """Find the family of a new source by its first packets: the given sensor's, or the first that matches."""
        given = self._given(key)
        if given:
            codec(given)  # raises ConfigError for a sensor without packets
        found = self._find_family(key, payloads, [given.codec or ""] if given else FAMILIES)
        if given and not found:
            if other := self._find_family(key, payloads, FAMILIES):
                self._others[key] = other
        elif found:
            first = self._at.setdefault(key >> 16, key)
            if first != key and self._families[first] != found:
                both = f"{self._families[first]} ({_size(first)} bytes) and {found} ({_size(key)} bytes)"
                raise PacketError(f"{self._path}: {endpoint_name(key)} sends packets of two makers: {both}")
        self._families[key] = found

    def _find_family(self, key: int, payloads: Sequence[bytes], names: Iterable[str]) -> str | None:
        """The first of these families that matches one of the payloads; None if none does."""
        source = self.source(key)
        for payload in payloads:
            for name in names:  # each loaded when it is its turn
                if family(name).matches(source, len(payload), payload):
                    return name
        return None

    def family_of(self, key: int) -> str:
        """The name of the family of a LiDAR's packets."""
        found = self._families[key]
        assert found
        return found

    def mount(self, key: int) -> tuple[int, Mount | None]:
        """The rig's mount at a source's address, and its index; -1 and None without one."""
        at = _endpoint(key)
        return next(((i, m) for i, m in enumerate(self._mounts) if (m.host, m.data_port) == at), (-1, None))

    def _given(self, key: int) -> Sensor | None:
        """The sensor given for a source, by the model or by the rig."""
        _, mount = self.mount(key)
        return self._model or (mount.sensor if mount else None)

    def source(self, key: int) -> PacketSource:
        """What a codec can ask about a source."""
        host, port = _endpoint(key)
        return PacketSource(
            where=f"{self._path}: {endpoint_name(key)}",
            host=host,
            port=port,
            sidecar_files=self._sidecar_files,
            payloads=partial(_payloads, self._path, host),
            on_warning=self._on_warning,
            driver_view=self._driver_view,
        )

    def sensor(self, key: int, packets: Bytes) -> Sensor:
        """The sensor of a source that begins with these packets (P, size). Raises PacketError."""
        name = self.family_of(key)
        return self._given(key) or family(name).identify(self.source(key), packets, self._known(name))

    def decoder(self, key: int, packets: Bytes) -> Decoder:
        """The decoder for a source that begins with these packets (P, size). Raises PacketError, ConfigError."""
        known = self._known(self.family_of(key))
        trusted = self._model is None
        return codec(self.sensor(key, packets)).decoder(self.source(key), packets, known, trusted)

    def _known(self, family: str) -> KnownSensors:
        return partial(self._catalogue, family)


def endpoint_name(key: int) -> str:
    """A source's host:port."""
    host, port = _endpoint(key)
    return f"{host}:{port}"


def _size(key: int) -> int:
    """The size of a source's datagrams."""
    return key & 0xFFFF


def _endpoint(key: int) -> tuple[str, int]:
    """A source's address, and the port that it sends to."""
    return socket.inet_ntoa((key >> 32).to_bytes(4)), key >> 16 & 0xFFFF


def _catalogued(codec: str, name: str | None = None) -> list[Sensor]:
    """The catalogue's sensors with this codec, or that of this name, if it has this codec."""
    return [load_sensor(one) for one in catalogue(codec) if name in (None, one)]


def _sidecar_files(path: Path, suffix: str) -> Mapping[str, bytes]:
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
