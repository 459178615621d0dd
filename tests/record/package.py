"""The names of the package that the cases need, in one place."""

from pathlib import Path

import yaml

from lidarcfg import (
    Region,
    decode,
    evaluate,
    export,
    load_rig,
    load_scene,
    load_study,
    optimize,
    pattern,
)
from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import simulated_packets as packets
from lidarcfg.capture.revolutions import revolutions
from lidarcfg.clouds.cloud import concatenate, load_cloud
from lidarcfg.core import viewer
from lidarcfg.geometry import pose
from lidarcfg.report.inputs import report_inputs
from lidarcfg.returns.counts import returns
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.search.front import front
from lidarcfg.sensors.rig import Rig
from lidarcfg.solvers.annealing import Annealing
from lidarcfg.solvers.search import Coordinates, of_objectives
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.objective_costs import ObjectiveCosts
from lidarcfg.study.study import with_solver
from lidarcfg.units import START_NS
from lidarcfg.vsr.cones import poses as sensor_poses
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.subspaces import segment
from lidarcfg.world.motion import Trajectory, build_path, load_path
from lidarcfg.world.tracer import NO_OBSTACLES, Tracer
from lidarcfg.world.vehicle import load_vehicle
from tests.visibility_cases import seen_cuboids

fill = viewer.blend_triangles

__all__ = [
    "NO_OBSTACLES",
    "START_NS",
    "Annealing",
    "Coordinates",
    "ObjectiveCosts",
    "Region",
    "Rig",
    "Tracer",
    "Trajectory",
    "build_path",
    "concatenate",
    "decode",
    "decode_pcap",
    "evaluate",
    "export",
    "fill",
    "front",
    "load_cloud",
    "load_path",
    "load_rig",
    "load_scene",
    "load_study",
    "load_vehicle",
    "objective_of",
    "of_objectives",
    "optimize",
    "packets",
    "pattern",
    "pose",
    "report_inputs",
    "returns",
    "revolutions",
    "rig_lidars",
    "rig_of",
    "scanners_of",
    "seen_cuboids",
    "segment",
    "sensor_poses",
    "with_solver",
]


def rig_of(folder: Path, sensors: list[dict]) -> Rig:
    """The rig of sensors as its file says them."""
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump({"name": "rig", "sensors": sensors}))
    return load_rig(path)
