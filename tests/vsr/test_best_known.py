"""The best rigs known on the paper's studies: they keep its bounds, and are as good as they are said to be."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from lidarcfg.study.loading import load_study
from tests.naive import vsr as naive

ROOT = Path(__file__).parents[2]
KNOWN = json.loads((ROOT / "data/reference/best_known.json").read_text())
STUDIES = {f"{lidars}x{beams}" for lidars in (1, 2, 3, 4, 5) for beams in (4, 8, 16)}


def max_vsr_m(poses, sin_elevation):
    """Max VSR by the paper's text, with SciPy's components and nothing of lidarcfg."""
    x, y, z = np.meshgrid(np.arange(60) + 0.5, np.arange(40) / 2 + 0.25, np.arange(20) / 5 + 0.1, indexing="ij")
    place = np.stack([x, y, z], axis=-1)
    label = np.zeros(x.shape, np.int64)
    for position, rpy in poses:
        away = place - position
        sine = away @ np.array(naive.matrix(rpy))[:, 2] / np.linalg.norm(away, axis=-1)
        beam_gap = (sine[..., None] >= sin_elevation).sum(axis=-1)
        label = label * (len(sin_elevation) + 1) + beam_gap
    excluded = (x > 27) & (x < 33) & (y > 8) & (y < 12)
    number = np.arange(x.size).reshape(x.shape)
    pairs = []
    shared_m2 = np.zeros(x.size)
    kept = ~excluded
    for axis, face_m2 in enumerate((0.5 * 0.2, 1 * 0.2, 1 * 0.5)):
        low, high = (np.take(number, n, axis) for n in (range(x.shape[axis] - 1), range(1, x.shape[axis])))
        alike = kept.ravel()[low] & kept.ravel()[high] & (label.ravel()[low] == label.ravel()[high])
        pairs.append((low[alike], high[alike]))
        shared_m2[low[alike]] += 2 * face_m2  # one face of it and one of its neighbour
    one, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
    _, part = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(x.size, x.size)), directed=False)
    cuboids = np.bincount(part[kept.ravel()], minlength=part.max() + 1)
    shared = np.bincount(part, shared_m2)
    whole = cuboids > 0
    return (cuboids[whole] * 0.1 / (cuboids[whole] * 2 * (0.1 + 0.2 + 0.5) - shared[whole])).max()


def test_every_study_has_one():
    assert set(KNOWN) == STUDIES


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(STUDIES))
def test_the_rig_is_as_good_as_it_is_said_to_be(name):
    study = load_study(ROOT / f"data/studies/liu2018-{name}.yaml")
    poses = np.array([[*one["position_m"], *one["rpy_rad"]] for one in KNOWN[name]["poses"]])
    assert ((poses >= study.space.lower) & (poses <= study.space.upper)).all()
    sines = study.slots[0].sensor.sin_elevation
    found = max_vsr_m([(row[:3], row[3:]) for row in poses], sines)
    assert found == pytest.approx(KNOWN[name]["max_vsr_m"], abs=1e-12)
