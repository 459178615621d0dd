"""Subspaces measured layer by layer, against NumPy over everything at once; memory."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from lidarcfg import inputs
from lidarcfg.errors import LidarcfgError
from lidarcfg.study.extents import extents
from lidarcfg.study.spheres import BYTES
from lidarcfg.vsr.region import CUBOID_BYTES, Region, RegionFile
from lidarcfg.vsr.subspaces import Subspaces

ROOT = Path(__file__).parents[2]


def bodies(shape, cuboid_m, seed):
    """Connected bodies of random sizes, some cuboids excluded."""
    rng = np.random.default_rng(seed)
    blobs = ndimage.zoom(rng.integers(0, 4, (3, 2, 2)), np.array(shape) / (3, 2, 2), order=0)[
        : shape[0], : shape[1], : shape[2]
    ]
    label = np.full(shape, -1, np.int32)
    count = 0
    for value in range(1, 4):
        found, n = ndimage.label(blobs == value)
        label[found > 0] = found[found > 0] - 1 + count
        count += n
    low = np.array((1.0, -2.0, 0.5))
    region = Region(low, low + np.array(shape) * cuboid_m, label >= 0)
    none = np.zeros((count, 3), np.int64)
    return Subspaces(region, label, np.bincount(label[label >= 0], minlength=count), none, none[:, :1], none[:, 0])


def test_where_a_subspace_is():
    spaces = bodies((30, 6, 5), np.array((0.5, 0.4, 0.3)), 4)
    edge = spaces.region.cuboid_m
    numbers = list(range(len(spaces)))[::-1]
    for number, extent in zip(numbers, extents(spaces, numbers), strict=True):
        index = np.argwhere(spaces.label == number)
        assert extent.centroid_m.tolist() == (spaces.region.min_m + (index.mean(axis=0) + 0.5) * edge).tolist()
        low, high = extent.bounds_m
        assert low.tolist() == (spaces.region.min_m + index.min(axis=0) * edge).tolist()
        assert high.tolist() == (spaces.region.min_m + (index.max(axis=0) + 1) * edge).tolist()


def test_what_memory_does_not_hold_is_refused_with_the_bytes(monkeypatch):
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 1000.0)
    file = RegionFile(min_m=(0.0, 0.0, 0.0), max_m=(100.0, 100.0, 10.0), cuboid_m=(0.1, 0.1, 0.1))
    with pytest.raises(
        LidarcfgError, match=r"a region of 100,000,000 cuboids needs 1\.1 GB of memory; 0\.0 GB are free"
    ):
        Region.from_file(file)


PEAK = """
import sys
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.sensors.rig import load_rig
peaks = []
for path in sys.argv[2:]:
    evaluate(load_study(path), load_rig(sys.argv[1]))
    peaks.append(next(1024 * int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")))
print(peaks[1] - peaks[0])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
def test_an_evaluation_needs_the_memory_that_is_asked_for(tmp_path):
    """Peaks of a process: its study's cuboids, then 64 times as many.

    Of these, spheres are sought in 19 layers of 160 × 80 cuboids, with 8 more on either side, as far as 2 m.
    """
    text = (ROOT / "data/studies/sedan.yaml").read_text().replace("../vehicles", str(ROOT / "data/vehicles"))
    paths = [tmp_path / "coarse.yaml", tmp_path / "fine.yaml"]
    for path, edges in zip(paths, ("[1, 0.5, 0.2]", "[0.25, 0.125, 0.05]"), strict=True):
        path.write_text(text.replace("[1, 0.5, 0.2]", edges))
    words = [sys.executable, "-c", PEAK, ROOT / "data/rigs/roof.yaml", *paths]
    needed = int(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    assert 0.6 < needed / (CUBOID_BYTES * 63 * 48_000 + BYTES * (35 * 160 * 80 - 48_000)) < 1.0
