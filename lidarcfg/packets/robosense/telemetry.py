"""DIFOP packets, in which a sensor describes itself once a second; returns are decoded with their angles."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.packets.codec import PacketSource, Payloads
from lidarcfg.packets.inertial import measured, samples
from lidarcfg.packets.nmea import fixes
from lidarcfg.packets.robosense.layout import (
    AIRY,
    ANGLE,
    DIFOP_ID,
    DIFOP_TAIL,
    GPS,
    GPS_LOCKED,
    IMU,
    IMU_FULL,
    IMU_HZ,
    IMU_ID,
    IMU_TAIL,
    PTP,
    SIZE,
    UNLOCKED,
    Packets,
    Series,
    bytes_of,
    write_time,
)
from lidarcfg.packets.robosense.model import AiryImu, RobosenseUnit
from lidarcfg.sensors.rig import Mount
from lidarcfg.units import SECOND_NS

if TYPE_CHECKING:
    from lidarcfg.world.geodesy import GeoOrigin
    from lidarcfg.world.motion import Trajectory

SEARCHED = 8192  # packets of a host; one of them should be its DIFOP: 2.7 s of a Helios-32 with dual returns
ANGLE_MAX = 9000  # hundredths of a degree
UNUSED = 0xFF
GPRMC_MAX = 86  # bytes


@dataclass(frozen=True)
class Difop:
    """The contents of a DIFOP packet that decoding needs."""

    elevation_rad: Array  # (L,) by laser, as many as have angles
    azimuth_offset_rad: Array  # (L,)
    return_mode: str  # empty: none that is known
    full_fov: bool  # whether the sensor fires all around
    install_mode: int  # of an Airy, by which its lasers fire

    @property
    def lasers(self) -> int:
        """The number of lasers with angles."""
        return len(self.elevation_rad)


def difop_payloads(
    unit: RobosenseUnit, mount: Mount, trajectory: "Trajectory", origin: "GeoOrigin", start_ns: int, due_ns: range
) -> Iterator[Payloads]:
    """The DIFOP packets of a sensor, the first before anything else and one a second from then on.

    With a clock that GPS sets, they hold the receiver's last sentence, one a second.
    """
    headers = unit.facts.headers
    first, end = (-(-at_ns // SECOND_NS) for at_ns in (due_ns.start, due_ns.stop))
    times_ns = start_ns + np.arange(first, end) * SECOND_NS
    packets = difop_packets(unit, mount, times_ns)
    if mount.clock == "gps":
        at_ns = times_ns // SECOND_NS * SECOND_NS
        sentences = fixes(trajectory, origin, at_ns, np.maximum(at_ns, start_ns))
        packets["gprmc"] = np.array(sentences, f"S{GPRMC_MAX}").view(np.uint8).reshape(len(times_ns), GPRMC_MAX)
    sent_ns = times_ns // 1000 * 1000
    yield Payloads(sent_ns, bytes_of(packets), mount.telemetry_port, headers, headers.difop, first)


def difop_packets(unit: RobosenseUnit, mount: Mount, times_ns: np.ndarray) -> Packets:
    """The DIFOP packets (n,) of these times (n,). Raises ConfigError for angles that they cannot hold."""
    data = np.full((len(times_ns), SIZE), UNUSED, np.uint8)
    series = unit.series
    packets: Packets = data.view(series.difop)[:, 0]
    headers = unit.facts.headers
    host = [int(part) for part in mount.host.split(".")]
    packets["id"] = DIFOP_ID
    packets["tail"] = DIFOP_TAIL
    packets["rpm"] = round(mount.rpm)
    packets["host"] = host
    packets["destination"] = [int(part) for part in (mount.destination or headers.destination_ip).split(".")]
    packets["mac"] = [*bytes.fromhex(headers.mac_prefix.replace(":", "")), *host[1:]]
    packets["serial"] = packets["mac"]
    packets["msop_port"] = mount.data_port
    packets["difop_port"] = mount.telemetry_port
    low, high = mount.azimuth_fov_deg or (0, 360)
    packets["fov"] = round(low * 100), round(high * 100)
    packets["phase"] = round(mount.phase_deg or 0) % 360
    packets["versions"] = list(bytes.fromhex(unit.facts.difop.versions))
    packets["zero"] = 0
    packets["return_mode"] = series.modes[mount.return_mode]
    packets["sync"] = GPS if mount.clock == "gps" else PTP
    packets["sync_state"] = {"gps": GPS_LOCKED, "free": UNLOCKED}.get(mount.clock or "ptp", series.clock_locked)
    write_time(packets, times_ns)
    if series is AIRY:
        packets["install_mode"] = unit.facts.difop.install_mode
        packets["real_rpm"] = packets["rpm"]
        packets["imu_rotation"] = 0, 0, 0, 1
        packets["imu_place"] = 0
        packets["mounting"] = 0  # rs_driver turns points by it, if it is built so
    else:
        packets["gprmc"] = 0
    beams = unit.sensor.beams
    packets["vertical"][:, : unit.count] = angles(unit, "elevation_deg", beams.elevation_deg)
    offset_deg = beams.azimuth_offset_deg or (0.0,) * unit.count
    packets["horizontal"][:, : unit.count] = angles(unit, "azimuth_offset_deg", offset_deg)
    return packets


def imu_payloads(
    unit: RobosenseUnit, imu: AiryImu, mount: Mount, trajectory: "Trajectory", start_ns: int, due_ns: range
) -> Iterator[Payloads]:
    """A packet a measurement, counted from 1: accelerations, gravity included, and rates in the sensor's frame."""
    headers = unit.facts.headers
    for number, time_ns, sent_ns in samples(start_ns, due_ns, SECOND_NS // imu.rate_hz):
        packets: Packets = np.zeros(len(number), IMU)
        packets["id"] = IMU_ID
        packets["tail"] = IMU_TAIL
        write_time(packets, time_ns)
        acceleration_g, rate_deg_s = measured(mount, trajectory, np.zeros(3), time_ns)
        packets["acceleration"] = _counts(acceleration_g, imu.acceleration_g)
        packets["rate"] = _counts(rate_deg_s, imu.rate_deg_s)
        packets["frequency"] = IMU_HZ.index(imu.rate_hz)
        packets["acceleration_range"] = imu.acceleration_g.bit_length() - 2  # 0: 2 g, and so on twice as much
        packets["rate_range"] = (imu.rate_deg_s // 125).bit_length() - 2
        packets["count"] = number + 1
        data = packets.view(np.uint8).reshape(len(packets), IMU.itemsize)
        yield Payloads(sent_ns, data, imu.port, headers, headers.difop, int(number[0]))


def _counts(values: Array, full: int) -> Array:
    return np.clip(np.rint(values / full * IMU_FULL), -IMU_FULL, IMU_FULL - 1)


def angles(unit: RobosenseUnit, key: str, degrees: tuple[float, ...]) -> np.ndarray:
    """(L,) as DIFOP packets say them. Raises ConfigError for what is not in hundredths of a degree, to 90."""
    hundredths = np.rint(np.array(degrees) * 100).astype(np.int64)
    for k in np.flatnonzero((abs(hundredths / 100 - degrees) > 1e-9) | (abs(hundredths) > ANGLE_MAX)):
        what = f"DIFOP packets cannot say {degrees[k]}; allowed: -90 to 90 in hundredths"
        raise ConfigError(f"sensor {unit.name!r}: beams.{key}[{k}]: {what}")
    out = np.empty(len(hundredths), ANGLE)
    out["sign"] = hundredths < 0
    out["hundredths"] = abs(hundredths)
    return out


def find_difop(source: PacketSource, series: Series) -> Difop | None:
    """The DIFOP packet of a source near the capture's start; of several LiDARs behind a host, by the port."""
    others: list[Packets] = []
    seen = 0
    for data in source.payloads(None, SIZE):
        rows = data[: SEARCHED - seen]
        seen += len(rows)
        found = np.ascontiguousarray(rows[(rows[:, :8] == list(DIFOP_ID)).all(axis=1)]).view(series.difop)[:, 0]
        mine = found[found["msop_port"][:, 0] == source.port]
        if len(mine):
            return _read(mine[:1], series)
        others.append(found)
        if seen == SEARCHED:
            break
    together = np.concatenate(others) if others else np.empty(0, series.difop)
    alone = len(np.unique(together["serial"], axis=0)) == 1
    return _read(together[:1], series) if alone else None


def _read(packet: Packets, series: Series) -> Difop:
    """The contents of one packet (1,)."""
    vertical = packet["vertical"][0]
    horizontal = packet["horizontal"][0]
    good = (vertical["sign"] <= 1) & (vertical["hundredths"] <= ANGLE_MAX)
    good &= (horizontal["sign"] <= 1) & (horizontal["hundredths"] <= ANGLE_MAX)
    count = int(np.argmin(np.append(good, False)))
    for fewer in series.lasers:
        if not vertical["hundredths"][fewer:count].any():  # zeros where there is no laser
            count = min(count, fewer)
    if not vertical["hundredths"][:count].any():  # not calibrated
        count = 0
    low, high = packet["fov"][0].tolist()
    elevation, offset = (_radians(column[:count]) for column in (vertical, horizontal))
    mode = series.mode_names.get(int(packet["return_mode"][0]), "")
    return Difop(elevation, offset, mode, high - low >= 36000, int(packet["install_mode"][0]))


def _radians(column: Packets) -> Array:
    sign = np.where(column["sign"] == 1, -1.0, 1.0)
    return np.asarray(np.radians(sign * column["hundredths"] / 100))
