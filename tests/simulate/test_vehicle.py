"""The vehicle's own body in a capture, against Open3D with the body placed in the world at the time of each ray."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import pose, rotation, transform
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Rig, load_rig, save_rig
from lidarcfg.simulate.scene_drive import object_names
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import STATIC, Arc, Motion, TimedPose, Trajectory, build_path
from lidarcfg.world.vehicle import VehicleFile, load_vehicle, rig_vehicle, vehicle
from tests.capture_fixtures import mount, scene
from tests.command_line import lidarcfg

ROOT = Path(__file__).parents[2]
SEDAN = ROOT / "data/vehicles/sedan.ply"
PERIOD_NS = 1_327_104  # of a packet
WORLD = """
ground: {z_m: 0, reflectivity: 12}
boxes: [{name: house, center_m: [8, 9, 3], size_m: [10, 6, 6], yaw_deg: 20, reflectivity: 30}]
spheres: [{name: ball, center_m: [-4, 6, 1], radius_m: 1, reflectivity: 40, motion: {velocity_m_s: [2, 0, 0]}}]
"""
T_WORLD_START = pose((1.0, -2.0, 0.0), (0.0, 0.0, 0.6))
RIG = Rig(
    "mast and mirror", (mount(0, (-0.3, 0.3, 2.4), (-4.0, 20.0, 15.0)), mount(1, (0.8, 1.3, 1.0), (2.0, -3.0, 0.0)))
)
MOTIONS = {
    "standing": STATIC,
    "straight": Motion(velocity_m_s=(15.0, 1.0, 0.0)),
    "arc": Motion(arc=Arc(speed_m_s=14, yaw_rate_deg_s=50)),
    "poses": Motion(
        poses=(
            TimedPose(time_s=0, position_m=(0, 0, 0)),
            TimedPose(time_s=0.5, position_m=(3, 1, 0.2), rpy_deg=(4, 6, 40)),
        )
    ),
}


@pytest.fixture(scope="module")
def sedan():
    return load_vehicle(SEDAN)


def truth(rig, world, trajectory, duration_ns, bodies):
    """The records of an export."""
    found = []
    for stream in simulated_packets(rig, world, trajectory, duration_ns, on_truth=found.append, vehicle=bodies):
        list(stream)
    return np.concatenate(found)


def placed(T_world_vehicle):
    """Open3D's scene of the body alone, at a pose in the world."""
    body = o3d.io.read_triangle_mesh(SEDAN)
    body.transform(T_world_vehicle)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(body))
    return caster


