"""What the capture tests share: a small scene, rigs, and the folder of real recordings."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.pcap import Datagram, Sender, read_datagrams, write_pcap
from lidarcfg.capture.scene import Scene, load_scene
from lidarcfg.capture.velodyne import POSITION
from lidarcfg.rig import Mount, Rig
from lidarcfg.sensor import load_sensor

STREET = Path(__file__).parent.parent / "data" / "scenes" / "street.yaml"
AT_NS = 1_700_000_000_123_456_789


def mount(index: int = 0, position_m=(0.0, 0.0, 2.0), rpy_deg=(0.0, 0.0, 0.0), rpm: float = 600.0) -> Mount:
    """A VLP-16 with an address of its own."""
    return Mount(
        name=f"lidar_{index}",
        sensor=load_sensor("vlp-16"),
        position_m=position_m,
        rpy_rad=tuple(float(a) for a in np.radians(rpy_deg)),
        model="vlp-16",
        host=f"192.168.1.{201 + index}",
        data_port=2368,
        telemetry_port=8308,
        rpm=rpm,
        return_mode="strongest",
    )


def tilted_rig() -> Rig:
    """Two sensors that lean and turn at different speeds."""
    left = mount(0, (0.3, 0.5, 2.0), (5.0, 3.0, 20.0), 600.0)
    right = mount(1, (0.3, -0.5, 1.9), (-8.0, 2.0, -30.0), 660.0)
    return Rig("tilted", (left, right))


def alone(rig: Rig, index: int) -> Rig:
    """The rig with one of its sensors."""
    return replace(rig, mounts=(rig.mounts[index],))


def scene(tmp_path: Path, text: str) -> Scene:
    """The scene that a YAML text says."""
    path = tmp_path / "scene.yaml"
    path.write_text(f"name: test\n{text}\n")
    return load_scene(path)


def recording(name: str) -> Path:
    """A real recording, or skip."""
    folder = os.environ.get("LIDARCFG_CAPTURES")
    if not folder:
        pytest.skip("LIDARCFG_CAPTURES names no folder of recordings")
    path = Path(folder) / name
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    return path


def frames(datagrams):
    """Datagrams as a VLP-16 frames them, one by one; position packets are numbered, those of each sender alone."""
    headers, numbers = load_sensor("vlp-16").headers, {}
    for datagram in datagrams:
        header = headers.position if len(datagram.payload) == POSITION.itemsize else headers.data
        number = numbers[datagram.host] = numbers.get(datagram.host, -1) + header.numbered
        payload = np.frombuffer(datagram.payload, np.uint8)[None]
        yield Sender(headers, header, datagram.host, datagram.port).frames(
            np.array([datagram.time_ns]), payload, number
        )


def write_datagrams(path, datagrams) -> int:
    """Write a capture of datagrams, and return how many."""
    return write_pcap(path, frames(datagrams))


def datagrams_of(path) -> list[Datagram]:
    """Those of a capture."""
    return list(read_datagrams(path, no_note))


def no_note(note: str) -> None:
    """For captures that must read without a note."""
    raise AssertionError(note)
