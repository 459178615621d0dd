"""What the capture tests share: a small scene, rigs, and the folder of real recordings."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.ethernet import ethernet_frames
from lidarcfg.capture.pcap import Datagram, read_datagrams, write_pcap
from lidarcfg.clouds.cloud import concatenate
from lidarcfg.packets.codec import Payloads
from lidarcfg.packets.velodyne.layout import POSITION
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.sensors.sensor import Sensor, load_sensor
from lidarcfg.world.scene import Scene, load_scene
from tests.packets.velodyne.shaped import facts, with_facts

STREET = Path(__file__).parents[1] / "data" / "scenes" / "street.yaml"
ROOM = STREET.with_name("room.yaml")  # where nothing moves
AT_NS = 1_700_000_000_123_456_789
PLY = """ply
format ascii 1.0
element vertex {n}
property float x
property float y
property float z
element face {m}
property list uchar int vertex_indices
end_header
"""


def standing_street() -> Scene:
    """The street with everything where it is at time 0."""
    street = load_scene(STREET)
    return replace(street, motions=(None,) * len(street.names))


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


def hdl_64e(name: str) -> Sensor:
    """An HDL-64E with beams of its own: corrections near by, focal distances and limits of intensity too."""
    sensor = load_sensor(name)
    rng = np.random.default_rng(2)

    def table(low: int, high: int, scale: int = 1) -> tuple[float, ...]:
        return tuple((rng.integers(low, high, 64) / scale).tolist())

    far = np.array(table(500, 1500))
    beams = {
        "elevation_deg": tuple((np.array(sensor.beams.elevation_deg) - 0.5).round(2).tolist()),
        "vertical_offset_mm": table(-300, 300),
    }
    calibration = {
        "distance_offset_mm": tuple(far.tolist()),
        "near_x_offset_mm": tuple((far + table(-60, 61)).tolist()),
        "near_y_offset_mm": tuple((far + table(-60, 61)).tolist()),
        "focal_distance_mm": table(0, 20_000),
        "focal_slope": table(0, 25, 10),
        "intensity_min": tuple(rng.integers(0, 60, 64).tolist()),
        "intensity_max": tuple(rng.integers(150, 256, 64).tolist()),
    }
    sensor = sensor.model_copy(update={"beams": sensor.beams.model_copy(update=beams)})
    return with_facts(sensor, calibration=calibration)


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


def room(tmp_path, centre, size=(30.0, 20.0, 8.0)):
    """A closed box around a place, as a scene."""
    return scene(
        tmp_path, f"boxes: [{{name: b, center_m: {[float(c) for c in centre]}, size_m: {list(size)}, reflectivity: 9}}]"
    )


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
    headers = facts(load_sensor("vlp-16")).headers
    numbers = {}
    for datagram in datagrams:
        header = headers.position if len(datagram.payload) == POSITION.itemsize else headers.data
        number = numbers[datagram.host] = numbers.get(datagram.host, -1) + header.numbered
        payload = np.frombuffer(datagram.payload, np.uint8)[None]
        payloads = Payloads(np.array([datagram.time_ns]), payload, datagram.port, headers, header, number)
        yield ethernet_frames(datagram.host, payloads)


def write_datagrams(path, datagrams) -> int:
    """Write a capture of datagrams, and return how many."""
    return write_pcap(path, frames(datagrams))


def datagrams_of(path) -> list[Datagram]:
    """Those of a capture."""
    return list(read_datagrams(path, no_warning))


def no_warning(warning: str) -> None:
    """For captures that must read without a warning."""
    raise AssertionError(warning)


def decoded(path, rig=None, on_warning=no_warning, **options):
    """All points of a capture."""
    return concatenate(list(decode_pcap(path, on_warning, rig, **options)))


def decoded_with_stats(path, on_warning=no_warning, **options):
    """All points of a capture, and what is said of its sources."""
    stats = []
    return decoded(path, on_warning=on_warning, on_stats=stats.append, **options), stats[0]
