"""What a user of Python meets first: rigs made by hand, exports with all that the command offers, clear errors."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lidarcfg
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.sensors.sensor import Sensor
from tests import command_line

BOX = {"boxes": [{"name": "body", "center_m": [0, 0, 0.8], "size_m": [4, 1.8, 1.4], "exclude": True}]}
WALL = {"name": "wall", "center_m": [6, 0, 2], "size_m": [1, 20, 4], "reflectivity": 40}
SCENE = {"ground": {"reflectivity": 12}, "boxes": [WALL]}
STUDY = {
    "region": {"min_m": [-6, -6, 0], "max_m": [6, 6, 3], "cuboid_m": [1, 1, 1]},
    "sensors": [
        {
            "model": "vlp-16",
            "min": {"position_m": [-1, -0.5, 1.8], "rpy_deg": [0, 0, 0]},
            "max": {"position_m": [1, 0.5, 2.2], "rpy_deg": [0, 9, 0]},
        }
    ],
    "objective": {"max_vsr": 1},
    "solver": {"evaluations": 1000},
}


def two():
    sensor = lidarcfg.load_sensor("vlp-16")
    mounts = [lidarcfg.Mount("left", sensor, (0.5, 0.6, 1.9)), lidarcfg.Mount("right", sensor, (0.5, -0.6, 1.9))]
    return lidarcfg.Rig("two", mounts)


def arrays(path):
    with np.load(path) as file:
        return dict(file)


def pose_of(euler_xyz_deg, position_m):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", euler_xyz_deg, degrees=True).as_matrix()  # about the fixed axes x, y, z
    T[:3, 3] = position_m
    return T


def test_a_rig_by_hand_is_what_its_file_says(tmp_path):
    """The file has no more than the hand gave; what it leaves out is by default the same."""
    (tmp_path / "two.yaml").write_text(
        "sensors:\n- {name: left, model: vlp-16, position_m: [0.5, 0.6, 1.9]}\n"
        "- {name: right, model: vlp-16, position_m: [0.5, -0.6, 1.9]}\n"
    )
    made = two()
    assert made == lidarcfg.load_rig(tmp_path / "two.yaml")
    assert [mount.host for mount in made.mounts] == ["192.168.1.201", "192.168.1.202"]
    lidarcfg.save_rig(made, tmp_path / "saved.yaml")
    assert replace(lidarcfg.load_rig(tmp_path / "saved.yaml"), name="two") == made
    assert made.mount("left").rpm == 600
    by_name = lidarcfg.Mount("left", "vlp-16", np.array([0.5, 0.6, 1.9]), host="192.168.1.201")
    assert by_name == made.mount("left")


@pytest.mark.parametrize(
    "euler", [(0, 0, 0), (10, -20, 130), (180, 0, 0), (0, 90, 0), (0, -90, 45), (-170, 30, -179.5)]
)
def test_a_mount_from_a_pose(euler):
    """scipy makes the rotation, and says that the mount has the same."""
    T = pose_of(euler, (1.25, -0.5, 1.9))
    mount = lidarcfg.Mount.from_pose("a", lidarcfg.load_sensor("vlp-16"), T)
    np.testing.assert_allclose(mount.T_vehicle_sensor, T, rtol=0, atol=1e-12)
    turned = Rotation.from_euler("xyz", mount.rpy_rad).inv() * Rotation.from_matrix(T[:3, :3])
    assert turned.magnitude() < 1e-9
    single = lidarcfg.Mount.from_pose("a", "vlp-16", T.astype(np.float32), rpm=300)
    np.testing.assert_allclose(single.T_vehicle_sensor, T, rtol=0, atol=1e-6)
    assert single.rpm == 300


def test_a_quarter_turn_by_hand():
    """Yaw of 90° takes the sensor's x axis to the vehicle's y axis: columns are the sensor's axes."""
    T = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    mount = lidarcfg.Mount.from_pose("a", "vlp-16", T)
    assert mount.position_m == (1, 2, 3)
    np.testing.assert_allclose(mount.rpy_rad, (0, 0, np.pi / 2), atol=1e-15)


