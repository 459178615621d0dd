"""The firings of a drive as rays, held against beams by hand and against what the schedule of a sensor has."""

import math
from itertools import pairwise

import numpy as np
import pytest

from lidarcfg.packets.families import timing
from lidarcfg.sensors.firing import spans
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import catalogue
from lidarcfg.simulate.drive import Drive
from lidarcfg.simulate.scans import firing_ends
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Trajectory
from tests.refusals import refused

RIG = {
    "name": "two",
    "sensors": [
        {"name": "top", "model": "vlp-16", "position_m": [1.0, 0.2, 2.0], "rpy_deg": [3, -4, 30]},
        {"name": "side", "model": "mid-360", "position_m": [0.5, -1.0, 1.0], "rpy_deg": [-60, 10, -5]},
    ],
}
SECONDS = (0.0, 0.3, 1.0)


def moving() -> Trajectory:
    """Turns, climbs and drives on at once."""
    T = np.tile(np.eye(4), (3, 1, 1))
    for pose, turned in zip(T, (0.0, 0.4, 0.5), strict=True):
        c, s = math.cos(turned), math.sin(turned)
        pose[:3, :3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        pose[:3, 3] = 10 * turned, -turned, 0.2 * turned
    return Trajectory.from_poses(np.array(SECONDS), T, START_NS)


def one(name: str, **keys) -> dict:
    """A mount of a model."""
    return {"name": "one", "model": name, "position_m": [0.3, 0.1, 1.8], "rpy_deg": [2, 1, 40], **keys}


@pytest.mark.parametrize("frame", ["world", "vehicle"])
def test_rays_are_beams_placed_by_the_pose_of_their_firing(frame):
    drive = Drive(RIG, moving())
    (rays,) = drive.firings(0.1, 0.15, 0.05, frame)
    for at in np.random.default_rng(1).integers(len(rays.time_ns), size=200):
        number = int(rays.sensor[at])
        mount = drive.rig.mounts[number]
        fired = rays.packets[number].batch.firings[np.array([at - np.argmax(rays.sensor == number)])]
        assert fired.time_ns[0] == rays.time_ns[at]
        assert fired.laser[0] == rays.channel[at]
        T = mount.T_vehicle_sensor
        if frame == "world":
            T = drive.trajectory.pose(int(rays.time_ns[at])) @ T
        near, far = (firing_ends(mount.sensor, fired, np.array([range_m]))[0] for range_m in (0.0, 1.0))
        np.testing.assert_allclose(rays.origins_m[at], T[:3, :3] @ near + T[:3, 3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(rays.directions[at], T[:3, :3] @ (far - near), rtol=0, atol=1e-12)


def test_columns_count_how_often_a_channel_has_fired():
    drive = Drive(RIG)
    before: dict[tuple[int, int], int] = {}
    for rays in drive.firings(0, 0.02, 0.003):
        for key, column in zip(zip(rays.sensor.tolist(), rays.channel.tolist(), strict=True), rays.column, strict=True):
            assert column == before.get(key, 0)
            before[key] = int(column) + 1
    assert max(before.values()) > 100


@pytest.mark.parametrize(("model", "keys", "steps"), [("qt128", {}, 900), ("ot128", {"resolution": "high"}, 3600)])
def test_the_head_places_channels_that_rest_in_a_range_image(model, keys, steps):
    """Steps of 0.4 and 0.1 degrees at 10 Hz, as Hesai says; half of the channels fire at each, the others at half."""
    mount = {"name": "top", "model": model, "position_m": [0, 0, 2], "hesai": keys}
    (rays,) = Drive({"name": "one", "sensors": [mount]}).firings(0, 0.1, 0.1)
    image = np.zeros((128, steps), np.int64)
    np.add.at(image, (rays.channel, np.rint(rays.head_rad / (2 * np.pi) * steps).astype(int) % steps), 1)
    assert image.max() == 1
    lonely = steps - image.sum(axis=1)
    assert sorted(np.round(lonely / steps, 2).tolist()) == [0] * 64 + [0.5] * 64


@pytest.mark.parametrize("step_s", [0.0013, 0.05])
def test_steps_divide_the_firings_and_lose_none(step_s):
    drive = Drive(RIG)
    columns = ("origins_m", "directions", "time_ns", "sensor", "channel", "column")
    whole = list(drive.firings(0, 0.06, 0.06))
    parts = [*drive.firings(0, 0.031, step_s), *drive.firings(0.031, 0.06, step_s)]
    assert parts[-1].end_s == whole[0].end_s
    for number in range(2):
        for key in columns:
            together = np.concatenate([getattr(rays, key)[rays.sensor == number] for rays in parts])
            assert (together == getattr(whole[0], key)[whole[0].sensor == number]).all()


def test_without_an_end_there_are_always_more():
    steps = Drive(RIG).firings(step_s=0.01)
    assert [round(next(steps).end_s, 9) for _ in range(5)] == [0.01, 0.02, 0.03, 0.04, 0.05]
    assert [rays.end_s for rays in Drive(RIG).firings(0, 0.03, 0.01)] == [0.01, 0.02, 0.03]


@pytest.mark.parametrize("models", [["vlp-16", "mid-360"], ["os0-32"] * 6])
def test_firings_end_where_poses_end(models):
    """The last of six OS0 starts later than a pose may be missing."""
    sensors = [{"name": f"s{n}", "model": model, "position_m": [0, 0, n]} for n, model in enumerate(models)]
    drive = Drive({"name": "many", "sensors": sensors}, moving())
    late_ns = max(sensor.start_ns for sensor in drive.sensors) - START_NS
    assert drive.span_s == (0.0, 1.0 if len(models) == 2 else pytest.approx(1.001 - late_ns / SECOND_NS, abs=1e-12))
    steps = list(drive.firings(0.75, step_s=0.1))
    assert [rays.end_s for rays in steps] == pytest.approx([0.85, 0.95, drive.span_s[1]])
    last_ns = max(int(rays.time_ns.max()) for rays in steps)
    assert 0.99 < (last_ns - START_NS) / SECOND_NS <= 1.001
    assert np.isfinite(steps[-1].origins_m).all()
    assert [rays.end_s for rays in Drive(RIG).firings(0, 0.03, 0.01)] == [0.01, 0.02, 0.03]
    first = next(drive.firings(step_s=2, frame="vehicle"))
    assert first.end_s == 2


@pytest.mark.parametrize("late_s", [0.033, 3.0])
def test_a_late_start_changes_nothing_but_what_comes_before(late_s):
    """A narrow view, an open one, a scan pattern; against the same drive from its start on."""
    sensors = [{**RIG["sensors"][0], "name": "narrow", "azimuth_fov_deg": [10, 70]}, *RIG["sensors"]]
    drive = Drive({"name": "three", "sensors": sensors})
    *_, whole = drive.firings(0, late_s + 0.01, late_s)
    (part,) = drive.firings(late_s, late_s + 0.01)
    assert whole.start_s == part.start_s
    assert len(part) > 1000
    for key in ("time_ns", "sensor", "channel", "column", "head_rad", "origins_m", "directions"):
        assert (getattr(whole, key) == getattr(part, key)).all()
    for one, other in zip(whole.packets, part.packets, strict=True):
        assert one.first == other.first
        assert one.batch.first == other.batch.first
        assert one.batch.number.tolist() == other.batch.number.tolist()


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_spans_of_packets_are_parts_of_the_whole(name):
    """Whatever the phase and the field of view: the numbers of packets, their times, and each firing."""
    rng = np.random.default_rng(len(name))
    keys = (
        {}
        if load_rig({"name": "a", "sensors": [one(name)]}).mounts[0].sensor.scan_pattern
        else {
            "azimuth_fov_deg": [20, 200],
            "rpm": 600,
            "phase_deg": 77,
        }
    )
    mount = load_rig({"name": "a", "sensors": [one(name, **keys)]}).mounts[0]
    total = min(SECOND_NS // 5 // timing(mount.sensor).pace(mount).period_ns, 2000)
    cuts = [0, *sorted(rng.integers(total, size=20).tolist()), total]
    whole, parts = (
        list(timing(mount.sensor).schedule(mount, START_NS + 123_457, some))
        for some in (spans(total, total), [range(a, b) for a, b in pairwise(cuts)])
    )
    for key in ("number", "sent_ns"):
        assert np.concatenate([getattr(batch, key) for batch in parts]).tolist() == getattr(whole[0], key).tolist()
    for key in ("time_ns", "laser", "encoder_rad", "elevation_rad"):
        together = np.concatenate([getattr(batch.firings, key) for batch in parts])
        assert (together == getattr(whole[0].firings, key)).all()
    assert len(whole[0].number)


@pytest.mark.parametrize("narrow", [False, True])
@pytest.mark.parametrize("name", sorted(catalogue()))
def test_a_schedule_may_start_anywhere(name, narrow):
    """The packets from a number on are the last of all, and the firings before it are counted one by one."""
    mount = load_rig({"name": "a", "sensors": [one(name)]}).mounts[0]
    if narrow:
        keys = {"azimuth_fov_deg": [20, 55]}
        if not mount.sensor.scan_pattern:
            keys |= {"rpm": 600, "phase_deg": 77}
        mount = load_rig({"name": "a", "sensors": [one(name, **keys)]}).mounts[0]
    when = timing(mount.sensor)
    total = min(SECOND_NS // 5 // when.pace(mount).period_ns, 2000)
    start_ns = START_NS + 123_457
    (whole,) = when.schedule(mount, start_ns, [range(total)])
    for late in np.random.default_rng(len(name)).integers(1, total, size=4).tolist():
        (part,) = when.schedule(mount, start_ns, [range(late, total)])
        before = len(whole.number) - len(part.number)
        if len(part.number):
            assert part.first == whole.first + before
        assert part.number.tolist() == whole.number[before:].tolist()
        assert part.sent_ns.tolist() == whole.sent_ns[before:].tolist()
        fired = len(whole.firings.time_ns) - len(part.firings.time_ns)
        for key in ("time_ns", "laser", "encoder_rad"):
            assert (getattr(part.firings, key) == getattr(whole.firings, key)[fired:]).all()
        counted = np.bincount(whole.firings.laser[:fired], minlength=mount.sensor.count)
        assert when.fired_before(mount, start_ns, late).tolist() == counted.tolist()


def test_what_is_no_drive_is_said():
    drive = Drive(RIG)
    with refused("firings from nan to inf s; allowed: from 0 on, to a later time"):
        next(drive.firings(math.nan))
    with refused("firings from 1 to 0.5 s; allowed: from 0 on, to a later time"):
        next(drive.firings(1, 0.5))
    with refused("step_s is 0; allowed: from 1e-06 s on"):
        next(drive.firings(0, 1, 0))
    with refused("frame is 'sensor'; allowed: world, vehicle"):
        next(drive.firings(0, 1, frame="sensor"))
    with refused("at is given beside a trajectory that says where it starts; allowed: one of them"):
        Drive(RIG, moving(), at=np.eye(4))
    wrong = {
        "at has the shape (3, 3)": np.eye(3),
        "at is no rotation: R Rᵀ differs from 1 by 3": np.diag([2.0, 2, 2, 1]),
        "at has values that are not finite": np.full((4, 4), math.nan),
    }
    for said, at in wrong.items():
        with refused(f"{said}; allowed: a pose (4, 4), a rotation and a shift in metres"):
            Drive(RIG, at=at)
    for start_ns in (-1, 1.5, 2**62):
        with refused(f"start_ns is {start_ns}; allowed: whole, from 0 to below 4294967296000000000"):
            Drive(RIG, start_ns=start_ns)
    for start_s, end_s in ((1.0, 1.1), (1.1, math.inf)):
        said = f"firings from {start_s:g} to {end_s:g} s; allowed: from 0 to 1 s, as the trajectory has poses"
        with refused(said):
            next(Drive(RIG, moving()).firings(start_s, end_s))
