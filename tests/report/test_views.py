"""The object as a sensor sees it: in true proportions, also where it is alone in its row and far below."""

import math
import re
from pathlib import Path

import numpy as np
import open3d
import pytest

from lidarcfg.report.evidence import draw_views
from lidarcfg.requirements.verify import Verifier
from lidarcfg.study.loading import load_study

CHILD = Path(__file__).parents[2] / "data/objects/child.ply"
AT_M = 0.0, 0.0, 2.6
POSE = {"position_m": AT_M, "rpy_deg": [0, 0, 0]}
STUDY = {
    "region": {"min_m": [-8, -5, 0], "max_m": [8, 5, 3], "cuboid_m": [1, 1, 0.5]},
    "vehicle": {"boxes": [{"name": "body", "center_m": [0, 0, 0.3], "size_m": [0.8, 0.5, 0.5]}]},
    "sensors": [{"model": "os0-32", "min": POSE, "max": POSE}],
    "requirements": [
        {"name": "child", "object": "child", "returns": 3, "within_m": [0.5, 0.7], "headings_deg": [0], "step_m": 2}
    ],
}


def test_a_silhouette_has_the_proportions_that_the_sensor_sees():
    """A degree of azimuth is as long as the cosine of the elevation, by hand from the object's mesh at that place."""
    study = load_study(STUDY)
    rig = study.rig(study.space.midpoint)
    verifier = Verifier(study.requirements)
    evidence = verifier.verification(rig.mounts, verifier.verify(rig.mounts)).evidence[0]
    svg = str(draw_views(evidence, 0))
    tick = re.compile(r'<text [^>]*font-size: 7px[^>]*x="([\d.]+)" y="([\d.]+)"[^>]*>([−\d]+)</text>')
    ticks = np.array([(x, y, text.replace("−", "-")) for x, y, text in tick.findall(svg)], np.float64)
    across = ticks[ticks[:, 1] == ticks[0, 1]]
    up = ticks[ticks[:, 1] != ticks[0, 1]]
    degree_px = abs(np.ptp(across[:, 0]) / np.ptp(across[:, 2])), abs(np.ptp(up[:, 1]) / np.ptp(up[:, 2]))
    worst = evidence.verdict.worst
    vertices = np.asarray(open3d.io.read_triangle_mesh(str(CHILD)).vertices)
    turn = math.radians(worst.heading_deg)
    x = worst.x_m + vertices[:, 0] * math.cos(turn) - vertices[:, 1] * math.sin(turn)
    y = worst.y_m + vertices[:, 0] * math.sin(turn) + vertices[:, 1] * math.cos(turn)
    elevation = np.arctan2(vertices[:, 2] - AT_M[2], np.hypot(x, y))
    cosine = math.cos((elevation.min() + elevation.max()) / 2)
    assert cosine < 0.6
    assert degree_px[0] / degree_px[1] == pytest.approx(cosine, rel=0.02)
