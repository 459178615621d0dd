"""Returns from objects beside the simulator, plain loops over all rays and triangles, and what geometry says."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg import core
from lidarcfg.packets.families import pattern
from lidarcfg.returns.counts import returns
from lidarcfg.returns.scanners import PHASES, Poses, compiled, scanner
from lidarcfg.returns.target import Target
from lidarcfg.vsr.cones import poses as sensor_poses
from lidarcfg.world.tracer import NO_OBSTACLES, obstacles_of
from tests.naive import returns as naive
from tests.returns_cases import at_place, box, lidars, mount, obstacles, revolution, simulated, tracer_of

BODY = box(4.5, 1.8, 1.45)
SIZES = (0.5, 0.5, 1.75), (4.5, 1.8, 1.45), (0.63, 0.63, 0.2)
MOUNTS = (
    mount("vlp-16", (1, 0.5, 1.8), (5, 3, 20)),
    mount("vls-128", (-1, 0.5, 1.8), (-5, 8, 120), 1200.0),
    mount("os1-64", (0, 0, 2.0), (0, 0, 77)),
    mount("qt128", (2.3, 0.9, 0.7), (0, 10, 45)),
    mount("hdl-64e-s3", (0, -0.6, 2.1), (3, -4, 200)),
    mount("vlp-16", (2.3, 0, 0.6), (0, 0, 0), 900.0, (280.0, 80.0)),
    mount("qt128", (2.3, 0.9, 0.7), (0, 0, 0), 600.0, (350.0, 140.0)),
    mount("helios-32", (-2.3, 0, 0.6), (0, 0, 180), 600.0, (280.0, 80.0)),
    mount("os1-32", (0, 0, 2.0), (0, 0, 77), 600.0, (90.0, 225.0), {"columns": 512}),
    mount("pandar-xt32", (0, 0.95, 1.0), (-90, 0, 0)),
)


def places(rng, count, size_m, far_m=30.0):
    """Places around the body that do not overlap it."""
    far = rng.uniform(2.5 + math.hypot(*size_m[:2]) / 2, far_m, count)
    angle, heading = rng.uniform(0, 2 * np.pi, (2, count))
    return np.stack([far * np.cos(angle), far * np.sin(angle), 0 * far, heading], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_counts_are_the_simulators(size):
    """All families, at a random phase each, with the body in the way."""
    rng = np.random.default_rng(7)
    where = places(rng, 8, size)
    target = Target(box(*size))
    total = 0
    sensors = compiled([scanner(one) for one in MOUNTS])
    found = returns(where, target, sensors, sensor_poses(lidars(MOUNTS)), obstacles(BODY))
    for p in range(len(where)):
        tracer = tracer_of([BODY, at_place(target.mesh, where[p])])
        for s, one in enumerate(MOUNTS):
            phase = int(rng.integers(found.phases[s]))
            expected = simulated(one, s, revolution(one, phase, PHASES), tracer, 1)
            assert found.counts[p, s, phase] == expected, (p, one.sensor.name, phase)
            total += expected
    assert total > 1000


@pytest.mark.slow
@pytest.mark.parametrize("model", ["vlp-16", "hdl-64e-s3", "os1-32"])
def test_counts_are_those_of_plain_loops(model):
    one = replace(mount(model, (0.4, 0.1, 1.9), (3, 5, 170), 1200.0))
    short = replace(scanner(one), pattern=coarse(pattern(one)), range_m=(2.0, 9.0))
    rng = np.random.default_rng(3)
    target = Target(box(1.8, 0.6, 1.75))
    where = places(rng, 2, (1.8, 0.6), 10.0)
    found = returns(where, target, compiled([short], 2), sensor_poses(lidars([one])), obstacles(BODY))
    body = BODY[0][BODY[1]]
    for p, place in enumerate(where):
        vertices, triangles = at_place(target.mesh, place)
        for phase in range(found.phases[0]):
            first_rad = (short.pattern.start_rad or 0.0) + phase * short.pattern.step_rad / found.phases[0]
            expected = naive.returns(one, short.pattern, first_rad, short.range_m, vertices[triangles], body)
            assert found.counts[p, 0, phase] == expected
    assert found.counts.sum() > 20


def coarse(fired):
    """The pattern with an eighth of the cycles: the lasers' order and lags stay."""
    return replace(fired, step_rad=8 * fired.step_rad)


