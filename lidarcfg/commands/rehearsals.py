"""Small runs of what commands do, in which numba compiles the loops that the commands need; see lidarcfg.helpers."""

from pathlib import Path

HERE = Path("rehearsal")
SENSOR = {"model": "vlp-16", "min": {"position_m": (-1, -1, 1), "rpy_deg": (0, 0, 0)}}
STUDY = {
    "region": {"min_m": (-3, -3, 0), "max_m": (3, 3, 3), "cuboid_m": (1, 1, 1)},
    "sensors": (SENSOR | {"count": 2, "max": {"position_m": (1, 1, 1), "rpy_deg": (0, 0, 0)}},),
    "visibility": {"range": True},
    "detection": ({"name": "thing", "size_m": (1, 1, 1), "threshold": 1},),
}


def search() -> None:
    """Compile the evaluation of trials."""
    from lidarcfg.placement.sensitivity import changes_m
    from lidarcfg.placement.study import study_of
    from lidarcfg.placement.study_file import StudyFile

    study = study_of(StudyFile.model_validate(STUDY), HERE)
    changes_m(study, study.rig(study.midpoint))


def evaluation() -> None:
    """Compile the evaluation of a rig."""
    from lidarcfg.placement.details import details
    from lidarcfg.placement.evaluation import evaluate
    from lidarcfg.placement.study import study_of
    from lidarcfg.placement.study_file import StudyFile

    study = study_of(StudyFile.model_validate(STUDY), HERE)
    rig = study.rig(study.midpoint)
    details(study, rig, evaluate(study, rig))
