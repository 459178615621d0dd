"""Faults of a rig's sensors, as the rig's file or a file of their own lists them: each is of one sensor, for a while.

A fault is of the kind that its key `fault` names; adding one is a class, and a line in `KINDS`. What faults do stands
elsewhere: `simulate/faults.py` has those of clock, rotation and window, `capture/wire.py` those of the wire, and each
maker's `report.py` what a sensor says of itself.
"""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from lidarcfg.config.document import Key
from lidarcfg.config.models import Given, Model, Name, all_errors_at, as_model, load_or_check, validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.sensor import AzimuthFov
from lidarcfg.units import SECOND_NS

FAULTS_MAX = 1000
UNPLUGGED_MIN_S = 0.01  # longer than a packet takes
Rpm = Annotated[float, Field(ge=0, le=10_000)]
NO_FAULTS = "none"  # in place of a file: no faults, whatever the rig says
Fraction = Annotated[float, Field(gt=0, le=1)]
Seconds = Annotated[float, Field(ge=0, le=86_400)]
Share = Annotated[Fraction, Field(description="of the packets, that it hits; all by default")]
Seed = Annotated[int, Field(ge=0, lt=2**63, description="of the random numbers; 0 by default")]


class Fault(Model):
    """A fault of one sensor, in a time since the export's start. Each kind has figures of its own."""

    fault: str
    sensor: Name
    start_s: Seconds
    end_s: Seconds

    @model_validator(mode="after")
    def _check_end(self) -> "Fault":
        if not self.start_s < self.end_s:
            raise validation_error(f"{self.end_s:g} is not after start_s, {self.start_s:g}", "end_s")
        return self

    @property
    def span_ns(self) -> tuple[int, int]:
        """From, to, since the start."""
        return round(self.start_s * SECOND_NS), round(self.end_s * SECOND_NS)


class WireFault(Fault):
    """A fault between the sensor and the capture: packets are as sent, but for when they come, and whether."""

    fraction: Share = 1.0
    seed: Seed = 0


class Lost(WireFault):
    """Packets do not come."""

    fault: Literal["lost"]


class Doubled(WireFault):
    """Packets come twice, one copy right behind the other."""

    fault: Literal["doubled"]


class Late(WireFault):
    """Packets come later than they were sent; others overtake them, unless all are late."""

    fault: Literal["late"]
    delay_s: Annotated[float, Field(gt=0, le=60, description="how much later")]


class Overtaken(WireFault):
    """Packets come behind those that were sent after them."""

    fault: Literal["overtaken"]
    by: Annotated[int, Field(ge=1, le=10_000, description="behind how many; 1 by default")] = 1


class Unplugged(Fault):
    """The connector drops: no packets, and from the end on those of a sensor that has just been switched on."""

    fault: Literal["unplugged"]

    @model_validator(mode="after")
    def _check_length(self) -> "Unplugged":
        if self.end_s - self.start_s < UNPLUGGED_MIN_S:
            what = f"{self.end_s:g} is less than {UNPLUGGED_MIN_S:g} s after start_s, {self.start_s:g}"
            raise validation_error(what, "end_s")
        return self


class ClockFault(Fault):
    """A fault of the sensor's clock: packets come when they did, with other stamps."""


class ClockJump(ClockFault):
    """The clock jumps, and at the end back; the sensor does not notice."""

    fault: Literal["clock_jump"]
    by_s: Annotated[float, Field(ge=-86_400, le=86_400, description="by how much; ahead, if positive")]


class ClockDrift(ClockFault):
    """The clock runs fast or slow, and is set right at the end; the sensor does not notice."""

    fault: Literal["clock_drift"]
    ppm: Annotated[float, Field(ge=-1e5, le=1e5, description="by how many millionths; fast, if positive")]


class ClockLost(ClockFault):
    """The clock's source (PTP, GPS) is lost: it is apart from the true time, and the sensor reports the loss."""

    fault: Literal["clock_lost"]
    apart_s: Annotated[float, Field(ge=-86_400, le=86_400, description="how far; ahead, if positive")]


