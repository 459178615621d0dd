"""Liu, Arief and Zhao 2018: all 26 published runs, by the paper's text and by the released program's rule."""

import json
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from tests.naive import vsr as naive

REFERENCE = json.loads((Path(__file__).parents[2] / "data/reference/liu2018.json").read_text())
ROWS = REFERENCE["rows"]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"row{row['row']}")
def test_the_papers_method_gives_the_reference(row):
    region = Region.from_boxes((0, 0, 0), REFERENCE["roi_m"], row["cuboid_m"], (REFERENCE["exclude_m"],))
    sine = np.sort(np.sin(np.radians(row["beam_elevation_deg"])))
    subspaces = segment(region, [lidar(p["position_m"], p["rpy_rad"], sine) for p in row["poses"]])
    assert vsr_m(subspaces).max() == pytest.approx(row["paper_method_max_vsr_m"], abs=1e-9)
    assert len(subspaces) == row["paper_method_subspaces"]


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"row{row['row']}")
def test_the_released_programs_rule_gives_the_published_figure(row):
    found = naive.released_max_vsr(
        REFERENCE["roi_m"], row["cuboid_m"], REFERENCE["exclude_m"], row["poses"], row["beam_elevation_deg"]
    )
    assert found == pytest.approx(row["published_max_vsr_m"], abs=1e-6)


def test_all_completed_runs_are_here():
    assert [row["row"] for row in ROWS] == list(range(26))