@pytest.mark.parametrize(
    ("T", "what"),
    [
        (np.eye(3), r"a: T_vehicle_sensor has the shape \(3, 3\); allowed: a pose \(4, 4\)"),
        (np.diag([2.0, 2, 2, 1]), "is no rotation: R Rᵀ differs from 1 by 3"),
        (np.diag([1.0, -1, 1, 1]), "is a mirror"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.0, 1, 1, 2]), "has the last row 0 0 0 2; allowed: 0 0 0 1"),
        (pose_of((0, 0, 0), (1e9, 0, 0)), "more than 1e"),
        ("roof", "is a str; allowed: a pose"),
        (None, "has the shape|is a NoneType"),
    ],
)
def test_matrices_that_are_no_poses(T, what):
    with pytest.raises(ConfigError, match=what):
        lidarcfg.Mount.from_pose("a", "vlp-16", T)
    if T is not None:
        with pytest.raises(ConfigError, match=what.removeprefix("a: T_vehicle_sensor ")):
            lidarcfg.export(two(), SCENE, "never.pcap", 0.01, at=T)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: lidarcfg.Mount("a", 3, (0, 0, 1)), "a: an int is no sensor; allowed: a Sensor, its name"),
        (lambda: lidarcfg.Mount("a", "vlp-17", (0, 0, 1)), "did you mean vlp-16"),
        (lambda: lidarcfg.Mount("a", "vlp-16", (0, 1)), r"a: position_m is \(0, 1\); allowed: three numbers"),
        (
            lambda: lidarcfg.Mount("a", "vlp-16", (0, 0, 1), return_mode="all"),
            "a: return_mode is 'all'; allowed: strong",
        ),
        (lambda: lidarcfg.Rig("r", [3]), "rig 'r': an int is no mount"),
        (lambda: lidarcfg.Rig("r", [*two().mounts, two().mounts[0]]), "two sensors are called 'left'"),
        (lambda: lidarcfg.Rig("r", two().mounts, vehicle=3), "an int is no vehicle; allowed: a Vehicle"),
    ],
)
def test_rigs_that_are_none(make, what):
    with pytest.raises(ConfigError, match=what):
        make()


@pytest.mark.parametrize(
    ("mounts", "what"),
    [
        (
            lambda: [replace(one, host="192.168.1.7") for one in two().mounts],
            "rig 'r': 192.168.1.7:2368 is that of 'left' and 'right'; give each its own",
        ),
        (
            lambda: [lidarcfg.Mount("a b", "vlp-16", (0, 0, 1))],
            "rig 'r': 'a b' is no sensor's name; allowed: a text that",
        ),
    ],
)
def test_rigs_that_no_file_may_have_are_neither_saved_nor_exported(tmp_path, mounts, what):
    rig = lidarcfg.Rig("r", mounts())
    for write in (
        lambda: lidarcfg.save_rig(rig, tmp_path / "r.yaml"),
        lambda: lidarcfg.export(rig, SCENE, tmp_path / "a.pcap", 0.01),
    ):
        with pytest.raises(ConfigError, match=what):
            write()
    assert not list(tmp_path.iterdir())


def test_a_sensor_that_is_in_no_file_is_not_saved(tmp_path):
    known = lidarcfg.load_sensor("vlp-16")
    own = Sensor.model_validate(known.model_dump(exclude_unset=True) | {"name": "own"})
    with pytest.raises(ConfigError, match="sensor 'own' has more than elevations and is in no file"):
        lidarcfg.save_rig(lidarcfg.Rig("r", [lidarcfg.Mount("a", own, (0, 0, 1))]), tmp_path / "r.yaml")
    assert not list(tmp_path.iterdir())


def test_a_vehicle_stands_where_its_keys_would():
    """In a study's dict, in a rig's, and as an argument: the same cuboids are left out, and the same rays blocked."""
    body = lidarcfg.load_vehicle(BOX)
    told = lidarcfg.load_study(STUDY | {"vehicle": BOX})
    found = lidarcfg.load_study(STUDY | {"vehicle": body})
    assert found.file == told.file
    assert (found.region.included == told.region.included).all()
    assert (~found.region.included).sum() == 4 * 2 * 1  # whose middles are in the box: x ±1.5, ±0.5; y ±0.5; z 0.5
    rig = lidarcfg.Rig("r", two().mounts, vehicle=body)
    assert lidarcfg.Rig("r", two().mounts, vehicle=BOX).vehicle.values.keys() == {"boxes"}
    assert rig.vehicle == body.section
    sensors = [{"name": "a", "model": "vlp-16", "position_m": [0, 0, 1.9]}]
    assert lidarcfg.load_rig({"sensors": sensors, "vehicle": body}).vehicle.values.keys() == {"boxes"}
    with pytest.raises(ConfigError, match=r"study: vehicle: a Scene is not a map of keys$"):
        lidarcfg.load_study(STUDY | {"vehicle": lidarcfg.load_scene(SCENE)})


