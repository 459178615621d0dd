"""Small runs of what commands do, in which numba compiles the loops that the commands need; see lidarcfg.helpers.

Or parts of a loop, by the types of their arguments: the command compiles the other parts meanwhile.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lidarcfg.placement.study import Study

HERE = Path("rehearsal")
SENSOR = {"model": "vlp-16", "min": {"position_m": (-1, -1, 1), "rpy_deg": (0, 0, 0)}}
STUDY = {
    "region": {"min_m": (-3, -3, 0), "max_m": (3, 3, 3), "cuboid_m": (1, 1, 1)},
    "sensors": (SENSOR | {"count": 2, "max": {"position_m": (1, 1, 1), "rpy_deg": (0, 0, 0)}},),
    "visibility": {"range": True},
    "detection": ({"name": "thing", "size_m": (1, 1, 1), "threshold": 1},),
}


def _study() -> "Study":
    from lidarcfg.placement.study import study_of
    from lidarcfg.placement.study_file import StudyFile

    return study_of(StudyFile.model_validate(STUDY), HERE)


def search() -> None:
    """Compile the evaluation of trials."""
    from lidarcfg.placement.sensitivity import changes_m

    study = _study()
    changes_m(study, study.rig(study.midpoint))


def lines() -> None:
    """Nothing is left to compile of lines through subspaces: the core has them."""


def evaluation() -> None:
    """Compile the evaluation of a rig."""
    from lidarcfg.placement.details import details
    from lidarcfg.placement.evaluation import evaluate

    study = _study()
    rig = study.rig(study.midpoint)
    details(study, rig, evaluate(study, rig))


def tracing() -> None:
    """Compile what rays of firings hit: most of `trace_firings`, of which the command compiles the rest."""
    import numpy as np

    from lidarcfg.simulate.aim_kernels import Frames, Lasers, aimed, locate
    from lidarcfg.simulate.simulator_kernels import hit_bodies, new_work
    from lidarcfg.world.bvh import NO_INDEX, NO_TREE
    from lidarcfg.world.numba_trees import packed
    from lidarcfg.world.ray_kernels import new_packet
    from lidarcfg.world.tracer_kernels import trace
    from lidarcfg.world.world_kernels import Dynamics, Found, World, hit_dynamic, keep_normals

    none, rows = np.empty(0), np.empty(0, np.int64)
    dynamic = Dynamics(NO_TREE, NO_INDEX, NO_INDEX, np.empty((0, 3)), none, none, packed([]))
    frames = Frames(np.eye(3), np.zeros(3), packed([]), 0, np.eye(3), np.zeros(3), NO_TREE)
    found = Found(none, NO_INDEX, np.empty((0, 3)), none)
    _compile(trace, NO_TREE, new_packet(0), 0, False)
    packet, aim, own, _, beams, _ = new_work(frames, 0)
    poses, firings = aim.placed, (rows, np.empty(0, np.uint8), none)
    _compile(hit_dynamic, dynamic, NO_TREE, packet, poses, none, 0, 0, 0, 0)
    _compile(keep_normals, World(0.0, NO_TREE, dynamic), packet, poses, none, 0, 0, 0, rows, found)
    _compile(hit_bodies, own, packet, beams, beams, rows, 0, 0.0, 0, found)
    _compile(locate, aim, frames)
    _compile(aimed, aim, Lasers(*[none] * 9), frames, firings, 0, rows, 0)


def _compile(loop: Any, *arguments: object) -> None:
    """For arguments of these types."""
    from numba import typeof

    loop.compile(tuple(map(typeof, arguments)))