def test_an_upright_box_straight_ahead():
    """A level VLP-16 1 m above the ground sees a wall 2 m high and 4 m wide, 10 m ahead, between angles on paper."""
    one = mount("vlp-16", (0.0, 0.0, 1.0), (0, 0, 0))
    bare = one.sensor.model_copy(update={"beams": one.sensor.beams.model_copy(update={"vertical_offset_mm": ()})})
    wall = np.array([[10.5, 0.0, 0.0, 0.0]])
    found = returns(
        wall,
        Target(box(1.0, 4.0, 2.0)),
        compiled([replace(scanner(one), sensor=bare)], 1),
        sensor_poses(lidars([one])),
    )
    step_deg = 360 * 10 * 55_296e-9
    expected = 0
    for laser, rise_deg in enumerate(bare.beams.elevation_deg):
        for cycle in range(1809):
            azimuth = math.radians(step_deg * (cycle + laser * 2.304 / 55.296))
            if math.cos(azimuth) > 0 and abs(10 * math.tan(azimuth)) <= 2:
                expected += abs(10 / math.cos(azimuth) * math.tan(math.radians(rise_deg))) <= 1
    assert found.counts.tolist() == [[[expected]]]


def test_mean_over_phases_is_the_solid_angle():
    """Of a fine sphere seen by one level beam: its chord's angle over the angle between firings."""
    from lidarcfg.world.meshes import sphere_mesh
    from lidarcfg.world.scene_file import Sphere

    one = mount("vlp-16", (0.0, 0.0, 0.5), (0, 0, 0))
    sensor = one.sensor.model_copy(
        update={"beams": one.sensor.beams.model_copy(update={"elevation_deg": (0.0,) * 16, "vertical_offset_mm": ()})}
    )
    ball = sphere_mesh(Sphere(name="ball", reflectivity=1, center_m=(0, 0, 0), radius_m=0.5), 1e-6)
    found = returns(
        np.array([[8.0, 3.0, 0.0, 1.0]]),
        Target(ball),
        compiled([replace(scanner(one), sensor=sensor)], 64),
        sensor_poses(lidars([one])),
    )
    expected = 16 * 2 * math.degrees(math.asin(0.5 / math.hypot(8, 3))) / (360 * 10 * 55_296e-9)
    assert found.mean[0] == pytest.approx(expected, rel=2e-3)
    assert found.worst[0] <= found.mean[0] <= found.counts.max()


def test_a_field_of_view_and_ranges_end_what_returns():
    target = Target(box(1.0, 1.0, 1.0))
    where = np.array([[6.0, 0.0, 0.0, 0.3], [0.0, 6.0, 0.0, 0.3]])
    one = mount("vlp-16", (0.0, 0.0, 1.0), (0, 0, 0))

    def counts(changed):
        return returns(where, target, compiled([changed]), sensor_poses(lidars([one]))).mean

    around = scanner(one)
    assert (counts(around) > 0).all()
    ahead = counts(replace(around, azimuth_fov_deg=(315.0, 45.0)))
    assert ahead.tolist() == [counts(around)[0], 0.0]
    assert counts(replace(around, azimuth_fov_deg=(0.0, 360.0))).tolist() == counts(around).tolist()
    assert counts(replace(around, range_m=(0.5, 5.0))).tolist() == [0.0, 0.0]
    assert counts(replace(around, range_m=(7.5, 100.0))).tolist() == [0.0, 0.0]


def test_the_ground_of_the_surroundings_hides():
    target = Target(box(1.0, 1.0, 1.0))
    where = np.array([[6.0, 0.0, 0.0, 0.0]])
    one = mount("vlp-16", (0.0, 0.0, 2.0), (0, 0, 0))
    count = [
        returns(
            where,
            target,
            compiled([scanner(one)]),
            sensor_poses(lidars([one])),
            obstacles_of(NO_OBSTACLES.tree, np.zeros(3), ground),
        ).mean[0]
        for ground in (0.0, 0.8, 1.5)
    ]
    assert count[0] > count[1] > count[2] == 0.0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(st.integers(0, 6), min_size=4, max_size=4), min_size=1, max_size=4), st.integers(1, 12))
