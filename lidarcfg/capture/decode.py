"""Point clouds from the data packets in a capture, ours or a real one."""

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from lidarcfg.capture.pcap import Datagram, read_datagrams
from lidarcfg.capture.source import Source, SourceStats
from lidarcfg.capture.status import carried_beams
from lidarcfg.capture.velodyne import PACKET
from lidarcfg.cloud import PointCloud, concatenate
from lidarcfg.errors import PacketError
from lidarcfg.rig import Rig
from lidarcfg.sensor import Beams, Sensor, Status, load_sensor

CHUNK_PACKETS = 1024
CARRIED_PACKETS = 3 * 4160  # a calibration in status bytes takes 4160 packets: one of three should be whole

Endpoint = tuple[str, int]


def decode_pcap(
    path: str | Path,
    on_note: Callable[[str], None],
    rig: Rig | None = None,
    model: str | None = None,
    chunk_packets: int = CHUNK_PACKETS,
    on_stats: Callable[[SourceStats], None] | None = None,
) -> Iterator[PointCloud]:
    """The capture's points in clouds of about `chunk_packets` packets; memory does not grow with its length.

    With a rig they are in the vehicle frame and the sensors are its mounts; without, each source (called
    host:port) is in its own sensor's frame, and `sensor_names` grows as sources appear. `model` overrides
    what the product id byte says. `on_note` is told of a file that is cut off, `on_stats` at the end of each
    source. Raises PacketError and ConfigError.
    """
    override = load_sensor(model) if model else None
    sources: dict[Endpoint, Source] = {}
    names = tuple(mount.name for mount in rig.mounts) if rig else ()
    others: Counter[int] = Counter()
    waiting = 0
    for datagram in read_datagrams(path, on_note):
        if len(datagram.payload) != PACKET.itemsize:
            others[len(datagram.payload)] += 1
            continue
        endpoint = datagram.host, datagram.port
        if endpoint not in sources:
            sources[endpoint] = _source(path, datagram, rig, override, len(names), on_note)
            names = names if rig else (*names, f"{datagram.host}:{datagram.port}")
        sources[endpoint].add(datagram)
        waiting += 1
        if waiting == chunk_packets:
            yield _taken(sources, names, last=False)
            waiting = 0
    if not sources:
        sizes = ", ".join(f"{n} of {size} bytes" for size, n in sorted(others.items())[:5])
        found = f"its UDP datagrams: {sizes}" if others else "no UDP datagrams at all"
        raise PacketError(f"{path}: no LiDAR data packets of {PACKET.itemsize} bytes; {found}")
    yield _taken(sources, names, last=True)
    if on_stats:
        for source in sources.values():
            on_stats(source.stats())


def _taken(sources: dict[Endpoint, Source], names: tuple[str, ...], last: bool) -> PointCloud:
    """What all sources have, as one cloud."""
    clouds = [cloud for source in sources.values() if (cloud := source.take(names, last))]
    return clouds[0] if len(clouds) == 1 else concatenate([PointCloud.none(names), *clouds])


def _source(
    path: str | Path,
    datagram: Datagram,
    rig: Rig | None,
    override: Sensor | None,
    index: int,
    on_note: Callable[[str], None],
) -> Source:
    """The datagram's source: with a rig the mount with its address and port, else one of its own."""
    name = f"{datagram.host}:{datagram.port}"
    where, trusted, carried = f"{path}: {name}", override is None, partial(_carried, path, datagram)
    if rig is None:
        return Source(where, name, index, override, None, trusted, carried, on_note)
    for i, mount in enumerate(rig.mounts):
        if (mount.host, mount.data_port) == (datagram.host, datagram.port):
            sensor = override or mount.sensor
            return Source(where, mount.name, i, sensor, mount.T_vehicle_sensor, trusted, carried, on_note)
    has = ", ".join(f"{mount.host}:{mount.data_port}" for mount in rig.mounts)
    raise PacketError(f"{where} is not in the rig {rig.name!r}; it has {has}")


def _carried(path: str | Path, first: Datagram, status: Status) -> tuple[Beams, str] | None:
    """The beams and mode of single returns that status bytes carry, in the packets of one source."""
    mine = (
        datagram.payload
        for datagram in read_datagrams(path, lambda note: None)
        if (datagram.host, datagram.port) == (first.host, first.port) and len(datagram.payload) == PACKET.itemsize
    )
    packets = np.frombuffer(b"".join(islice(mine, CARRIED_PACKETS)), PACKET)
    return carried_beams(status, packets["return_mode"], packets["product_id"])
