"""Requirements that no rig within a study's bounds can meet: out of range, too many returns, too dear.

Only what is certain is reported. A requirement that passes here may be out of reach all the same, for example out of
sight, of which some places within the bounds prove nothing.
"""

from dataclasses import replace

from lidarcfg.requirements.allowed_rigs import AllowedRigs, SensorChoice
from lidarcfg.study.study import Study


def unachievable(study: Study) -> dict[str, str]:
    """Why no rig can meet a requirement, by name, for the requirements where that is certain."""
    if study.requirements is None:
        return {}
    rigs = _allowed(study)
    found = {item.name: item.out_of_reach(rigs) for item in study.requirements.items}
    return {name: why for name, why in found.items() if why}


def _allowed(study: Study) -> AllowedRigs:
    assert study.requirements
    sensors = []
    for slot, mount in zip(study.slots, study.rig(study.space.lower).mounts, strict=True):
        some = [replace(mount, sensor=one.sensor, model=one.model) for one in slot.choices if one] or [mount]
        sensors.append(SensorChoice(some, None in slot.choices))
    return AllowedRigs(sensors, study.requirements.site.bounds)