class SlowHead(Fault):
    """The head turns slower, or stands still; then it turns on from there."""

    fault: Literal["rotation"]
    rpm: Annotated[
        tuple[Rpm, Rpm],
        Field(description="at the start and at the end; evenly in between: `[0, 0]` stalls, `[0, 600]` spins up"),
    ]


class DirtyWindow(Fault):
    """The window is dirty over a sector: returns are lost there, and the sensor reports what it does of that."""

    fault: Literal["dirty_window"]
    azimuth_deg: Annotated[
        AzimuthFov, Field(description="`[from, to]`, clockwise from the sensor's x axis, as `azimuth_fov_deg`")
    ]
    fraction: Annotated[Fraction, Field(description="of the returns there that are lost; 1 by default")] = 1.0
    seed: Seed = 0


class Temperature(Fault):
    """The sensor is too hot, and says so."""

    fault: Literal["temperature"]
    celsius: Annotated[float, Field(ge=-100, le=200, description="that it measures")]


class Voltage(Fault):
    """The sensor's supply is out of limits, and it says so."""

    fault: Literal["voltage"]
    volts: Annotated[float, Field(ge=0, le=100, description="that it measures")]


KINDS: dict[str, type[Fault]] = {
    "lost": Lost,
    "doubled": Doubled,
    "late": Late,
    "overtaken": Overtaken,
    "unplugged": Unplugged,
    "clock_jump": ClockJump,
    "clock_drift": ClockDrift,
    "clock_lost": ClockLost,
    "rotation": SlowHead,
    "dirty_window": DirtyWindow,
    "temperature": Temperature,
    "voltage": Voltage,
}


def _fault(values: Any) -> Fault:
    """A validator: the fault, of the kind that it names."""
    if isinstance(values, Fault):
        return values
    if not isinstance(values, Mapping):
        raise PydanticKnownError("model_type", {"class_name": "fault"})
    name = values.get("fault")
    if name is None:
        raise validation_error(f"missing key fault; allowed: {', '.join(KINDS)}")
    if not isinstance(name, str) or name not in KINDS:
        close = difflib.get_close_matches(str(name), KINDS, 1)
        hint = f"did you mean {close[0]}? " if close else ""
        raise validation_error(f"{name!r} is not allowed; {hint}allowed: {', '.join(KINDS)}", "fault")
    return as_model(KINDS[name], dict(values))


class _ByName:
    """How pydantic reads a fault."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(_fault)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [handler(TypeAdapter(one).core_schema) for one in KINDS.values()]}


AnyFault = Annotated[Fault, _ByName()]
Faults = Annotated[tuple[AnyFault, ...], Field(max_length=FAULTS_MAX)]


GivenFaults = Given | Sequence[Fault | Mapping[str, Any]] | None


class FaultsFile(Model):
    """Faults in a file of their own, for any rig that has the sensors."""

    kind: ClassVar[str] = "faults"
    faults: Annotated[Faults, Field(min_length=1)]


def load_faults(given: GivenFaults, sensors: Iterable[str]) -> tuple[Fault, ...]:
    """The faults in a YAML file, of a dict with its keys, or in a list, of a rig with these sensors; none of `none`.

    Raises ConfigError with file, line and key.
    """
    if isinstance(given, Sequence) and not isinstance(given, str):
        given = {"faults": [one.model_dump() if isinstance(one, Fault) else one for one in given]} if given else None
    if given is None or str(given) == NO_FAULTS:
        return ()
    file, path = load_or_check(given, FaultsFile)
    if errors := fault_errors(path, file.faults, sensors):
        raise ConfigError.all_of(errors)
    return file.faults


def fault_errors(path: Path, faults: Sequence[Fault], sensors: Iterable[str]) -> list[ConfigError]:
    """The errors of faults, listed at `faults` of a file, of sensors that the rig does not have."""
    known = tuple(sensors)
    found: list[tuple[Key, object]] = [
        (("faults", i, "sensor"), f"no sensor is called {fault.sensor!r}; allowed: {', '.join(known)}")
        for i, fault in enumerate(faults)
        if fault.sensor not in known
    ]
    return all_errors_at(path, found) if found else []
