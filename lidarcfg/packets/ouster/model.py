"""What an Ouster's packets depend on: facts in its file, a mount's settings; and when each column is measured.

Both are keys `ouster`, of a sensor's file and of a mount in a rig's file.
"""

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from lidarcfg.config.models import Model
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Flags, Times
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.ouster.layout import PROFILES, Layout
from lidarcfg.packets.sensor_unit import SensorUnit
from lidarcfg.sensors.firing import FiringBatch, Firings
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Millimetres, Sensor
from lidarcfg.units import SECOND_NS

ProfileName = Literal[
    "LEGACY",
    "RNG19_RFL8_SIG16_NIR16",
    "RNG19_RFL8_SIG16_NIR16_DUAL",
    "RNG19_RFL8_SIG16_NIR16_ZONE16",
    "RNG19_RFL8_SIG16_ZONE16_DUAL",
    "RNG19_RFL8_SIG16_NIR16_RGB16",
    "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL",
    "RNG15_RFL8_NIR8",
    "RNG15_RFL8_WIN8",
    "RNG15_RFL8_NIR8_ZONE16",
    "RNG15_RFL8_NIR8_DUAL",
    "FUSA_RNG15_RFL8_NIR8_DUAL",
]
Firmware = Literal["2.3", "3.2", "4.0"]
SINGLE = "RNG19_RFL8_SIG16_NIR16"
DUAL = "RNG19_RFL8_SIG16_NIR16_DUAL"
SINCE_2 = ("LEGACY", SINGLE, DUAL, "RNG15_RFL8_NIR8")  # profiles; the others are since 3.2
RPM = (600.0, 1200.0)
SERIAL_FIRST = 122_000_000_000
SERIALS = 10**9
LASERS_MAX = 256
DATAGRAM_MAX = 65_507  # bytes that a UDP datagram holds
IMU_PACKETS_HZ = 80  # this and the next as metadata of firmware 3.2 at 10 Hz has them
IMU_MEASUREMENTS = 8  # in a packet


class Imu(Model):
    """The inertial unit."""

    source: str = ""
    position_mm: tuple[Millimetres, Millimetres, Millimetres]  # in the sensor's frame


class Signal(Model):
    """How many photons the sensor counts."""

    source: str = ""
    scale: Annotated[float, Field(gt=0, le=1e9)]  # × reflectivity byte / range² in metres: what the packets say


class Product(Model):
    """What metadata calls the sensor."""

    source: str = ""
    line: Annotated[str, Field(min_length=1)]
    number: Annotated[str, Field(min_length=1)]
    firmware: Annotated[tuple[Firmware, ...], Field(min_length=1)] = ("2.3", "3.2")  # that it runs; first the default

    @property
    def coloured(self) -> bool:
        """Whether it sees colours, which its product line says: OS-1-MAX-256-RGB."""
        return "RGB" in self.line.split("-")


class OusterHeaders(Network):
    """The network headers of the sensor's datagrams."""

    data: Header
    imu: Header


class OusterFacts(Model):
    """The key `ouster` of a sensor's file."""

    imu: Imu
    signal: Signal
    product: Product
    headers: OusterHeaders


class OusterSettings(Model):
    """The key `ouster` of a mount in a rig's file."""

    profile: ProfileName | None = None  # none: the single or the dual one of 19 bits, by return_mode
    columns: Literal[512, 1024, 2048] = 1024
    columns_per_packet: Literal[8, 16] | None = None  # none: 16 if a datagram holds as many
    firmware: Firmware | None = None  # none: the first that the sensor's file names
    fragments: bool = True  # whether datagrams above the MTU leave as IP fragments, as a sensor sends them
    imu: bool = True
    imu_profile: Literal["LEGACY", "ACCEL32_GYRO32_NMEA"] = "LEGACY"


class OusterUnit(SensorUnit[OusterFacts]):
    """A sensor with the facts of its packets."""

    @property
    def start_mm(self) -> tuple[float, float]:
        """Where all beams start: ahead of the axis, and above the sensor's origin."""
        beams = self.sensor.beams
        return (beams.forward_offset_mm or (0.0,))[0], (beams.vertical_offset_mm or (0.0,))[0]