def rays_of(records, rig, trajectory):
    """(N, 6) origin and direction in the world, by poses and angles; VLP-16 at 600 rpm turn a circle in 0.1 s."""
    out = []
    for record in records:
        number = int(record["sensor"])
        laser = int(record["laser"])
        time_ns = int(record["time_ns"])
        one = rig.mounts[number]
        first_ns = START_NS + number * PERIOD_NS // len(rig.mounts)
        turned = 2 * np.pi * (time_ns - first_ns) / 1e8
        w = one.sensor.elevation_rad[laser]
        direction = np.array([np.cos(w) * np.cos(turned), -np.cos(w) * np.sin(turned), np.sin(w)])
        T = trajectory.pose(time_ns) @ one.T_vehicle_sensor
        origin = transform(T, np.array([[0, 0, one.sensor.vertical_offset_m[laser]]]))[0]
        out.append([*origin, *(T[:3, :3] @ direction)])
    return np.array(out, np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
def test_returns_of_the_body_are_where_open3d_casts_them(tmp_path, sedan, motion):
    """Of 200 records, ray by ray with the body at that ray's time: object and range of those on the body."""
    world = scene(tmp_path, WORLD)
    trajectory = Trajectory(T_WORLD_START, build_path(MOTIONS[motion]), START_NS)
    names = object_names(world, sedan)
    assert names == ("ground", "house", "ball", "vehicle/body")
    records = truth(RIG, world, trajectory, 2 * 10**8, sedan)
    rng = np.random.default_rng(1)
    own = records[records["object"] == 3]
    assert {0, 1} == set(own["sensor"].tolist())
    others = records[records["object"] != 3]
    some = np.concatenate([rng.choice(part, 100) for part in (own, others)])
    for n, (record, ray) in enumerate(zip(some, rays_of(some, RIG, trajectory), strict=True)):
        hit = placed(trajectory.pose(int(record["time_ns"]))).cast_rays(o3d.core.Tensor(ray[None]))["t_hit"].item()
        if n < 100:
            assert hit == pytest.approx(record["range_m"], abs=1e-4)
        else:
            assert hit > record["range_m"]


def test_the_body_only_takes_returns_away_or_puts_its_own_in_their_place(tmp_path, sedan):
    """What is seen with the body is, firing by firing, what is seen without it, or the body, nearer than that."""
    world = scene(tmp_path, WORLD)
    trajectory = Trajectory(T_WORLD_START, build_path(MOTIONS["arc"]), START_NS)
    firing = ["sensor", "time_ns", "laser"]
    without, seen = (truth(RIG, world, trajectory, 10**8, body) for body in (None, sedan))
    before = {tuple(row[firing]): row for row in without}
    own = seen["object"] == 3
    for row in seen[~own]:
        assert row == before[tuple(row[firing])]
    nearer = [before[key]["range_m"] - row["range_m"] for row in seen[own] if (key := tuple(row[firing])) in before]
    assert len(nearer) > 1000
    assert min(nearer) > 0
    assert 0.6 < (~own).sum() / len(without) < 0.9


def test_the_bytes_without_a_body_stay_the_same(tmp_path, sedan):
    """Also with a body that no beam can reach, and with wide beams."""
    world = scene(tmp_path, WORLD)
    below = vehicle(
        VehicleFile.model_validate({"boxes": ({"name": "b", "center_m": (0, 0, -9), "size_m": (1, 1, 1)},)}), tmp_path
    )
    wide = replace(RIG, mounts=tuple(replace(one, realism=Realism(divergence=True)) for one in RIG.mounts))
    for rig in (RIG, wide):
        captures = []
        for body in (None, below, sedan):
            path = tmp_path / "capture.pcap"
            write_pcap(path, in_time_order(simulated_packets(rig, world, T_WORLD_START, 10**8, vehicle=body)))
            captures.append(path.read_bytes())
        assert captures[0] == captures[1]
        assert captures[0] != captures[2]
        assert len(captures[0]) == len(captures[2])


def test_wide_beams_return_from_the_body_and_from_behind_it(tmp_path, sedan):
    """Mixed beams at its edges: the same objects as thin ones nearly everywhere, and the body's cosine in the power."""
    world = scene(tmp_path, WORLD)
    trajectory = Trajectory(T_WORLD_START, build_path(STATIC), START_NS)
    wide = replace(RIG, mounts=tuple(replace(one, realism=Realism(divergence=True)) for one in RIG.mounts))
    thin, found = (truth(rig, world, trajectory, 10**8, sedan) for rig in (RIG, wide))
    own = thin["object"] == 3
    assert own.sum() > 1000
    key = [tuple(row) for row in found[["sensor", "time_ns", "laser", "return_type"]].tolist()]
    objects = dict(zip(key, found["object"].tolist(), strict=True))
    same = [objects.get(tuple(row[["sensor", "time_ns", "laser", "return_type"]].tolist())) == 3 for row in thin[own]]
    assert np.mean(same) > 0.98


def test_a_round_body_is_hit_exactly_wherever_the_vehicle_leans(tmp_path):
    """A mast beside the sensor: the nearest point of an upright cylinder by hand, under a pose that rolls and pitches."""
    mast = {"name": "mast", "base_m": (2.0, 0.0, 0.0), "radius_m": 0.1, "height_m": 9.0}
    bodies = vehicle(VehicleFile.model_validate({"cylinders": (mast,)}), tmp_path)
    rig = Rig("one", (mount(0, (0.0, 0.0, 2.0)),))
    T = np.eye(4)
    T[:3, :3] = rotation(np.array([0.2, -0.3, 1.0]))
    records = truth(
        rig,
        scene(tmp_path, "ground: {z_m: -40, reflectivity: 5}"),
        Trajectory(T, build_path(STATIC), START_NS),
        10**8,
        bodies,
    )
    hits = records[records["object"] == 1]
    flat = hits["range_m"] * np.cos(rig.mounts[0].sensor.elevation_rad[hits["laser"]])
    assert flat.min() == pytest.approx(1.9, abs=1e-4)
    assert flat.max() <= np.sqrt(4 - 0.01)


def test_a_rig_takes_its_vehicle_along(tmp_path):
    """Written and read in other folders; whole paths inside, relative ones in the file."""
    (tmp_path / "a").mkdir()
    text = (
        "name: r\nsensors: [{name: s, model: vlp-16, position_m: [0, 0, 1.8]}]\nvehicle:\n"
        "  meshes: [{name: body, file: ../sedan.ply, exclude: true}]\n  boxes: [{name: box, size_m: [1, 1, 0.1], center_m: [0, 0, 1.6]}]\n"
    )
    (tmp_path / "a/rig.yaml").write_text(text)
    (tmp_path / "sedan.ply").write_bytes(SEDAN.read_bytes())
    rig = load_rig(tmp_path / "a/rig.yaml")
    assert rig_vehicle(rig).scene.names == ("box", "body")
    (tmp_path / "b/c").mkdir(parents=True)
    save_rig(rig, tmp_path / "b/c/rig.yaml")
    assert "file: ../../sedan.ply" in (tmp_path / "b/c/rig.yaml").read_text()
    again = load_rig(tmp_path / "b/c/rig.yaml")
    assert again == rig
    assert rig_vehicle(again).excluded == ("body",)
    (tmp_path / "a/rig.yaml").write_text(text.replace("exclude", "excluded"))
    with pytest.raises(
        ConfigError, match=r"a/rig\.yaml:4:\d+: vehicle\.meshes\[0\]\.excluded: unknown key; did you mean exclude\?"
    ):
        rig_vehicle(load_rig(tmp_path / "a/rig.yaml"))
    (tmp_path / "a/rig.yaml").write_text(text.replace("sedan.ply", "none.ply"))
    with pytest.raises(ConfigError, match=r"vehicle\.meshes\[0\]\.file: .*none\.ply: no such file"):
        rig_vehicle(load_rig(tmp_path / "a/rig.yaml"))
    (tmp_path / "a/rig.yaml").write_text(text.split("vehicle:")[0] + "vehicle: 3\n")
    with pytest.raises(ConfigError, match=r"vehicle: 3 is not a map of keys"):
        load_rig(tmp_path / "a/rig.yaml")


def test_the_command_takes_the_rigs_vehicle_another_one_or_none(tmp_path):
    (tmp_path / "scene.yaml").write_text(f"name: s\n{WORLD}")
    bare = "name: r\nsensors: [{name: s, model: vlp-16, position_m: [2.45, 0, 0.6]}]\n"
    (tmp_path / "bare.yaml").write_text(bare)
    (tmp_path / "rig.yaml").write_text(bare + f"vehicle: {{meshes: [{{name: body, file: {SEDAN}}}]}}\n")
    (tmp_path / "roof.yaml").write_text("boxes: [{name: plate, size_m: [1, 1, 0.1], center_m: [3.5, 0, 0.2]}]\n")
    found = {}
    for name, rig, options in (
        ("bare", "bare.yaml", ()),
        ("rig", "rig.yaml", ()),
        ("none", "rig.yaml", ("--vehicle", "none")),
        ("mesh", "bare.yaml", ("--vehicle", SEDAN)),
        ("plate", "rig.yaml", ("--vehicle", tmp_path / "roof.yaml")),
    ):
        out = tmp_path / f"{name}.pcap"
        given = ("--scene", tmp_path / "scene.yaml", "--duration", 0.1, "-o", out, "--truth", out.with_suffix(".npz"))
        lidarcfg("export", tmp_path / rig, *given, *options)
        with np.load(out.with_suffix(".npz")) as file:
            found[name] = out.read_bytes(), file["object_names"].tolist(), set(file["object"].tolist())
    assert found["bare"] == found["none"]
    assert found["rig"] == found["mesh"]
    assert found["rig"][0] != found["bare"][0]
    assert found["rig"][1][-1] == "vehicle/body"
    assert found["plate"][1][-1] == "vehicle/plate"
    assert 3 in found["plate"][2]


def test_a_sensor_inside_the_body_is_an_error(tmp_path, sedan):
    inside = Rig("r", (mount(0, (0.0, 0.0, 1.8)), mount(1, (0.0, 0.0, 1.0))))
    with pytest.raises(
        ConfigError, match=r"^lidar_1 is inside the vehicle's 'body'; move it, or set allow_inside: true$"
    ):
        simulated_packets(inside, scene(tmp_path, WORLD), T_WORLD_START, SECOND_NS, vehicle=sedan)
    allowed = replace(sedan, allow_inside=True)
    assert len(simulated_packets(inside, scene(tmp_path, WORLD), T_WORLD_START, SECOND_NS, vehicle=allowed)) == 2
