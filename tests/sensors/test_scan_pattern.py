"""Scan patterns: tables of firings, beside sensors with beams that fire alike, Open3D's rays and plain loops."""

import numpy as np
import pytest
import yaml

from lidarcfg.placement.cones import poses as sensor_poses
from lidarcfg.simulate.beams import passing_beams
from lidarcfg.simulate.returns import PHASES, Target, compiled, returns, scanner
from lidarcfg.world.obstacles import NO_OBSTACLES
from tests.returns_cases import box, lidars, mount

ELEVATION_DEG = 9.0, -12.0, 3.0, -4.0
OFFSET_NS = 0, 20_000, 45_000, 90_000
STEP_NS, STEPS, FRAME_NS = 200_000, 500, 100_000_000
COLUMNS = "time_ns", "azimuth_deg", "elevation_deg", "channel"
TARGET = Target(box(1.8, 0.6, 1.75))
POSES = ((0.4, 0.1, 1.9), (3, 5, 170))


def write(folder, rows, frame_ms=100.0, name="own", suffix="csv", **sensor):
    """A sensor whose pattern has rows (F, 4), beside its file."""
    rows = np.asarray(rows, np.float64)
    if suffix == "csv":
        lines = [",".join(f"{value:.17g}" for value in row) for row in rows]
        (folder / f"{name}.csv").write_text("\n".join([",".join(COLUMNS), *lines, ""]))
    else:
        np.savez(folder / f"{name}.npz", **dict(zip(COLUMNS, rows.T, strict=True)))
    path = folder / f"{name}.yaml"
    values = {"name": name, "range": {"min_m": 0.5, "max_m": 60}} | sensor
    path.write_text(yaml.safe_dump(values | {"scan_pattern": {"file": f"{name}.{suffix}", "frame_ms": frame_ms}}))
    return path


def turning(frames):
    """What four lasers of a head that turns at 600 rpm fire, frame by frame a quarter of a step further."""
    rows = []
    for frame in range(frames):
        for step in range(STEPS):
            for laser, offset_ns in enumerate(OFFSET_NS):
                turned_ns = frame * STEP_NS / PHASES + step * STEP_NS + offset_ns
                when_ns = frame * FRAME_NS + step * STEP_NS + offset_ns
                rows.append((when_ns, turned_ns / FRAME_NS * 360 % 360, ELEVATION_DEG[laser], laser))
    return rows


def rosette(count, rng):
    """Firings of two channels anywhere in a cone ahead, and a little behind it."""
    around, away = rng.uniform(0, 2 * np.pi, count), 35 * np.sqrt(rng.uniform(0, 1, count))
    time_ns = np.sort(rng.integers(0, 3 * FRAME_NS, count))
    channel = np.arange(count) % 2
    return np.stack([time_ns, away * np.cos(around), away * np.sin(around), channel], axis=1)


@pytest.fixture
def twins(tmp_path):
    """A sensor with beams, and one whose pattern fires the same; four frames, or only the first."""
    beams = {"elevation_deg": list(ELEVATION_DEG)}
    head = {"name": "head", "beams": beams, "range": {"min_m": 0.5, "max_m": 60}}
    head["firing"] = {"sequence_ns": STEP_NS, "offset_ns": list(OFFSET_NS)}
    (tmp_path / "head.yaml").write_text(yaml.safe_dump(head))
    return tmp_path / "head.yaml", write(tmp_path, turning(4)), write(tmp_path, turning(1), name="one", suffix="npz")


def test_counts_are_those_of_a_head_that_turns(twins):
    """Phase by phase: the frames start where the revolutions' phases do."""
    rng = np.random.default_rng(5)
    far, angle, heading = rng.uniform((3, 0, 0), (25, 2 * np.pi, 2 * np.pi), (150, 3)).T
    places = np.stack([far * np.cos(angle), far * np.sin(angle), 0 * far, heading], axis=1)
    both = [mount(str(path), *POSES) for path in twins[:2]]
    scanners = compiled([scanner(one) for one in both])
    found = returns(places, TARGET, scanners, sensor_poses(lidars(both)))
    assert found.phases == (PHASES, PHASES)
    np.testing.assert_array_equal(found.counts[:, 0], found.counts[:, 1])
    assert found.counts.sum() > 5000
    for place in places[:3]:
        for phase in range(PHASES):
            head, still = (passing_beams(place, TARGET, one, phase, NO_OBSTACLES) for one in both)
            assert head.returns == still.returns
    single = mount(str(twins[2]), *POSES)
    alone = returns(places, TARGET, compiled([scanner(single)]), sensor_poses(lidars([single])))
    assert alone.phases == (1,)  # each frame is like the others
    np.testing.assert_array_equal(alone.counts[:, 0, 0], found.counts[:, 0, 0])