@dataclass(frozen=True)
class Mode:
    """How a mount's sensor sends."""

    layout: Layout
    settings: OusterSettings
    firmware: Firmware
    rpm: float
    window: tuple[int, int]  # first and last column that is measured, clockwise
    serial: int
    init: int

    @property
    def revolution_ns(self) -> int:
        """Of the head."""
        return round(60e9 / self.rpm)

    @property
    def period_ns(self) -> int:
        """From one packet to the next."""
        return self.revolution_ns // self.layout.packets_per_frame

    @property
    def imu_packets(self) -> int:
        """In a revolution, of profile ACCEL32_GYRO32_NMEA: the rate of measurements is the same at 10 and 20 Hz."""
        return round(IMU_PACKETS_HZ * self.revolution_ns / SECOND_NS)

    @property
    def nearest_first(self) -> bool:
        """Whether the nearer of two returns comes first, which firmware 3 can be told; else the stronger."""
        return self.modern

    @property
    def modern(self) -> bool:
        """Whether packets carry checksums and alerts."""
        return self.firmware != "2.3"


@lru_cache(64)
def unit(sensor: Sensor) -> OusterUnit:
    """The sensor with the key `ouster` of its file. Raises ConfigError with file, line and key."""
    facts = sensor.section.checked(OusterFacts)
    if sensor.count > LASERS_MAX:
        raise ConfigError(
            f"sensor {sensor.name!r} has {sensor.count} beams; allowed with Ouster's packets: {LASERS_MAX}"
        )
    for key in ("forward_offset_mm", "vertical_offset_mm", "lateral_offset_mm"):
        values = set(getattr(sensor.beams, key)) or {0.0}
        if len(values) > 1 or (key == "lateral_offset_mm" and values != {0.0}):
            allowed = "none" if key == "lateral_offset_mm" else "the same of all beams"
            raise ConfigError(f"sensor {sensor.name!r}: beams.{key}: allowed with Ouster's packets: {allowed}")
    return OusterUnit(sensor, facts)


def mode(sensor: Sensor, mount: Mount) -> Mode:
    """How a mount's sensor sends. Raises ConfigError for what it cannot."""
    settings = mount.settings.checked(OusterSettings)
    product = unit(sensor).facts.product
    if mount.return_mode not in ("strongest", "dual"):
        raise ConfigError(f"return_mode: {mount.return_mode!r} is not allowed; an Ouster sends the strongest, or dual")
    dual = mount.return_mode == "dual"
    name = settings.profile or (DUAL if dual else SINGLE)
    profile = PROFILES[name]
    if (profile.returns == 2) != dual:
        needed = "strongest" if dual else "dual"
        raise mount.settings.error(("profile",), f"{name} needs return_mode: {needed}")
    firmware = settings.firmware or product.firmware[0]
    if firmware not in product.firmware:
        allowed = " or ".join(repr(one) for one in product.firmware)
        raise mount.settings.error(("firmware",), f"{firmware!r} does not run on {sensor.name}; allowed: {allowed}")
    if name not in SINCE_2 and firmware == "2.3":
        raise mount.settings.error(("profile",), f'{name} needs firmware: "3.2"')
    if "red" in profile.fields and not product.coloured:
        raise mount.settings.error(("profile",), f"{name} needs a sensor that sees colours; {sensor.name} does not")
    if settings.imu_profile != "LEGACY" and (firmware == "2.3" or name == "LEGACY" or profile.fusa):
        needed = 'firmware: "3.2", and another profile than LEGACY and FUSA'
        raise mount.settings.error(("imu_profile",), f"{settings.imu_profile} needs {needed}")
    if mount.rpm not in RPM:
        raise ConfigError(f"rpm: {mount.rpm:g} is not allowed; an Ouster turns at 600 or 1200")
    if settings.columns == 2048 and mount.rpm != 600:
        raise mount.settings.error(("columns",), "2048 needs rpm: 600")
    identity = zlib.crc32(mount.name.encode())
    return Mode(
        layout=_layout(name, sensor, mount, settings),
        settings=settings,
        firmware=firmware,
        rpm=mount.rpm,
        window=_window(mount.azimuth_fov_deg, settings.columns),
        serial=SERIAL_FIRST + identity % SERIALS,
        init=identity % (1 << 24),
    )


def _layout(name: str, sensor: Sensor, mount: Mount, settings: OusterSettings) -> Layout:
    """Of packets that a datagram holds. Raises ConfigError if there is none."""
    for columns in (settings.columns_per_packet,) if settings.columns_per_packet else (16, 8):
        layout = Layout(name, sensor.count, settings.columns, columns, PROFILES[name].fusa)
        if layout.size <= DATAGRAM_MAX:
            return layout
    what = f"{columns} columns of {name} are {layout.size} bytes; allowed in a datagram: {DATAGRAM_MAX}"
    raise mount.settings.error(("columns_per_packet",), what)


