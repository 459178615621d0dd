"""The verdict on a rig by a study's requirements, in one call."""

from lidarcfg.config.models import Given
from lidarcfg.errors import ConfigError
from lidarcfg.files import loaded
from lidarcfg.requirements.verdict import Verdict
from lidarcfg.requirements.verify import OnProgress, Verifier, silent
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import Study
from lidarcfg.world.vehicle import check_outside


def verify(study: Study | Given, rig: Rig | Given, on_progress: OnProgress = silent) -> Verdict:
    """Whether a rig meets the study's requirements, by how much, and where it comes closest to missing each.

    Study and rig are files, dicts with their keys, or loaded. `on_progress` is told the fraction done, and the name of
    the requirement that is judged. Raises ConfigError without requirements, and for a rig that cannot be judged.
    """
    study = loaded(study, load_study, Study)
    rig = loaded(rig, load_rig, Rig)
    if study.requirements is None:
        raise ConfigError(f"study {study.name!r}: has no requirements; give some under requirements")
    if study.vehicle:
        check_outside(study.vehicle, rig.mounts)
    return Verifier(study.requirements).verify(rig.mounts, on_progress)
