"""Captures of random returns, and what velodyne-decoder makes of a capture."""

import numpy as np
import velodyne_decoder as vd

from lidarcfg.capture.pcap import Datagram
from lidarcfg.sensors.sensor import load_sensor
from tests.capture_fixtures import AT_NS
from tests.capture_fixtures import write_datagrams as write_pcap
from tests.packets.velodyne.shaped import encode, firings, packet_stamps_ns

OTHERS = {
    "vlp-16": vd.Model.VLP16,
    "puck-lite": vd.Model.PuckLite,
    "puck-hi-res": vd.Model.PuckHiRes,
    "vlp-32c": vd.Model.VLP32C,
    "hdl-32e": vd.Model.HDL32E,
    "vls-128": vd.Model.VLS128,
    "hdl-64e-s2": vd.Model.HDL64E_S2,
    "hdl-64e-s3": vd.Model.HDL64E_S3,
}
MODES = ["strongest", "last", "dual"]


def sent(name, mode, packets=60, rpm=600.0, start_ns=AT_NS):
    """Packets of random ranges, and what was fired and met."""
    sensor = load_sensor(name)
    dual = mode == "dual"
    fired = firings(sensor, rpm, start_ns, range(packets), dual)
    rng = np.random.default_rng(7)
    low = max(sensor.range.min_m, 2.0)
    range_m = rng.uniform(low, 100, (*fired.time_ns.shape, 2) if dual else fired.time_ns.shape)
    reflectivity = rng.integers(1, 256, range_m.shape, np.uint8)
    if dual:  # the last return is the furthest, and often the only one
        range_m.sort(axis=-1)
        one = rng.random(fired.time_ns.shape) < 0.5
        range_m[one, 0] = range_m[one, 1]
        reflectivity[one, 0] = reflectivity[one, 1]
    range_m[rng.random(fired.time_ns.shape) < 0.1] = np.inf
    return sensor, encode(sensor, mode, fired, range_m, reflectivity), fired, range_m, reflectivity


def write(path, sensor, packets, fired, host="192.168.1.201", port=2368):
    """The packets as a capture, each when it is complete."""
    _, ends_ns = packet_stamps_ns(sensor, fired)
    datagrams = [
        Datagram(int(end_ns) // 1000 * 1000, host, port, port, packet.tobytes())
        for packet, end_ns in zip(packets, ends_ns, strict=True)
    ]
    write_pcap(path, datagrams)
    return datagrams


def elsewhere(path, model, calibration=None):
    """Points (N, 3), times, intensities, rings and labels by velodyne-decoder."""
    config = vd.Config()
    config.model = model
    config.min_range = 0
    config.max_range = 1000
    if calibration:
        config.calibration = calibration
    scans = list(vd.read_pcap(str(path), config))
    points = np.concatenate([points for _, points in scans])
    time_s = np.concatenate([stamp.device + points[:, 4].astype(np.float64) for stamp, points in scans])
    return points[:, :3], time_s, points[:, 3], points[:, 6], points[:, 7]


def calibrating(sensor, mode="strongest"):
    """Packets that carry the sensor's whole calibration: 4160, most of them empty."""
    fired = firings(sensor, 600, AT_NS, range(4160))
    range_m = np.full(fired.time_ns.shape, np.inf, np.float32)
    range_m[:20] = np.random.default_rng(1).uniform(2, 60, range_m[:20].shape)
    return encode(sensor, mode, fired, range_m, np.full(range_m.shape, 9, np.uint8)), fired


def agree(ours, xyz, time_s, intensity, ring, slow_s, unturned_ns=0):
    """Point for point; before `unturned_ns` the other decoder does not know yet how fast the head turns."""
    assert len(ours.xyz) == len(xyz)
    mine = order(ours.xyz, ours.ring, ours.time_ns / 1e9)
    theirs = order(xyz, ring, time_s)
    a, b = ours.xyz[mine], xyz[theirs]
    far = np.linalg.norm(a, axis=1)
    time_ns = ours.time_ns[mine]
    turned = np.where(time_ns < unturned_ns, 0.16, 0.026)
    assert (np.linalg.norm(a - b, axis=1) <= 2e-4 + far * np.radians(turned)).all()
    assert abs(a[:, 2] - b[:, 2]).max() < 2e-4
    assert abs(far - np.linalg.norm(b, axis=1)).max() < 5e-4
    assert abs(time_s[theirs] - time_ns / 1e9).max() < slow_s
    assert abs(intensity[theirs] - ours.intensity[mine].astype(float)).max() <= 0.5 + 1e-4  # ours are whole
    assert (ring[theirs] == ours.ring[mine]).all()


def order(xyz, ring, time_s):
    """By ring, then firing (a ring fires once in 46 µs at most), then distance."""
    by_time = np.lexsort((time_s, ring))
    apart = (np.diff(ring[by_time].astype(int)) != 0) | (np.diff(time_s[by_time]) > 20e-6)
    fired = np.empty(len(xyz), int)
    fired[by_time] = np.append(0, np.cumsum(apart))
    return np.lexsort((np.linalg.norm(xyz, axis=1), fired))
