"""Point clouds from the data packets in a capture, ours or a real one."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from lidarcfg.capture.firing import firing_facts
from lidarcfg.capture.pcap import Datagram, read_datagrams
from lidarcfg.capture.velodyne import PACKET, decode
from lidarcfg.cloud import PointCloud, concatenate
from lidarcfg.errors import PacketError
from lidarcfg.geometry import Array, transform
from lidarcfg.rig import Rig
from lidarcfg.sensor import Sensor, catalogue, load_sensor

CHUNK_PACKETS = 1024


class _Source:
    """A sensor's stream: decodes what has come, but keeps the last packet until its successor is known."""

    def __init__(self, where: str, sensor: Sensor, index: int, T_cloud_sensor: Array | None, trusted: bool):
        self._where, self._sensor, self._index = where, sensor, index  # where: file and endpoint, for errors
        self._T_cloud_sensor = T_cloud_sensor
        self._product_id = firing_facts(sensor)[1].product_id if trusted else None  # None: any
        self._payloads: list[bytes] = []
        self._times_ns: list[int] = []

    def add(self, datagram: Datagram) -> None:
        """One more packet."""
        self._payloads.append(datagram.payload)
        self._times_ns.append(datagram.time_ns)

    def take(self, names: tuple[str, ...], last: bool) -> PointCloud:
        """What can be decoded now; with `last`, everything. Raises PacketError."""
        packets = np.frombuffer(b"".join(self._payloads), PACKET)
        count = len(packets) if last else max(len(packets) - 1, 0)
        ids = packets["product_id"]
        if self._product_id is not None and (ids != self._product_id).any():
            raise PacketError(
                f"{self._where} sends product id 0x{ids[ids != self._product_id][0]:02X}, not "
                f"{self._sensor.name}'s 0x{self._product_id:02X}; --model says what it is all the same"
            )
        try:
            returns = decode(self._sensor, packets, np.array(self._times_ns, np.int64), count)
        except PacketError as error:
            raise PacketError(f"{self._where}: {error}") from None
        del self._payloads[:count], self._times_ns[:count]
        xyz = returns.xyz_m
        return PointCloud(
            xyz=xyz if self._T_cloud_sensor is None else transform(self._T_cloud_sensor, xyz),
            intensity=returns.intensity,
            ring=self._sensor.ring[returns.laser].astype(np.uint8),  # packets have no more beams
            time_ns=returns.time_ns,
            sensor=np.full(len(xyz), self._index, np.uint16),
            sensor_names=names,
            return_type=returns.return_type,
        )


def decode_pcap(
    path: str | Path,
    on_note: Callable[[str], None],
    rig: Rig | None = None,
    model: str | None = None,
    chunk_packets: int = CHUNK_PACKETS,
) -> Iterator[PointCloud]:
    """The capture's points in clouds of about `chunk_packets` packets; memory does not grow with its length.

    With a rig they are in the vehicle frame and the sensors are its mounts; without, each source (called
    host:port) is in its own sensor's frame, and `sensor_names` grows as sources appear. `model` overrides
    what the product id byte says. `on_note` is told of a file that is cut off. Raises PacketError and
    ConfigError.
    """
    override = load_sensor(model) if model else None
    sources: dict[tuple[str, int], _Source] = {}
    names = tuple(mount.name for mount in rig.mounts) if rig else ()
    others: Counter[int] = Counter()
    waiting = 0
    for datagram in read_datagrams(path, on_note):
        if len(datagram.payload) != PACKET.itemsize:
            others[len(datagram.payload)] += 1
            continue
        endpoint = datagram.host, datagram.port
        if endpoint not in sources:
            where = f"{path}: {datagram.host}:{datagram.port}"
            if rig:
                sources[endpoint] = _mounted(where, datagram, rig, override)
            else:
                sensor = override or _sensor_of(where, datagram)
                sources[endpoint] = _Source(where, sensor, len(names), None, trusted=not override)
                names = (*names, f"{datagram.host}:{datagram.port}")
        sources[endpoint].add(datagram)
        waiting += 1
        if waiting == chunk_packets:
            yield concatenate([source.take(names, last=False) for source in sources.values()])
            waiting = 0
    if not sources:
        sizes = ", ".join(f"{n} of {size} bytes" for size, n in sorted(others.items())[:5])
        found = f"its UDP datagrams: {sizes}" if others else "no UDP datagrams at all"
        raise PacketError(f"{path}: no LiDAR data packets of {PACKET.itemsize} bytes; {found}")
    yield concatenate([source.take(names, last=True) for source in sources.values()])


def _mounted(where: str, datagram: Datagram, rig: Rig, override: Sensor | None) -> _Source:
    """The source as the rig's mount with its address and port."""
    for i, mount in enumerate(rig.mounts):
        if (mount.host, mount.data_port) == (datagram.host, datagram.port):
            return _Source(where, override or mount.sensor, i, mount.T_vehicle_sensor, trusted=not override)
    has = ", ".join(f"{mount.host}:{mount.data_port}" for mount in rig.mounts)
    raise PacketError(f"{where} is not in the rig {rig.name!r}; it has {has}")


def _sensor_of(where: str, datagram: Datagram) -> Sensor:
    """The catalogue's sensor with the product id that the datagram carries."""
    product_id = np.frombuffer(datagram.payload, PACKET)["product_id"][0]
    sensors = [sensor for sensor in map(load_sensor, catalogue()) if sensor.packet]
    for sensor in sensors:
        if sensor.packet and sensor.packet.product_id == product_id:
            return sensor
    known = ", ".join(f"0x{s.packet.product_id:02X} {s.name}" for s in sensors if s.packet)
    raise PacketError(f"{where} sends the unknown product id 0x{product_id:02X}; known: {known}; or give --model")
