"""Coverage and detection by distance: maps and rings against plain loops, a pole by hand, and the rings of a region."""

import math
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.report.inputs import beams_across, coverage, ring_edges_m
from lidarcfg.study.loading import load_study
from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.detection import DetectionObject, detection, detection_by_distance, from_point
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from tests.naive import vsr as naive

ROOT = Path(__file__).parents[2]
ELEVATION_DEG = [-20, -7, 3, 15]
REGION = Region.from_boxes((0, 0, 0), (6, 4, 2), (0.5, 0.5, 0.25), (((2, 1, 0), (3, 2, 2)), ((4, 0, 0), (5, 1, 1))))
POSES = [((2.6, 1.3, 1.1), (0.1, 0.2, 0.0)), ((3.4, 2.2, 0.9), (-0.2, 0.4, 0.0))]
SPACES = segment(REGION, [lidar(at, rpy, np.sin(np.radians(ELEVATION_DEG))) for at, rpy in POSES])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_beams_across_lines_against_plain_loops(axis):
    found = beams_across(SPACES)[axis]
    others = [a for a in range(3) if a != axis]
    centres = REGION.centres()
    empty = 0
    for a in range(REGION.shape[others[0]]):
        for b in range(REGION.shape[others[1]]):
            digits = []
            for n in range(REGION.shape[axis]):
                index = [0, 0, 0]
                index[others[0]] = a
                index[others[1]] = b
                index[axis] = n
                if REGION.included[tuple(index)]:
                    point = [float(centres[k][index[k]]) for k in range(3)]
                    digits.append([naive.digit(point, at, rpy, ELEVATION_DEG) for at, rpy in POSES])
            empty += not digits
            for m in range(len(POSES)):
                crossed = 0
                for beam in range(1, len(ELEVATION_DEG) + 1):  # a digit of `beam` or more: this cone is below
                    sides = {digit[m] >= beam for digit in digits}
                    crossed += len(sides) == 2
                assert found[m, a, b] == (crossed if digits else -1)
    assert empty == (4 if axis == 2 else 0)


def test_coverage_by_hand():
    """One level beam through the middle of a box: every upright pole is crossed, one beside a wall of it is not."""
    region = Region.from_boxes((0, 0, 0), (4, 1, 2), (1, 1, 0.5), (((0, 0, 1), (1, 1, 2)),))
    spaces = segment(region, [lidar((2, 0.5, 1.0), (0, 0, 0), np.array([0.0]))])
    found = coverage(spaces)
    assert beams_across(spaces)[2].tolist() == [[[0], [1], [1], [1]]]
    assert (found.median_beams, found.by_none, found.by_one_sensor) == (1.0, 0.25, 0.75)


@pytest.mark.parametrize(("size", "threshold", "on_ground"), [((1.2, 0.5, 0.4), 2, True), ((0.5, 1.0, 0.6), 3, False)])
def test_rings_against_plain_loops(size, threshold, on_ground):
    item = DetectionObject(name="o", size_m=size, threshold=threshold, on_ground=on_ground)
    centre = np.array([2.9, 1.7])
    edges = np.array([0.0, 1.0, 1.5, 3.0, 9.0])
    cells = [math.ceil(s / e - 1e-9) for s, e in zip(size, (0.5, 0.5, 0.25), strict=True)]
    detected = [0] * 4
    places = [0] * 4
    nx, ny, nz = REGION.shape
    for i in range(nx - cells[0] + 1):
        for j in range(ny - cells[1] + 1):
            x, y = (i + cells[0] / 2) * 0.5, (j + cells[1] / 2) * 0.5
            away = math.dist((x, y), centre)
            ring = max(n for n in range(4) if edges[n] <= away)
            for k in range(1 if on_ground else nz - cells[2] + 1):
                touched = {
                    int(SPACES.label[a, b, c])
                    for a in range(i, i + cells[0])
                    for b in range(j, j + cells[1])
                    for c in range(k, k + cells[2])
                }
                if -1 not in touched:
                    places[ring] += 1
                    detected[ring] += len(touched) > threshold
    found = detection_by_distance(SPACES, item, from_point(centre), edges)
    assert (found.detected.tolist(), found.places.tolist()) == (detected, places)
    whole = detection(SPACES, item)
    assert found.places.sum() == whole.places
    assert found.detected.sum() == pytest.approx(whole.rate * whole.places)
    assert 0 < found.detected.sum() < found.places.sum()


def test_rings_of_places_drawn():
    """All rings together are what `detection` counts; a ring that holds no place has no rate; beyond is left out."""
    item = DetectionObject(name="o", size_m=(0.8, 0.4, 0.4), threshold=2, samples=2**12)
    centre = np.array([3.0, 2.0])
    found = detection_by_distance(SPACES, item, from_point(centre), np.array([0.0, 1.0, 2.0, 9.0, 10.0]))
    whole = detection(SPACES, item)
    assert found.places.sum() == whole.places
    assert found.detected.sum() / found.places.sum() == pytest.approx(whole.rate, abs=whole.half_width)
    assert np.isnan(found.rate[3])
    inner = detection_by_distance(SPACES, item, from_point(centre), np.array([0.0, 1.0, 2.0]))
    assert inner.places.tolist() == found.places[:2].tolist()


@pytest.mark.parametrize("size_m", [0.3, 1.0, 7.7, 36.06, 59.99, 60.0, 60.01, 1e7])
def test_few_rings_hold_the_whole_region(size_m):
    region = Region.from_boxes((-size_m, 0, 0), (size_m / 2, size_m, 1), (size_m / 2, size_m, 1))
    centre = np.array([size_m / 4, size_m / 3])
    edges = ring_edges_m(region, from_point(centre))
    assert 2 <= len(edges) - 1 <= 12
    assert edges[0] == 0
    assert edges[-1] > math.hypot(1.25 * size_m, 2 / 3 * size_m) >= edges[-2] - 1e-9
    assert f"{edges[1]:.0e}"[0] in "125"


@pytest.mark.slow
def test_where_the_vehicle_stands():
    assert load_study(ROOT / "data/studies/liu2018-2x16.yaml").space.reference_m.tolist() == [29.5, 10.0]
    assert load_study(ROOT / "data/studies/sedan.yaml").space.reference_m.tolist() == [0.0, 0.0]
