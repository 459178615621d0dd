"""Bags of a LiDAR driver's raw packets as a capture: VelodyneScan, PandarScan, NebulaPackets, Ouster's PacketMsg.

A bag has the payloads of the datagrams, but not who sent them: each topic becomes a sensor with an address of its own.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.capture.ethernet import EthernetFrames, ethernet_frames
from lidarcfg.capture.export import in_time_order
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConversionError
from lidarcfg.files import replacing
from lidarcfg.io.bag_reader import Message, open_bag
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.headers import Header, Network
from lidarcfg.sensors.rig import DATA_PORT, Rig, default_host
from lidarcfg.units import SECOND_NS

SCANS = ("VelodyneScan", "PandarScan", "NebulaPackets")  # each message has the packets of a revolution
PACKET = "PacketMsg"  # and of Ouster's driver one
TEXT = "std_msgs/msg/String"
METADATA = "metadata"  # ends the name of the topic on which Ouster's driver says what the sensor is
INERTIAL = "imu"  # in the name of the topic of Ouster's inertial packets
OUSTER_PORT = 7502
NETWORK = Network(
    source="made up: bags have payloads alone",
    mac_prefix="02:00:00",
    destination_mac="ff:ff:ff:ff:ff:ff",
    destination_ip="255.255.255.255",
)
HEADER = Header(ttl=64, dont_fragment=False, numbered=True, checksum=False)
OnWarning = Callable[[str], None]


def save_packets(output: Path, source: Path, rig: Rig | None, on_warning: OnWarning) -> int:
    """Write the packets in a bag as a pcap, whole or not at all, and return their number.

    What an Ouster's driver said of its sensor is written beside it, as NAME-TOPIC.json. A topic is the mount of `rig`
    that the messages' frame or a part of the topic's name is called after; `on_warning` gets the addresses. Raises
    ConversionError if there are no packets.
    """
    with open_bag(source) as bag:
        kinds = {topic: kind.rsplit("/", 1)[-1] for topic, kind in sorted(bag.topics.items())}
        texts = [topic for topic, kind in bag.topics.items() if kind == TEXT and topic.endswith(METADATA)]
        said = {message.topic: str(message.value.data) for message in bag.messages(*texts)}
    topics = [topic for topic, kind in kinds.items() if kind in SCANS or kind == PACKET]
    if not topics:
        known = ", ".join((*SCANS, PACKET))
        raise ConversionError(f"{source}: has no packets of a driver; allowed: {known}; it has {_listed(kinds)}")
    addresses = _addresses(source, topics, kinds, rig)
    for topic, (host, port) in addresses.items():
        on_warning(f"{source}: {topic} is {host}:{port}")
    streams = (_stream(source, topic, kinds[topic], *address) for topic, address in addresses.items())
    count = write_pcap(output, in_time_order(streams))
    for topic, text in said.items():
        with replacing(output.with_name(f"{output.stem}-{_plain(topic)}.json")) as file:
            file.write(text)
    return count


@contextmanager
def packets_of(source: Path, rig: Rig | None, on_warning: OnWarning) -> Iterator[Path]:
    """The packets in a bag as a temporary pcap. Raises ConversionError."""
    with TemporaryDirectory(prefix="lidarcfg-") as folder:
        path = Path(folder) / f"{_plain(source.stem)}.pcap"
        save_packets(path, source, rig, on_warning)
        yield path


def _addresses(source: Path, topics: list[str], kinds: dict[str, str], rig: Rig | None) -> dict[str, tuple[str, int]]:
    """The address and the port of each topic's sensor; an Ouster's two topics have one address."""
    mounts = {mount.name: mount for mount in rig.mounts} if rig else {}
    hosts: dict[str, str] = {}
    found = {}
    for topic in topics:
        inertial = kinds[topic] == PACKET and INERTIAL in topic.rsplit("/", 1)[-1]
        names = [_frame(source, topic, kinds[topic]), *topic.split("/")]
        mount = next((mounts[name] for name in names if name in mounts), None)
        sensor = topic.rsplit("/", 1)[0] if kinds[topic] == PACKET else topic
        if mount:
            found[topic] = mount.host, mount.telemetry_port if inertial else mount.data_port
            continue
        host = hosts.setdefault(sensor, default_host(len(hosts)) or "")
        if not host:
            raise ConversionError(f"{source}: has packets of more than {len(hosts) - 1} sensors")
        found[topic] = host, OUSTER_PORT + inertial if kinds[topic] == PACKET else DATA_PORT
    return found


def _frame(source: Path, topic: str, kind: str) -> str:
    """The frame of a topic's messages; empty if they have none."""
    if kind == PACKET:
        return ""
    with open_bag(source) as bag:
        first = next(bag.messages(topic), None)
    return str(first.value.header.frame_id).strip("/") if first else ""


def _stream(source: Path, topic: str, kind: str, host: str, port: int) -> Iterator[EthernetFrames]:
    """The packets of a topic as frames, in the order of time. A bag is opened for each: they are read side by side."""
    number = 0
    last_ns = 0
    with open_bag(source) as bag:
        for message in bag.messages(topic):
            for _, alike in groupby(_packets(message, kind), key=lambda packet: len(packet[1])):
                times_ns, data = zip(*alike, strict=True)
                time_ns = np.maximum.accumulate(np.maximum(np.array(times_ns), last_ns))
                yield ethernet_frames(host, Payloads(time_ns, np.stack(data), port, NETWORK, HEADER, number))
                number += len(time_ns)
                last_ns = int(time_ns[-1])


def _packets(message: Message, kind: str) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The times and the payloads of a message's packets."""
    value = message.value
    if kind == PACKET:
        yield message.time_ns, np.asarray(value.buf, np.uint8)
        return
    for packet in value.packets:
        stamp_ns = _stamp_ns(packet.stamp)
        data = np.asarray(packet.data, np.uint8)
        yield stamp_ns or message.time_ns, data[: getattr(packet, "size", len(data))]


def _stamp_ns(stamp: Any) -> int:
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.-]+", "_", name.strip("/"))


def _listed(kinds: dict[str, str]) -> str:
    return ", ".join(f"{topic} ({kind})" for topic, kind in kinds.items()) or "no topics"
