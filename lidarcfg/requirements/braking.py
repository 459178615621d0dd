"""The last moment to brake: from the reaction time and the deceleration to a distance, and to seconds before impact.

The distance with an object that brakes is that of Responsibility-Sensitive Safety, as Autoware's emergency braking
computes it (autoware_universe, control/autoware_autonomous_emergency_braking/README.md).
"""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from lidarcfg.config.models import Model, validation_error

Seconds = Annotated[float, Field(ge=0, le=60)]
Deceleration = Annotated[float, Field(ge=0.1, le=30)]
Offset = Annotated[float, Field(ge=0, le=100)]


class Braking(Model):
    """How a vehicle brakes. The defaults are an emergency's: figures of this project, of no standard."""

    reaction_s: Seconds = 0.3  # from the end of a frame to the brakes' full force
    deceleration_m_s2: Deceleration = 8.0
    object_deceleration_m_s2: Deceleration | None = None  # with which the target ahead stops; none: it keeps its speed
    offset_m: Offset = 0.0  # left between vehicle and target

    def distance_m(self, speed_m_s: float, target_m_s: float = 0.0) -> float:
        """The gap at the last moment to brake; the target moves ahead at `target_m_s` in the same direction."""
        if self.object_deceleration_m_s2 is None:
            closing_m_s = speed_m_s - target_m_s
            return closing_m_s * self.reaction_s + closing_m_s**2 / (2 * self.deceleration_m_s2) + self.offset_m
        braked_m = speed_m_s * self.reaction_s + speed_m_s**2 / (2 * self.deceleration_m_s2)
        return max(braked_m - target_m_s**2 / (2 * self.object_deceleration_m_s2), 0.0) + self.offset_m


EMERGENCY = Braking()
# autonomous_emergency_braking.param.yaml of autoware_launch at 025908d
COMFORT = Braking(reaction_s=1.0, deceleration_m_s2=3.0, object_deceleration_m_s2=1.0, offset_m=2.0)
PRESETS = {"emergency": EMERGENCY, "comfort": COMFORT}


def _of_preset(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value not in PRESETS:
        known = ", ".join(PRESETS)
        raise validation_error(f"{value!r} is not allowed; allowed: {known}, or keys and values")
    return PRESETS[value].model_dump()


BrakingOrName = Annotated[Braking, BeforeValidator(_of_preset, json_schema_input_type=Braking | str)]
