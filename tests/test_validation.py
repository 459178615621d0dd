"""The validation of the measures: its statistics by scipy, its places by hand, and a small run of all of it."""

import json
import sys
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.stats import spearmanr

from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
STUDY = """
region: {min_m: [-12, -8, 0], max_m: [12, 8, 3], cuboid_m: [1, 1, 0.5]}
vehicle:
  boxes: [{name: cab, center_m: [0, 0, 0.75], size_m: [4, 2, 1.5], exclude: true}]
sensors:
  - {model: vlp-16, min: {position_m: [-1, -0.5, 1.6], rpy_deg: [-10, -10, 0]}, max: {position_m: [1, 0.5, 2.2], rpy_deg: [10, 10, 0]}}
solver: {method: auto, evaluations: 20}
"""


@pytest.fixture
def validate(tool):
    return tool("validate_measure")


@pytest.fixture
def path(tmp_path):
    (tmp_path / "cab.yaml").write_text(STUDY)
    return tmp_path / "cab.yaml"


def test_correlations_are_scipys(validate):
    rng = np.random.default_rng(1)
    one = rng.normal(size=60)
    for other in (one + rng.normal(size=60), np.round(one), rng.normal(size=60)):
        rho, low, high = validate.correlation(one, other)
        assert rho == pytest.approx(spearmanr(one, other).statistic, abs=1e-12)
        assert low <= rho <= high
        few = [spearmanr(one[rows], other[rows]).statistic for rows in rng.integers(60, size=(400, 60))]
        assert (low, high) == pytest.approx(np.quantile(few, (0.025, 0.975)), abs=0.1)
    assert validate.correlation(one, 3 * one + 1) == pytest.approx((1, 1, 1))


def test_places_are_clear_of_the_body_and_in_their_rings(validate, path):
    study = load_study(path)
    for low, high, places in zip(
        validate.EDGES_M[:-1],
        validate.EDGES_M[1:],
        validate.drawn_places(study, np.array([1.8, 0.6, 1.7]), 40),
        strict=True,
    ):
        assert len(places) == (40 if low < 12 else len(places))
        far = np.hypot(places[:, 0], places[:, 1])
        assert ((far >= low) & (far < high)).all()
        radius = np.hypot(1.8, 0.6) / 2
        beside = np.maximum(abs(places[:, :2]) - (2, 1), 0)
        assert (np.hypot(*beside.T) > 0.9 * radius).all()  # beyond the outline along its own direction
        assert (abs(places[:, :2]) <= np.array([12, 8]) - radius + 1e-9).all()
        assert (places[:, 2] == 0).all()


def test_a_small_validation(validate, path, tmp_path, monkeypatch):
    """Its measures are evaluate's, objects in the dark are undetected, and a second run reads the first one's results."""
    monkeypatch.setattr(validate, "BUDGETS", (10, 12))
    monkeypatch.setattr(validate, "OBJECTS", ("pedestrian", "tyre"))
    monkeypatch.setattr(validate, "MESHES", tmp_path)
    for name, size in (("pedestrian", (0.5, 0.6, 1.75)), ("tyre", (0.6, 0.6, 0.2))):
        o3d.io.write_triangle_mesh(str(tmp_path / f"{name}.ply"), o3d.geometry.TriangleMesh.create_box(*size))
    monkeypatch.setattr(validate, "EDGES_M", np.array([0.0, 6.0, 9.0]))
    monkeypatch.setattr(validate, "RINGS", ("near", "far"))
    page = tmp_path / "page.md"
    page.write_text("\n".join(f"<!-- {name}: {end} -->" for name in ("studies",) for end in ("begin", "end")))
    asked = ["--rigs", "5", "--places", "4", "--results", f"{tmp_path / 'r'}", "--plots", f"{tmp_path}"]
    monkeypatch.setattr(sys, "argv", ["validate_measure.py", str(path), *asked, "--page", str(page)])
    validate.main()
    first = page.read_text()
    assert "| cab | blind volume |" in first
    assert (tmp_path / "cab.png").stat().st_size > 10_000
    study = load_study(path)
    rigs, searched = validate.drawn_rigs(study, 5)
    assert searched == [False, False, False, True, True]
    with np.load(tmp_path / "r/cab.npz") as found:
        assert json.loads(str(found["asked"])) == {"rigs": 5, "places": 4, "least": 10}
        for n, rig in enumerate(rigs):
            expected = evaluate(study, rig)
            part = expected.seen_by_m3 / expected.seen_by_m3.sum()
            assert found["max_vsr_body"][n] == expected.max_vsr_m
            assert found["blind"][n] == pytest.approx(part[0])
            assert found["below_two"][n] == pytest.approx(part[:2].sum())
        assert found["undetected"].shape == (5, 2, 2)
        assert ((found["undetected"] >= 0) & (found["undetected"] <= 1)).all()
    monkeypatch.setattr(validate, "validate", None)
    validate.main()
    assert page.read_text().splitlines()[3:] == first.splitlines()[3:]
