"""What firings report, ray by ray: poses by 4 × 4 matrices, directions by angles, a room by its six walls."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose
from lidarcfg.sensors.firing import Firings
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.simulate.simulator import Simulator
from lidarcfg.world.motion import Arc, Motion, TimedPose, Trajectory, build_path
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import mount, scene
from tests.naive import rays as naive

ROOM = "boxes: [{name: room, center_m: [1000003, -2, 1], size_m: [90, 70, 30], yaw_deg: 10, reflectivity: 9}]"
START_NS = 1_700_000_000 * 10**9
MOTIONS = (
    Motion(velocity_m_s=(0.0, 0.0, 0.0)),
    Motion(velocity_m_s=(9.0, -2.0, 0.5)),
    Motion(arc=Arc(speed_m_s=12, yaw_rate_deg_s=40)),
    Motion(
        poses=(
            TimedPose(time_s=0, position_m=(0, 0, 0)),
            TimedPose(time_s=0.4, position_m=(2, 1, 0), rpy_deg=(3, 20, 70)),
            TimedPose(time_s=1, position_m=(5, 1, 0), rpy_deg=(3, -20, 90)),
        )
    ),
)


def fired(rng, lasers, count):
    """Firings in no special order."""
    time_ns = START_NS + np.sort(rng.integers(0, 10**9, count))
    return Firings(time_ns, rng.integers(lasers, size=count).astype(np.uint8), rng.uniform(0, 2 * np.pi, count))


def simulator(tmp_path, sensor, motion, text=ROOM, **mounted):
    one = replace(mount(), name="a", sensor=sensor, position_m=(0.3, -1.0, 2.0), rpy_rad=(0.2, 0.1, -0.4), **mounted)
    trajectory = Trajectory(pose((1_000_003, -2, 1), (0.1, -0.2, 1)), build_path(motion), START_NS)
    return Simulator(0, one, Tracer(scene(tmp_path, text), trajectory.T_world_start[:3, 3], START_NS), trajectory)


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", ["vlp-16", "hdl-64e-s3"])
def test_rays_are_where_poses_and_angles_say(tmp_path, motion, name):
    sensor = load_sensor(name)
    firings = fired(np.random.default_rng(1), sensor.count, 3000)
    one = simulator(tmp_path, sensor, motion)
    echoes, counts = one.echoes(firings, 0)
    assert counts.rays == 3000
    trajectory = Trajectory(pose((1_000_003, -2, 1), (0.1, -0.2, 1)), build_path(motion), START_NS)
    T_vehicle_sensor = pose((0.3, -1.0, 2.0), (0.2, 0.1, -0.4))
    for n in range(3000):
        k = firings.laser[n]
        a = firings.encoder_rad[n] + sensor.azimuth_offset_rad[k]
        w = sensor.elevation_rad[k]
        direction = np.array([math.cos(w) * math.cos(a), -math.cos(w) * math.sin(a), math.sin(w)])
        left = sensor.lateral_offset_m[k]
        origin = np.array([left * math.sin(a), left * math.cos(a), sensor.vertical_offset_m[k]])
        T = trajectory.pose(int(firings.time_ns[n])) @ T_vehicle_sensor
        start = T[:3, :3] @ origin + T[:3, 3]
        ray = T[:3, :3] @ direction
        assert echoes.range_m[n, 0] == pytest.approx(
            naive.box(start, ray, (1_000_003, -2, 1), (90, 70, 30), math.radians(10)), abs=2e-8
        )  # a coordinate of 1e6 m rounds to 1e-10 m


@pytest.mark.parametrize("motion", MOTIONS)
def test_pieces_are_the_whole(tmp_path, motion):
    """Bit for bit, also with noise, wide beams and moving objects."""
    text = (
        ROOM
        + "\nspheres: [{name: s, center_m: [1000012, 0, 1], radius_m: 2, reflectivity: 9, motion: {velocity_m_s: [-20, 3, 0]}}]"
    )
    realism = Realism(seed=3, range_noise_m=0.02, divergence=True)
    sensor = load_sensor("vlp-16")
    one = simulator(tmp_path, sensor, motion, text, realism=realism)
    firings = fired(np.random.default_rng(2), 16, 4000)
    whole, counts = one.echoes(firings, 0)
    assert counts.rays == 9 * 4000
    assert set(whole.object.ravel()) == {0, 1}
    for size in (4, 28, 1000):
        for first in range(0, 4000, size * 9):
            piece = Firings(*(values[first : first + size] for values in vars(firings).values()))
            part, _ = one.echoes(piece, first)
            for key, values in vars(part).items():
                assert np.array_equal(values, getattr(whole, key)[first : first + size]), key


def test_what_is_out_of_range_is_not_reported(tmp_path):
    """And is not looked for: the limit changes nothing within range."""
    text = "\n".join(
        f"  - {{name: b{i}, center_m: [{1_000_003 + x}, 0, 1], size_m: [1, 300, 300], reflectivity: 9}}"
        for i, x in enumerate((90, -99.9, 200))
    )
    sensor = load_sensor("vlp-16")
    firings = fired(np.random.default_rng(3), 16, 2000)
    echoes, counts = simulator(tmp_path, sensor, MOTIONS[0], "boxes:\n" + text).echoes(firings, 0)
    assert counts.hits == np.count_nonzero(echoes.range_m <= 109.85)
    assert 0 < counts.hits < 2000


def test_divergence_needs_optics(tmp_path):
    sensor = load_sensor("vlp-16").model_copy(update={"optics": None})
    with pytest.raises(ConfigError, match="a: divergence: sensor 'vlp-16' has no optics facts"):
        simulator(tmp_path, sensor, MOTIONS[0], realism=Realism(divergence=True))