def test_probability_is_that_of_all_combinations(counts, enough):
    table = np.array(counts, np.int32)
    phases = np.array([4 if i % 3 else 1 for i in range(len(counts))], np.int64)
    rows = [row[:count] for row, count in zip(counts, phases.tolist(), strict=True)]
    (found,) = core.returns.detection_probabilities(table[None], phases, enough)
    assert found == naive.probability(rows, enough)


def test_ending_early_changes_nothing():
    """Beside counts in full: the sum over places of the probability to go undetected; and no less once it ends early."""
    rng = np.random.default_rng(5)
    mounts = MOUNTS[:3]
    where = places(rng, 60, (0.5, 0.5))
    target = Target(box(0.5, 0.5, 1.1))
    around = obstacles(BODY)
    scanners = compiled([scanner(one) for one in mounts])
    at = sensor_poses(lidars(mounts))
    found = returns(where, target, scanners, at, around)
    for enough in (1, 40, 200, 2000):
        missed = float(sum(1.0 - found.probability(enough)))

        def counted(most, enough=enough):
            known = core.returns.KnownReturns(scanners, [target.shape], where, np.array([60]), around)
            return known.missed(np.arange(3), *at, 0, enough, most)

        assert counted(math.inf) == missed
        for most in (0.3 * missed, 0.99 * missed):
            assert most <= counted(most) <= missed
    assert 0 < sum(1.0 - found.probability(200)) < len(where)


@pytest.mark.parametrize("phases", [1, 2, 3, 4])
def test_what_is_known_already_changes_nothing(phases):
    """A search's trials, of which each moves one sensor or none, by some of the sensors, beside plain counts of each."""
    rng = np.random.default_rng(8)
    mounts = MOUNTS[:4]
    where = places(rng, 50, (0.5, 0.5), 20.0)
    target = Target(box(0.5, 0.5, 1.1))
    around = obstacles(BODY)
    scanners = compiled([scanner(one) for one in mounts], phases)
    at = sensor_poses(lidars(mounts))
    ends = (0, 7, 7, 50)
    known = core.returns.KnownReturns(scanners, [target.shape] * 3, where, np.array(ends[1:]), around)
    poses = [at]
    ended = 0
    for trial in range(40):
        source = poses[rng.integers(len(poses))]
        at = Poses(source.R.copy(), source.t.copy())
        at.t[rng.integers(4)] += rng.normal(0, 0.3, 3) * (trial % 5 > 0)
        poses.append(at)
        some = np.flatnonzero(rng.random(4) < 0.7)
        some = some if len(some) else np.arange(4)
        here = Poses(np.ascontiguousarray(at.R[some]), np.ascontiguousarray(at.t[some]))
        plain = naive.missed(where, target, [scanners[n] for n in some], here, around, 60)
        group = trial % 3
        first, end = ends[group : group + 2]
        expected = float(np.cumsum([0.0, *plain[first:end]])[-1])
        most = math.inf if trial % 2 else 0.8 * expected
        among = known.missed_among(some, *here, group, 60, int(rng.integers(60)))
        found = known.missed(some, *here, group, 60, most)
        assert 0.0 <= among <= expected
        assert found == expected if most == math.inf else most <= found <= expected
        ended += found < expected
    assert ended
    assert known.traced < 40 * 4 * len(where) / 3


def test_threads_change_nothing():
    rng = np.random.default_rng(6)
    mounts = MOUNTS[:2]
    where = places(rng, 200, (0.5, 0.5))
    target = Target(box(0.5, 0.5, 1.75))
    sensors = compiled([scanner(one) for one in mounts])
    at = sensor_poses(lidars(mounts))
    one, many = (returns(where, target, sensors, at, obstacles(BODY), threads).counts for threads in (1, 5))
    assert np.array_equal(one, many)