def _window(fov_deg: tuple[float, float] | None, count: int) -> tuple[int, int]:
    """First and last of the columns that point into a field of view. Raises ConfigError if none does."""
    if fov_deg is None or abs(fov_deg[1] - fov_deg[0]) == 360:
        return 0, count - 1
    low, high = (((angle - 180) / 360 * count) for angle in fov_deg)
    width = (high - low) % count
    first = int(np.ceil(round(low, 9)))
    last = int(np.floor(round(low + width, 9)))
    if last < first:
        raise ConfigError(f"azimuth_fov_deg: no column is within {fov_deg[0]:g} to {fov_deg[1]:g}")
    return first % count, last % count


def batches(mode: Mode, start_ns: int, spans: Iterable[range], phase_deg: float | None) -> Iterator[FiringBatch]:
    """The firings in the time of successive packets, a batch for each span of their numbers.

    The first packet begins with column 0, which points backwards; with a phase lock, with the column that is due.
    Packets without a column in the azimuth window are not sent. Packet numbers count from the start of the first
    revolution.
    """
    zero_ns, first = phase(mode, start_ns, phase_deg)
    sent = 0  # as IP counts them: from the first one's number on
    for span in spans:
        begin_ns, end_ns = (start_ns + at * mode.period_ns for at in (span.start, span.stop))
        number = np.arange(first + max(span.start - 1, 0), first + span.stop)
        number = number[in_window(mode, measurements(mode, number)).any(axis=1)]
        done_ns = column_times_ns(mode, zero_ns, number + 1)[:, 0]
        within = (done_ns > begin_ns) & (done_ns <= end_ns)  # with a phase lock packets are complete a little later
        number, done_ns = number[within], done_ns[within]
        time_ns = column_times_ns(mode, zero_ns, number)
        sent = sent or int(number[:1].sum())
        yield FiringBatch(_firings(mode, number, time_ns), number, (done_ns + 500) // 1000 * 1000, first=sent)
        sent += len(number)


def measurements(mode: Mode, number: Times) -> Times:
    """(P, C): the columns of packets with these numbers (P,)."""
    per_packet = mode.layout.columns_per_packet
    return np.asarray((number * per_packet)[:, None] % mode.layout.columns_per_frame + np.arange(per_packet))


def in_window(mode: Mode, measurement: Times) -> Flags:
    """Which columns, numbered in any shape, are in the azimuth window and so measured."""
    first, last = mode.window
    count = mode.layout.columns_per_frame
    return np.asarray((measurement - first) % count <= (last - first) % count)


def column_times_ns(mode: Mode, zero_ns: int, number: Times) -> Times:
    """(P, C) when the columns of packets with these numbers (P,) are measured; the first one of all at `zero_ns`."""
    per_packet = mode.layout.columns_per_packet
    revolution, packet = np.divmod(number, mode.layout.packets_per_frame)
    column = (packet * per_packet)[:, None] + np.arange(per_packet)
    begun_ns = zero_ns + revolution * mode.revolution_ns
    return np.asarray(begun_ns[:, None] + column * mode.revolution_ns // mode.layout.columns_per_frame)


def phase(mode: Mode, start_ns: int, phase_deg: float | None) -> tuple[int, int]:
    """When the first revolution begins, and the number of the first packet not before the start."""
    if phase_deg is None:
        return start_ns, 0
    ahead_ns = round((phase_deg - 180) % 360 / 360 * mode.revolution_ns)  # since column 0, at each whole second
    into_ns = (start_ns % SECOND_NS + ahead_ns) % mode.revolution_ns
    return start_ns - into_ns, -(-into_ns // mode.period_ns)


def _firings(mode: Mode, number: Times, time_ns: Times) -> Firings:
    """All lasers of a column fire at the same time."""
    lasers = mode.layout.pixels
    count = mode.layout.columns_per_frame
    turned = (measurements(mode, number) / count + 0.5) % 1
    return Firings(
        time_ns=np.repeat(time_ns.ravel(), lasers),
        laser=np.tile(np.arange(lasers, dtype=np.uint8), time_ns.size),
        encoder_rad=np.repeat(turned.ravel() * (2 * np.pi), lasers),
    )
