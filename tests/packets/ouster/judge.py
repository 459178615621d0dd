"""What ouster-sdk reads in a capture, which is not ours."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.capture_fixtures import datagrams_of

core = pytest.importorskip("ouster.sdk.core", reason="ouster-sdk is not installed")

NAMES = {
    "range": "RANGE",
    "range2": "RANGE2",
    "reflectivity": "REFLECTIVITY",
    "reflectivity2": "REFLECTIVITY2",
    "signal": "SIGNAL",
    "signal2": "SIGNAL2",
    "near_ir": "NEAR_IR",
    "flags": "FLAGS",
    "flags2": "FLAGS2",
    "window": "WINDOW",
    "zones": "ZONE_MASK",
    "red": "R",
    "green": "G",
    "blue": "B",
}


@dataclass(frozen=True)
class Judged:
    """Everything that ouster-sdk finds in the lidar packets of one sensor."""

    info: object
    packets: np.ndarray  # (P, size)
    host_ns: np.ndarray  # (P,)
    frame: np.ndarray  # (P,)
    time_ns: np.ndarray  # (P, C)
    measurement: np.ndarray  # (P, C)
    valid: np.ndarray  # (P, C)
    fields: dict  # (P, C, L) by our names
    crc_right: list  # (P,) None where the profile has none
    init: np.ndarray
    serial: np.ndarray
    alerts: np.ndarray

    def points(self, key: str = "range") -> np.ndarray:
        """(P, C, L, 3) in the sensor frame; NaN where there is no return."""
        lut = core.XYZLut(self.info)
        ranges = self.fields[key]
        out = np.full((*ranges.shape, 3), np.nan)
        for p in range(len(ranges)):
            image = np.zeros((ranges.shape[2], self.info.format.columns_per_frame), np.uint32)
            good = self.valid[p] & (self.measurement[p] < image.shape[1])
            image[:, self.measurement[p][good]] = ranges[p][good].T
            xyz = lut(image)[:, self.measurement[p][good]].transpose(1, 0, 2)
            out[p, good] = np.where(ranges[p][good][..., None] > 0, xyz, np.nan)
        return out


def judged(pcap: Path, metadata: Path) -> Judged:
    """The lidar packets of the metadata's sensor."""
    info = core.SensorInfo(metadata.read_text())
    form = core.PacketFormat.from_info(info)
    datagrams = [one for one in datagrams_of(pcap) if len(one.payload) == form.lidar_packet_size]
    packets = np.array([np.frombuffer(one.payload, np.uint8) for one in datagrams])
    bodies = []
    for payload in packets:
        packet = core.LidarPacket(form)
        packet.buf[:] = payload
        bodies.append(packet)
    there = set(form.fields)

    def header(kind):
        return np.array([form.packet_header(kind, one.buf) for one in bodies])

    return Judged(
        info=info,
        packets=packets,
        host_ns=np.array([one.time_ns for one in datagrams]),
        frame=np.array([form.frame_id(one.buf) for one in bodies]),
        time_ns=header(core.ColHeader.TIMESTAMP).astype(np.int64),
        measurement=header(core.ColHeader.MEASUREMENT_ID).astype(np.int64),
        valid=header(core.ColHeader.STATUS).astype(np.int64) & 1 == 1,
        fields={
            ours: np.array([form.packet_field(theirs, one.buf).T for one in bodies])
            for ours, theirs in NAMES.items()
            if theirs in there
        },
        crc_right=[form.crc(one.buf) == form.calculate_crc(one.buf) for one in bodies],
        init=np.array([form.init_id(one.buf) for one in bodies]),
        serial=np.array([form.prod_sn(one.buf) for one in bodies]),
        alerts=np.array([form.alert_flags(one.buf) for one in bodies]),
    )


def config(metadata: Path) -> dict:
    """What a metadata file says, unread."""
    return dict(json.loads(metadata.read_text()))