def test_an_export_has_what_the_command_has(tmp_path):
    """Byte for byte the command's capture and truth, with vehicle, start and return mode; objects in place of files."""
    (tmp_path / "body.json").write_text(str(BOX).replace("'", '"').replace("True", "true"))
    (tmp_path / "scene.json").write_text(str(SCENE).replace("'", '"'))
    lidarcfg.save_rig(two(), tmp_path / "two.yaml")
    start_ns = 1_800_000_000_250_000_000  # 2027-01-15 08:00:00.25
    found = lidarcfg.export(
        two(),
        SCENE,
        tmp_path / "ours.pcap",
        0.02,
        vehicle=lidarcfg.load_vehicle(BOX),
        start_ns=start_ns,
        return_mode="last",
        truth=tmp_path / "ours.npz",
    )
    command_line.lidarcfg(
        *("export", tmp_path / "two.yaml", "--scene", tmp_path / "scene.json", "--duration", "0.02"),
        *("--vehicle", tmp_path / "body.json", "--start", "2027-01-15T08:00:00.25", "--return-mode", "last"),
        *("-o", tmp_path / "theirs.pcap", "--truth", tmp_path / "theirs.npz", "--quiet"),
    )
    assert (tmp_path / "ours.pcap").read_bytes() == (tmp_path / "theirs.pcap").read_bytes()
    ours, theirs = (arrays(tmp_path / f"{name}.npz") for name in ("ours", "theirs"))
    assert ours.keys() == theirs.keys()
    assert all(np.array_equal(ours[key], theirs[key]) for key in ours)
    assert "vehicle/body" in ours["object_names"]
    assert 0 < found.hits < found.rays
    assert {path.name for path in found.files} == {path.name for path in tmp_path.glob("ours*")}
    cloud = lidarcfg.decode(tmp_path / "ours.pcap", deskew=True, truth=tmp_path / "ours.npz")
    assert set(np.array(cloud.object_names)[np.unique(cloud.object)]) <= {*ours["object_names"].tolist()}
    assert cloud.time_ns.min() >= start_ns - 10**7
    again = lidarcfg.load_vehicle(tmp_path / "ours.pcap.vehicle.yaml")
    assert again.file == lidarcfg.load_vehicle(BOX).file


