"""The key `velodyne` of a sensor's file and of a mount: the layout of packets, timing, corrections."""

from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from lidarcfg.config.models import Model, Positive, validation_error
from lidarcfg.errors import has_values
from lidarcfg.geometry import Array, Times
from lidarcfg.packets.headers import Header, Network
from lidarcfg.packets.sensor_unit import SensorUnit, SequenceFiring, check_firing
from lidarcfg.packets.velodyne.layout import BLOCKS, RETURNS, SLOTS, Packets, PpsState
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.schedule import FiringSchedule
from lidarcfg.sensors.sensor import Byte, Millimetres, Sensor, check_lengths

# How many blocks one firing of all lasers may take: a packet holds a whole number of them, and no fewer than two
# (one with dual returns). So at most 192 beams have packets, and a byte holds laser and ring.
GROUP_BLOCKS = tuple(n for n in range(1, BLOCKS) if BLOCKS % n == 0)
Word = Annotated[int, Field(ge=0, le=65535)]
Return = Literal["strongest", "last"]


class Calibration(Model):
    """The corrections of distances and intensities by laser id; a missing table corrects nothing."""

    distance_offset_mm: tuple[Millimetres, ...] = ()  # added to what the packet says
    near_x_offset_mm: tuple[Millimetres, ...] = ()  # instead of it, at 2.4 m to the side
    near_y_offset_mm: tuple[Millimetres, ...] = ()  # instead of it, at 1.93 m ahead
    focal_distance_mm: tuple[Millimetres, ...] = ()  # where intensities are right as they come
    focal_slope: tuple[float, ...] = ()  # by how much they are raised elsewhere
    intensity_min: tuple[Byte, ...] = ()  # after that
    intensity_max: tuple[Byte, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> "Calibration":
        if bool(self.near_x_offset_mm) != bool(self.near_y_offset_mm):
            raise validation_error(
                "stand without the other; give both or neither of near_x_offset_mm and near_y_offset_mm"
            )
        focal = [bool(v) for v in (self.focal_distance_mm, self.focal_slope, self.intensity_min, self.intensity_max)]
        if len(set(focal)) > 1:
            raise validation_error("stand without each other; give all or none of focal_* and intensity_*")
        return self


class ReturnModes(Model):
    """The codes in the packet's return mode byte, of those modes that the sensor has."""

    strongest: Byte | None = None
    last: Byte | None = None
    dual: Byte | None = None

    @model_validator(mode="after")
    def _check(self) -> "ReturnModes":
        if not self.codes:
            raise validation_error("is empty; give the code of strongest, last or dual")
        return self

    @property
    def codes(self) -> dict[str, int]:
        """By mode."""
        return {mode: code for mode, code in self if code is not None}


class Dual(Model):
    """Where a packet with dual returns has its blocks: all blocks of a sequence stand in it twice."""

    source: str = ""
    order: Annotated[tuple[Return, Return], Field(min_length=2, max_length=2)]  # the first block, the second
    by: Literal["block", "sequence"]  # what is repeated: each block, or all blocks of the sequence


class GpsValues(Model):
    """The value of the letter G, by the state of the GPS receiver's pulse."""

    absent: Byte = 0
    synchronising: Byte = 0
    locked: Byte = 0
    error: Byte = 0


class Status(Model):
    """The status bytes that stand in place of return mode and product id: clock, state and calibration."""

    source: str = ""
    letters: Annotated[str, Field(pattern="^[A-Z]+$")]  # the types that open a cycle, one a packet
    warnings: Annotated[str, Field(pattern="^[A-Z]?$")]  # the type of the warning byte, if it has its own
    checksum: Literal["crc16", "length"]  # what ends the calibration
    gps: GpsValues = GpsValues()


class VelodynePacketFacts(Model):
    """The facts of the data packet (1206 bytes: 12 blocks of 32 returns)."""

    source: str = ""
    product_id: Byte | None = None  # neither this nor return_modes: status bytes stand there
    old_product_ids: tuple[Byte, ...] = ()  # what early firmware sends
    block_flags: Annotated[tuple[Word, ...], Field(min_length=1)]  # by group of 32 lasers; 1, 2, 3, 4 or 6 of them
    sequences_per_block: Annotated[int, Field(ge=1, le=32)]
    return_modes: ReturnModes | None = None
    status: Status | None = None
    sent_as: str = ""  # the model that sends the same packets, byte for byte; captures are recognised as that one
    dual: Dual | None = None  # none: the sensor has no such mode

    @model_validator(mode="after")
    def _check(self) -> "VelodynePacketFacts":
        given = (self.product_id is not None, self.return_modes is not None, self.status is None)
        if len(set(given)) > 1:
            raise validation_error("give product_id and return_modes, or status")
        return self

    @property
    def product_ids(self) -> tuple[int, ...]:
        """The allowed product ids; empty if status bytes take their place."""
        return () if self.product_id is None else (self.product_id, *self.old_product_ids)


class InertialScales(Model):
    """The units of the three gyroscopes and the three accelerometers of two axes in the position packet."""

    source: str = ""
    rate_deg_s: Positive
    acceleration_g: Positive


class PositionPacket(Model):
    """The facts of the position packet (512 bytes with an NMEA sentence)."""

    source: str = ""
    inertial: InertialScales | None = None  # none: the bytes for it are zero
    rate_hz: Annotated[float, Field(gt=0, le=10_000)]
    sentence_without_gps: Literal["none", "since 2000"] = "none"  # the latter: as if it was switched on at 2000-01-01


class VelodyneHeaders(Network):
    """The network headers of the sensor's datagrams."""

    data: Header
    position: Header | None = None


class VelodyneFacts(Model):
    """The key `velodyne` of a sensor's file."""

    firing: SequenceFiring
    packet: VelodynePacketFacts
    calibration: Calibration = Calibration()
    position_packet: PositionPacket | None = None
    headers: VelodyneHeaders | None = None

    @model_validator(mode="after")
    def _check(self) -> "VelodyneFacts":
        flags = self.packet.block_flags
        if len(flags) not in GROUP_BLOCKS:
            what = f"{has_values(len(flags))}; allowed: {', '.join(map(str, GROUP_BLOCKS))}"
            raise validation_error(f"{what}, which divide a packet's {BLOCKS} blocks", "packet", "block_flags")
        if self.position_packet and self.headers and not self.headers.position:
            raise validation_error("missing, as there is a position_packet", "headers", "position")
        return self


class VelodyneSettings(Model):
    """The key `velodyne` of a mount in a rig's file."""

    pps: PpsState = "locked"  # what position packets and status bytes say of the GPS receiver's pulse
    fix_rate_hz: Literal[1, 2, 4, 5, 10, 20] = 1  # of the receiver: its sentences say hundredths of a second

    @field_validator("fix_rate_hz", mode="before")
    @classmethod
    def _check(cls, value: Any) -> Any:
        if value is True:  # which Python takes for 1
            raise validation_error("true is not a whole number")
        return value


def settings_of(mount: Mount) -> VelodyneSettings:
    """The settings of a mount; on a clock that runs free the pulse is absent. Raises ConfigError."""
    settings = mount.settings.checked(VelodyneSettings)
    return settings.model_copy(update={"pps": "absent"}) if mount.clock == "free" else settings


class VelodyneUnit(SensorUnit[VelodyneFacts]):
    """A sensor with the facts of its packets."""

    @property
    def firing(self) -> SequenceFiring:
        """When each laser fires."""
        return self.facts.firing

    @property
    def packet(self) -> VelodynePacketFacts:
        """The facts of the data packet."""
        return self.facts.packet

    @property
    def head_offset_ns(self) -> int:
        """The sequence's first firing, after the packet's stamp: where the head points then is the block's azimuth."""
        return min(self.firing.offset_ns)

    def offsets_ns(self, dual: bool = False) -> NDArray[np.int64]:
        """(S, L): when each laser fires in a packet's S sequences, after its stamp. With dual returns S is smaller."""
        return self.firing_schedule(dual).offsets_ns

    def period_ns(self, dual: bool = False) -> int:
        """From one packet's stamp to the next one's."""
        return self.firing_schedule(dual).period_ns

    def firing_schedule(self, dual: bool) -> FiringSchedule:
        """The firing pattern of a packet."""
        per_block = self.packet.sequences_per_block
        offset_ns = np.array(self.firing.offset_ns, np.int64)
        return FiringSchedule(offset_ns, self.firing.sequence_ns, BLOCKS // self.span(dual) * per_block, per_block)

    def span(self, dual: bool) -> int:
        """The number of blocks that hold one firing of all lasers."""
        return len(self.packet.block_flags) * (1 + dual)

    @property
    def distance_offset_m(self) -> Array:
        """(L,): added to what the packet says."""
        return self._table("distance_offset_mm") / 1000

    @property
    def near_offset_m(self) -> Array | None:
        """(L, 2): the same near by, to the side and ahead; None: as far off."""
        if not self.facts.calibration.near_x_offset_mm:
            return None
        return np.stack([self._table("near_x_offset_mm"), self._table("near_y_offset_mm")], axis=-1) / 1000

    @property
    def focal(self) -> Array | None:
        """(L, 4): focal distance in metres, slope, least and greatest intensity; None: as they come."""
        if not self.facts.calibration.focal_slope:
            return None
        tables = (self._table(key) for key in ("focal_slope", "intensity_min", "intensity_max"))
        return np.stack([self._table("focal_distance_mm") / 1000, *tables], axis=-1)

    def _table(self, key: str) -> Array:
        return np.array(getattr(self.facts.calibration, key) or (0.0,) * self.count, np.float64)


@lru_cache(64)
def unit(sensor: Sensor) -> VelodyneUnit:
    """The sensor with the key `velodyne` of its file. Raises ConfigError with file, line and key."""
    section = sensor.section
    facts = section.checked(VelodyneFacts)
    check_firing(section, facts.firing, sensor)
    if facts.packet.sequences_per_block * sensor.count != SLOTS * len(facts.packet.block_flags):
        what = f"{sensor.count} beams × {facts.packet.sequences_per_block} do not fill the blocks of {SLOTS} returns"
        raise section.error(("packet", "sequences_per_block"), what)
    try:
        check_lengths(facts.calibration, sensor.count)
    except PydanticCustomError as error:
        raise section.error(("calibration", *(error.context or {})["at"]), error.message()) from None
    return VelodyneUnit(sensor, facts)


def block_flags(facts: VelodynePacketFacts, dual: bool) -> tuple[int, ...]:
    """The flags of the blocks that hold one block's time of all lasers."""
    if dual and facts.dual and facts.dual.by == "block":
        return tuple(flag for flag in facts.block_flags for _ in range(2))
    return facts.block_flags * (1 + dual)


def slots(facts: VelodynePacketFacts, dual: bool) -> Times:
    """(blocks, 32): which number of a packet's (S, L) firings, or (S, L, 2) returns, stands in each slot.

    Blocks at the end that are not used are missing.
    """
    groups = len(facts.block_flags)
    times = BLOCKS // (groups * (1 + dual))
    numbers = np.arange(times * groups * SLOTS * (1 + dual)).reshape(times, groups, SLOTS, 1 + dual)
    if dual and facts.dual:
        numbers = numbers[..., [RETURNS.index(name) for name in facts.dual.order]]
        numbers = np.moveaxis(numbers, -1, 2 if facts.dual.by == "block" else 1)
    return numbers.reshape(-1, SLOTS)


def is_dual(facts: VelodynePacketFacts, packets: Packets) -> NDArray[np.bool_]:
    """(P,) whether each packet holds dual returns: it says so or, where it cannot, repeats its azimuths."""
    if facts.return_modes:
        return np.asarray(packets["return_mode"] == facts.return_modes.codes.get("dual", -1))
    azimuth = packets["blocks"]["azimuth"]
    groups = len(facts.block_flags)
    if facts.dual is None or 2 * groups >= BLOCKS:
        return np.zeros(len(packets), np.bool_)
    return np.asarray((azimuth[:, 0] == azimuth[:, groups]) & (azimuth[:, 0] != azimuth[:, 2 * groups]))