def test_parts_of_an_export(tmp_path):
    """A capture of each sensor holds the packets that the capture of all has of it; a part of it, those of its time."""
    whole = lidarcfg.export(two(), SCENE, tmp_path / "a.pcap", 0.04)
    fractions = []
    parts = lidarcfg.export(two(), SCENE, tmp_path / "b.pcap", 0.04, split=True, on_progress=fractions.append)
    assert [path.name for path in parts.files[:2]] == ["b-left.pcap", "b-right.pcap"]
    assert parts.count == whole.count
    assert sorted(fractions) == fractions
    assert fractions[-1] == 1
    cloud = lidarcfg.decode(tmp_path / "a.pcap")
    left = lidarcfg.decode(tmp_path / "b-left.pcap")
    assert np.array_equal(cloud.xyz[cloud.sensor == 0], left.xyz)
    assert np.array_equal(lidarcfg.decode(tmp_path / "a.pcap", sensors="left").xyz, left.xyz)
    rig = {"sensors": [{"name": f"s{i}", "model": "vlp-16", "position_m": [0, 0, i]} for i in range(2)]}
    assert lidarcfg.decode(tmp_path / "a.pcap", rig).sensor_names == ("s0", "s1")
    late = lidarcfg.decode(tmp_path / "a.pcap", from_s=0.02)
    first_ns = cloud.time_ns.min()
    assert 0 < len(late.xyz) < len(cloud.xyz)
    assert (late.time_ns.min() - first_ns) / 1e9 == pytest.approx(0.02, abs=0.003)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"output": np.zeros(3)}, "output is a ndarray; allowed: a path"),
        ({"output": None}, "output is a NoneType; allowed: a path"),
        ({"duration_s": "0.1"}, "duration_s is a str; allowed: above 0"),
        ({"start_ns": 1.5}, "start_ns is 1.5; allowed: whole microseconds"),
        ({"start_ns": 1}, "start_ns is 1; allowed: whole microseconds"),
        ({"truth": "truth.txt"}, "truth 'truth.txt' does not end in .npz"),
        ({"output": "a.ply", "truth": "truth.npz"}, "split and truth are for a .pcap"),
        ({"output": "a.ply", "split": True}, "split and truth are for a .pcap"),
        ({"deskew": True}, "deskew is for points"),
        ({"output": "a.mcap", "deskew": True}, "deskew is for ply, npz, pcd"),
        ({"vehicle": "nowhere.yaml"}, "nowhere.yaml: no such file or directory"),
        ({"vehicle": 3}, "an int is no vehicle"),
        ({"vehicle": {"boxs": []}}, "vehicle: boxs: unknown key; did you mean boxes"),
        ({"scene": "nowhere.yaml"}, "nowhere.yaml: no such file or directory"),
        ({"trajectory": "nowhere.tum"}, "nowhere.tum: no such file or directory"),
        ({"return_mode": "all"}, "left: return_mode is 'all'"),
        ({"output": "/proc/none/a.pcap"}, "/proc/none.*: no such file or directory"),
    ],
)
def test_exports_that_are_none(tmp_path, monkeypatch, changes, what):
    """One line, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(LidarcfgError, match=what) as raised:
        lidarcfg.export(**{"rig": two(), "scene": SCENE, "output": "a.pcap", "duration_s": 0.01} | changes)
    assert len(str(raised.value).splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: lidarcfg.decode(np.zeros(3)), "capture is a ndarray; allowed: a path"),
        (lambda: lidarcfg.decode("nowhere.pcap"), "nowhere.pcap: no such file or directory"),
        (lambda: lidarcfg.decode("nowhere.pcap", two(), from_s=2, to_s=1), "nothing from 2 s to 1 s"),
        (lambda: lidarcfg.decode("nowhere.pcap", two(), deskew=True, trajectory="a.tum"), "allowed: one of them"),
        (lambda: lidarcfg.view(), "there is nothing to show"),
        (lambda: lidarcfg.view(np.zeros((3, 3))), "a ndarray is not shown; allowed: a file, a PointCloud"),
        (lambda: lidarcfg.view(two(), by="color"), "by is 'color'; allowed: sensor, intensity"),
        (lambda: lidarcfg.view(two()).save(np.zeros(3)), "path is a ndarray"),
        (lambda: lidarcfg.view(two()).save("a.png", camera=(1, 2)), "camera has 2 numbers"),
        (lambda: lidarcfg.view(two()).save("/proc/none/a.html"), "no such file or directory"),
        (lambda: lidarcfg.save_rig(BOX, "a.yaml"), "a dict is no rig"),
        (lambda: lidarcfg.save_rig(two(), np.zeros(3)), "path is a ndarray"),
        (lambda: lidarcfg.save_rig(two(), "/proc/none/a.yaml"), "no such file or directory"),
        (lambda: lidarcfg.compare(STUDY, two()), "rigs are a list of rigs"),
        (lambda: lidarcfg.compare(STUDY, [two()]), "1 rig to compare; allowed: 2 to 10"),
        (lambda: lidarcfg.evaluate(STUDY, two(), tolerance="1%"), "tolerance is '1%'; allowed: a number above 0"),
        (lambda: lidarcfg.optimize(STUDY, evaluations=0), "solver.evaluations: 0 is too small"),
        (lambda: lidarcfg.optimize(STUDY, starts=two()), "rigs are a list of rigs"),
        (lambda: lidarcfg.load_sensor(3), "an int is no sensor"),
        (lambda: lidarcfg.load_vehicle(np.zeros(3)), "a ndarray is no vehicle"),
        (lambda: lidarcfg.Trajectory.from_poses("ab", np.zeros((2, 4, 4))), "times or poses are no numbers"),
    ],
)
def test_arguments_that_are_none(tmp_path, monkeypatch, call, what):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(LidarcfgError, match=what) as raised:
        call()
    assert len(str(raised.value).splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_search_takes_a_budget_and_rigs_to_begin_with(tmp_path):
    """As the study's own solver has them: the same seed and budget, the same rig."""
    given = lidarcfg.optimize(STUDY, evaluations=40, seed=7)
    told = lidarcfg.optimize(STUDY | {"solver": {"evaluations": 40, "seed": 7}})
    assert given.rig == told.rig
    assert given.evaluations == 40
    lidarcfg.save_rig(given.rig, tmp_path / "found.yaml")
    again = lidarcfg.optimize(STUDY, evaluations=2, starts=[tmp_path / "found.yaml"])
    assert again.objective <= given.objective


@pytest.mark.slow
def test_results_are_short_in_words_and_go_to_other_processes():
    """Their repr is a line, and what pickle brings back is the same."""
    study = lidarcfg.load_study(STUDY | {"vehicle": BOX})
    rigs = [two(), two().moved("left", position_m=(0.5, 0.6, 2.2))]
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda rig: lidarcfg.evaluate(study, rig), rigs))
    assert [one.max_vsr_m for one in found] == [lidarcfg.evaluate(study, rig).max_vsr_m for rig in rigs]
    placement = lidarcfg.optimize(STUDY, evaluations=4)
    for shown in (study, *rigs, *found, placement, lidarcfg.compare(study, rigs), lidarcfg.view(two())):
        assert repr(shown).startswith("<")
        assert len(repr(shown)) < 300
        assert "array(" not in repr(shown)
        assert repr(pickle.loads(pickle.dumps(shown))) == repr(shown)
    assert pickle.loads(pickle.dumps(placement)).rig == placement.rig


def test_every_name_says_what_it_is():
    """Public names only, each with a text that begins with a sentence."""
    assert not [name for name in dir(lidarcfg) if name.startswith("_") and not name.startswith("__")]
    for name in dir(lidarcfg):
        said = (getattr(lidarcfg, name).__doc__ or "").split("\n\n")[0]
        assert said.rstrip().endswith((".", ":")) or said.endswith(")."), name
