"""Stills: a pinhole worked by hand, points and bodies where they belong, and what cannot be drawn."""

import re
from dataclasses import replace
from pathlib import Path

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.ground_truth import TruthFile, load_objects
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.selection import Selection
from lidarcfg.cli.view import view
from lidarcfg.clouds.cloud import PointCloud, save_clouds
from lidarcfg.core import viewer as core
from lidarcfg.errors import CloudError, ConfigError, PacketError
from lidarcfg.geometry import pose, transform
from lidarcfg.sensors.rig import Rig, load_rig, rig_text
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.extents import extents
from lidarcfg.study.loading import load_study
from lidarcfg.viewer.bodies import faces, score
from lidarcfg.viewer.camera import Camera
from lidarcfg.viewer.colours import BACKGROUND, BRIGHT, COLOUR_BY, RETRO, SCALE, colour, point_colours, rgb, scaled
from lidarcfg.viewer.contents import Contents, kind_to_show, load_contents
from lidarcfg.viewer.still import save_still
from lidarcfg.viewer.window import parts
from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.metric import surface_m2
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from lidarcfg.world.motion import Trajectory
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import AT_NS, STREET, no_warning, recording, scene, tilted_rig
from tests.search.test_requirements_search import CHOICE

STILLS = Path(__file__).parent / "stills"
STUDY = STREET.parent.parent / "studies/sedan.yaml"
ROOF = STREET.parent.parent / "rigs/roof.yaml"


def cloud(xyz, names=("a", "b")):
    xyz = np.asarray(xyz, np.float64).reshape(-1, 3)
    zeros = np.zeros(len(xyz), np.uint8)
    sensor = (np.arange(len(xyz)) % len(names)).astype(np.uint16)
    return PointCloud(xyz, zeros + 50, zeros, np.zeros(len(xyz), np.int64), sensor, names, zeros)


def contents(points=(), **parts):
    empty = {"objects": None, "rigs": (), "study": None, "scenes": (), "T_world_vehicle": np.eye(4)}
    return Contents(cloud(points), **(empty | parts))


def drawn(path):
    return np.round(matplotlib.image.imread(path)[..., :3] * 255)


def test_a_pinhole_by_hand():
    camera = Camera(np.zeros(3), np.array([10.0, 0, 0]), 90.0)
    column, row, depth = camera.project(np.array([[5, 0, 0], [5, -5, 0], [5, 0, 2.5], [-1, 0, 0]]), 200, 100)
    assert depth == pytest.approx([5, 5, 5, -1])
    assert column[:3] == pytest.approx([100, 200, 100])  # 45 degrees to the right is the right edge
    assert row[:3] == pytest.approx([50, 50, 0])  # up is up


def test_both_sensors_colours_are_in_the_picture(tmp_path):
    rng = np.random.default_rng(1)
    save_still(contents(rng.uniform((-20, -10, 0), (20, 10, 3), (20_000, 3))), tmp_path / "p.png")
    image = drawn(tmp_path / "p.png")
    assert image.shape == (1080, 1920, 3)
    blue = (image[..., 2] > image[..., 0] + 60).sum()
    orange = (image[..., 0] > image[..., 2] + 60).sum()
    assert blue > 10_000
    assert orange > 10_000
    assert (image == BACKGROUND).all(axis=-1).sum() > 100_000


@pytest.mark.parametrize("size", [(1200, 700), (640, 360), (1920, 1080), (40, 24)])
def test_no_label_leaves_the_view_from_above(tmp_path, size):
    """By the picture: the columns at its left edge are bare beside the axes, of which the tick at −10 is the widest."""
    save_still(contents(np.array([[-30.0, 0, 0], [30, 0, 0]])), tmp_path / "p.png", size)
    pixels = matplotlib.image.imread(tmp_path / "p.png")[round(size[1] * 0.62) : round(size[1] * 0.9)]
    assert len(np.unique(pixels[:, : max(size[0] // 400, 1), :3].reshape(-1, 3), axis=0)) == 1


@pytest.mark.parametrize(
    ("size_m", "rows", "columns"),
    [((18, 14), slice(0, 700), slice(624, 1200)), ((90, 10), slice(420, 700), slice(0, 1200))],
)
def test_the_view_from_above_fits_what_is_there(tmp_path, size_m, rows, columns):
    """A hall beside the perspective, a street below it: the outline's pixels are in proportion and fill most of it."""
    along = np.linspace(-0.5, 0.5, 2000)
    side = np.full_like(along, 0.5)
    outline = np.concatenate([[along, side], [along, -side], [side, along], [-side, along]], axis=1).T * size_m
    save_still(contents(np.column_stack([outline, np.zeros(len(outline))])), tmp_path / "p.png", (1200, 700))
    image = drawn(tmp_path / "p.png")[rows, columns]
    found = np.argwhere(np.ptp(image, axis=-1) > 60)
    high, wide = np.ptp(found, axis=0)
    assert wide / high == pytest.approx(size_m[0] / size_m[1], rel=0.03)
    assert wide > 0.8 * image.shape[1] or high > 0.8 * image.shape[0]


def test_an_empty_stage_is_refused(tmp_path):
    with pytest.raises(CloudError, match="the cloud is empty"):
        save_still(contents(), tmp_path / "p.png")
    assert list(tmp_path.iterdir()) == []


def test_straight_down_and_straight_up():
    """Looking down +x is up and +y to the left; looking up, as lying on one's back with the feet ahead."""
    points = np.array([[1.0, 0, 0], [0, 1, 0]])
    for height, rows in ((10.0, [45, 50]), (-10.0, [55, 50])):
        camera = Camera(np.array([0, 0, height]), np.zeros(3), 90.0)
        column, row, depth = camera.project(points, 100, 100)
        assert depth == pytest.approx([10, 10])
        assert column == pytest.approx([50, 45])
        assert row == pytest.approx(rows)


@pytest.mark.parametrize(
    ("eye", "target", "field", "message"),
    [
        ((0, 0, 0), (0, 0, 0), 60, "eye and target are one point"),
        ((0, 0, 0), (0, 0, 1e-9), 60, "eye and target are one point"),
        ((np.nan, 0, 0), (0, 0, 1), 60, "a coordinate is not a number up to 1e"),
        ((0, 0, 0), (0, np.inf, 1), 60, "a coordinate is not a number up to 1e"),
        ((0, 0, 0), (0, 0, 1), 180, "field of view 180°; allowed: 1 to 170"),
        ((0, 0, 0), (0, 0, 1), np.nan, "field of view nan°; allowed: 1 to 170"),
    ],
)
def test_a_camera_that_sees_nothing_is_refused(eye, target, field, message):
    with pytest.raises(ConfigError, match=message):
        Camera(np.array(eye, np.float64), np.array(target, np.float64), field)


def test_a_camera_that_looks_away_is_refused(tmp_path):
    away = Camera(np.array([0.0, 0, 1]), np.array([-5.0, 0, 1]))
    with pytest.raises(CloudError, match="nothing is in view of a camera at 0,0,1 that looks at -5,0,1"):
        save_still(contents(np.full((5, 3), 7.0)), tmp_path / "p.png", camera=away)
    assert list(tmp_path.iterdir()) == []


def test_the_scale_is_viridis():
    ours = scaled(np.linspace(0, 1, 50), 0, 1)
    share = np.linspace(1 / 6, 1, 50)
    theirs = 255 * matplotlib.colormaps["viridis"](share)[:, :3]
    assert abs(ours - theirs).max() < 12


def test_eighteen_objects_look_different():
    """Any two of their colours are 30 of 255 apart in some channel, and all are brighter than the background."""
    found = rgb([colour(i) for i in range(18)]).astype(int)
    apart = abs(found[:, None] - found).max(axis=-1)
    assert (apart[~np.eye(18, dtype=bool)] >= 30).all()
    assert (found.max(axis=1) > 2 * max(BACKGROUND)).all()
    assert (found[:6] == rgb(BRIGHT)).all()


@pytest.mark.parametrize("by", COLOUR_BY[:-1])
def test_colours_of_points_by_hand(by):
    seen = cloud([[0, 0, 0], [0, 0, 1], [0, 0, 2]])
    seen = replace(
        seen,
        intensity=np.array([0, 100, 255], np.uint8),
        ring=np.array([0, 7, 14], np.uint8),
        time_ns=np.array([10, 10 + 5 * 10**8, 10 + 10**9]),
    )
    found = point_colours(replace(contents(), cloud=seen), by)
    low, high = rgb([SCALE[0]])[0], rgb([SCALE[-1]])[0]
    if by == "sensor":  # a, b, a; 70 % as bright where nothing comes back
        base = rgb(BRIGHT[:2])
        assert (found == [(0.7 * base[0]).astype(np.uint8), base[1], base[0]]).all()
    elif by == "intensity":
        assert (found == [low, high, rgb([RETRO])[0]]).all()
    else:
        assert (found[0] == low).all()
        assert abs(found[2].astype(int) - high).max() <= 1


def test_a_triangle_is_blended_where_it_is_nearer():
    """Half a picture, at 4 m, before and behind points at 3 and 5 m; and one that is cut at the near plane."""
    image = np.zeros((4, 4, 3), np.float32)
    depth = np.array([[3.0, 5, 3, 5]] * 4, np.float32)
    square = np.array([[-9.0, -9, 4], [9, -8, 4], [9.3, 8.9, 4], [-9, 9, 4]])
    blended = core.blend_triangles(
        image, depth, square[[[0, 1, 2], [0, 2, 3]]], np.full((2, 3), 100.0), np.full(2, 0.5), 4.0, 0.1
    )
    assert blended == 8
    assert (image[..., 0] == [[0, 50, 0, 50]] * 4).all()
    floor = np.array([[[-1e3, -1, -1e3], [1e3, -1, -1e3], [0, -1, 1e4]]])  # from behind the camera to far ahead
    image[:] = 0
    core.blend_triangles(image, np.full_like(depth, np.inf), floor, np.full((1, 3), 100.0), np.ones(1), 4.0, 0.1)
    assert (image[..., 0] == [[0] * 4, [0] * 4, [100] * 4, [100] * 4]).all()


@pytest.mark.parametrize("seed", range(4))
def test_faces_have_the_surface_that_the_measure_counts(seed):
    """Merged faces of random subspaces: their area is surface_m2, and each cuboid's face is covered once."""
    rng = np.random.default_rng(seed)
    region = Region.from_boxes((-1, 0, 2), (4, 6, 5), (1, 1.5, 0.5), (((0, 1, 2), (2, 4, 3)),))
    lidars = [lidar(rng.uniform(-1, 4, 3), rng.uniform(-1, 1, 3), np.sin([-0.3, 0.2])) for _ in range(2)]
    spaces = segment(region, lidars)
    numbers = range(len(spaces))
    for number, surface, extent in zip(numbers, surface_m2(spaces), extents(spaces, numbers), strict=True):
        quads = faces(region, spaces.label == number)
        sides = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
        assert np.linalg.norm(sides, axis=1).sum() == pytest.approx(surface)
        assert (quads.reshape(-1, 3).min(axis=0), quads.reshape(-1, 3).max(axis=0)) == tuple(
            pytest.approx(corner) for corner in extent.bounds_m
        )


@pytest.mark.slow
def test_scores_are_those_of_evaluate():
    study = load_study(STUDY)
    rig = study.rig(study.space.poses(np.full((1, study.space.dimensions), 0.3))[0])
    ours, theirs = score(study, rig, 10), evaluate(study, rig)
    assert (ours.max_vsr_m, ours.subspaces) == (theirs.max_vsr_m, len(theirs.subspaces))
    for body, worst in zip(ours.worst, theirs.worst, strict=True):
        assert (body.vsr_m, body.volume_m3) == (worst.vsr_m, worst.volume_m3)
        assert body.centroid_m.tolist() == worst.centroid_m


@pytest.mark.parametrize("mode", ["strongest", "last", "dual"])
def test_objects_of_a_capture_are_the_ones_that_its_points_lie_on(tmp_path, mode):
    """Of each decoded point the truth's object, against the distance of the point to each object's surface."""
    text = "ground: {reflectivity: 20}\nboxes: [{name: wall, center_m: [0, -9, 2], size_m: [30, 1, 4], reflectivity: 40}]\n"
    text += "spheres: [{name: ball, center_m: [6, -3, 1.5], radius_m: 1.5, reflectivity: 60}]"
    seen = scene(tmp_path, text)
    tilted = tilted_rig()
    rig = replace(tilted, mounts=tuple(replace(mount, return_mode=mode) for mount in tilted.mounts))
    with TruthFile(tmp_path / "t.npz", [m.name for m in rig.mounts], seen.names) as truth:
        streams = simulated_packets(rig, seen, Trajectory.static(np.eye(4)), 30_000_000, AT_NS, truth.add)
        write_pcap(tmp_path / "t.pcap", in_time_order(streams))
        truth.save()
    paths = [tmp_path / "t.pcap", tmp_path / "t.npz"]
    (tmp_path / "rig.yaml").write_text(rig_text(rig))
    staged = load_contents(paths, tmp_path / "rig.yaml", None, np.eye(4), no_warning)
    xyz = staged.cloud.xyz
    names = np.array(staged.objects.names)[staged.objects.index]
    away = {
        "ground": abs(xyz[:, 2]),
        "wall": np.linalg.norm(np.maximum(abs(xyz - (0, -9, 2)) - (15, 0.5, 2), 0), axis=1),
        "ball": abs(np.linalg.norm(xyz - (6, -3, 1.5), axis=1) - 1.5),
    }
    assert set(names.tolist()) == set(away)
    for name, distance in away.items():
        assert distance[names == name].max() < 0.02, name


def test_a_truth_of_another_capture_is_refused(tmp_path):
    fields = {"sensor": [0], "time_ns": [5], "laser": [0], "return_type": [0], "object": [0]}
    arrays = {key: np.array(values) for key, values in fields.items()}
    np.savez(tmp_path / "t.npz", sensor_names=["lidar_0"], object_names=["wall"], **arrays)
    seen = replace(cloud([[1, 2, 3]], ("lidar_0",)), time_ns=np.array([10**15]))
    with pytest.raises(CloudError, match="it belongs to another capture"):
        load_objects(tmp_path / "t.npz", seen, tilted_rig())
    with pytest.raises(CloudError, match="its sensor 'lidar_0' is not in the rig 'none'"):
        load_objects(tmp_path / "t.npz", seen, Rig("none", ()))
    (tmp_path / "u.npz").write_bytes(b"PK no")
    with pytest.raises(CloudError, match=r"u\.npz: not a whole npz file: "):
        load_objects(tmp_path / "u.npz", seen, tilted_rig())


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"laser": [256]}, "laser holds a number outside 0 to 255"),
        ({"sensor": [-1]}, "sensor holds a number outside 0 to 0"),
        ({"object": [1]}, "object holds a number outside -1 to 0"),
        ({"object": [0.5]}, "is not a ground-truth file: its columns are not integers"),
        ({"sensor_names": 3.0}, "is not a ground-truth file: its names are not lists of texts"),
        ({"object_names": [[b"a"]]}, "is not a ground-truth file: its names are not lists of texts"),
        ({"time_ns": [5, 6]}, "the fields differ in length"),
        ({"time_ns": None}, "is not a ground-truth file: it has no time_ns"),
    ],
)
def test_ground_truth_that_lies(tmp_path, other, message):
    fields = {"sensor": [0], "time_ns": [5], "laser": [0], "return_type": [0], "object": [0]} | other
    arrays = {key: np.array(values) for key, values in fields.items() if values is not None}
    np.savez(tmp_path / "t.npz", **{"sensor_names": ["lidar_0"], "object_names": ["wall"]} | arrays)
    with pytest.raises(CloudError, match=message):
        load_objects(tmp_path / "t.npz", cloud([[1, 2, 3]], ("lidar_0",)), tilted_rig())


def test_files_are_recognised(tmp_path):
    save_clouds(tmp_path / "c.npz", [cloud([[1, 2, 3]])])
    np.savez(tmp_path / "t.npz", object_names=["a"])
    (tmp_path / "raw").write_bytes(bytes.fromhex("d4c3b2a1") + bytes(20))
    kinds = [(STUDY, "study"), (ROOF, "rig"), (STREET, "scene"), (tmp_path / "c.npz", "cloud")]
    kinds += [(tmp_path / "t.npz", "truth"), (tmp_path / "raw", "capture"), (Path("x.pcapng"), "capture")]
    for path, kind in kinds:
        assert kind_to_show(path) == kind


@pytest.mark.parametrize(
    ("files", "error", "message"),
    [
        ({"a.txt": "hello"}, ConfigError, "a.txt: is not a capture, cloud, rig, study or scene; allowed: .pcap"),
        ({"a.yaml": "name: x"}, ConfigError, "a.yaml:1:1: is not a rig"),
        ({"a.yaml": "[1, 2]"}, ConfigError, "a.yaml:1:1: a list of 2 is not a map of keys"),
        ({"a.yaml": "a: ["}, ConfigError, "a.yaml:1:5: not YAML"),
        ({"a.ply": "ply"}, CloudError, "a.ply: not a whole ply file"),
        ({"a.pcap": "no"}, PacketError, "a.pcap: not a capture"),
        ({"a.yaml": STUDY.read_text(), "b.yaml": STUDY.read_text()}, ConfigError, "b.yaml: is a second study beside"),
        ({"a.yaml": ROOF.read_text(), "b.yaml": ROOF.read_text(), "c.pcap": ""}, ConfigError, "which of 2 rigs recorded it"),
    ],
)  # fmt: skip
def test_files_that_are_nothing_to_look_at(tmp_path, files, error, message):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(error, match=re.escape(message)):
        load_contents([tmp_path / name for name in files], None, None, np.eye(4), no_warning)


def test_a_window_and_a_sensor_of_a_recording():
    """As decode cuts them out of the whole: by the time of what is shown, and by the sensor's address."""
    path = recording("nebula_vlp16.pcap")
    whole = load_contents([path], None, None, np.eye(4), no_warning)
    (name,) = whole.cloud.sensor_names
    part = load_contents([path], None, None, np.eye(4), no_warning, Selection(0.1, 0.2, (name,)))
    first, last = part.cloud.time_ns.min(), part.cloud.time_ns.max()
    inside = (whole.cloud.time_ns >= first) & (whole.cloud.time_ns <= last)
    assert (part.cloud.xyz == whole.cloud.xyz[inside]).all()
    assert (last - first) / 1e9 == pytest.approx(0.1, abs=0.003)
    assert first - whole.cloud.time_ns.min() == pytest.approx(1e8, abs=3e6)
    with pytest.raises(ConfigError, match="select a part of a capture; there is none"):
        load_contents([ROOF], None, None, np.eye(4), no_warning, Selection(sensors=("left",)))


def test_a_cloud_of_another_program_is_shown(tmp_path):
    """One warning says what it lacks; its points are in the picture."""
    rows = "".join(f"{x} {y} 1\n" for x in range(-20, 20) for y in range(-9, 9))
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 720\nHEIGHT 1\nPOINTS 720\nDATA ascii\n"
    )
    (tmp_path / "f.pcd").write_text(head + rows)
    done = CliRunner().invoke(view, [str(tmp_path / "f.pcd"), "--png", str(tmp_path / "f.png"), "--size", "480x270"])
    assert done.exit_code == 0
    assert done.stderr == (
        f"lidarcfg: warning: {tmp_path}/f.pcd: has no intensity, ring, time_ns, sensor, return_type; 0 is assumed\n"
    )
    blue = drawn(tmp_path / "f.png")
    assert (blue[..., 2] > blue[..., 0] + 40).sum() > 700


def test_a_cloud_of_nan_is_refused(tmp_path):
    save_clouds(tmp_path / "n.ply", [cloud([[1, 2, 3], [np.nan, 0, 0]])])
    with pytest.raises(CloudError, match=r"n.ply: point 1 is not finite"):
        load_contents([tmp_path / "n.ply"], None, None, np.eye(4), no_warning)


def test_at_places_the_vehicle_in_the_scene():
    """The vehicle at x = 20 with its nose to the north sees the world's origin 20 m to its left."""
    staged = load_contents([STREET], None, None, pose((20, 0, 0), (0, 0, np.pi / 2)), no_warning)
    assert transform(staged.T_vehicle_world, [[0, 0, 1]]) == pytest.approx(np.array([[0, 20, 1]]))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--size", "10x10"), "'10x10' is not WxH in pixels, each 16 to 8192 and 36,000,000 in all at most"),
        (("--size", "8192x8192"), "'8192x8192' is not WxH in pixels, each 16 to 8192 and 36,000,000 in all at most"),
        (("--size", "wide"), "'wide' is not WxH in pixels"),
        (("--size", "1e3x500"), "'1e3x500' is not WxH in pixels"),
        (("--camera", "1,2,3"), "'1,2,3' is not EYEX,EYEY,EYEZ,X,Y,Z[,FIELD_DEG]"),
        (("--camera", "1,2,3,4,5,nan"), "is not EYEX"),
        (("--colour", "pink"), "'pink' is not one of"),
        (("--colour", "object", "--png", "p.png"), "objects are known only from ground truth"),
        (("--colour", "object", "--html", "p.html"), "objects are known only from ground truth"),
        (("--camera=0,0,0,0,0,0",), "eye and target are one point"),
        (("--camera=99,0,2,100,0,2", "--png", "p.png"), "nothing is in view of a camera at 99,0,2 that looks at 100,0,2"),
    ],
)  # fmt: skip
def test_mistakes_of_the_command_line(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(view, [str(ROOF), *words])
    assert message in (done.output or str(done.exception))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["above", "camera", "down"])
def test_stills_are_as_they_were(tmp_path, name):
    """Compared with tests/stills, drawn once and looked at; fonts may differ a little from one machine to another."""
    rng = np.random.default_rng(3)
    xyz = rng.uniform((-12, -8, 0), (12, 8, 0), (6000, 3))
    xyz[::2, 1] = 8.0
    xyz[::2, 2] = rng.uniform(0, 3, 3000)
    seen = replace(cloud(xyz, ("left", "right")), intensity=(np.arange(6000) % 100).astype(np.uint8))
    staged = Contents(seen, None, (load_rig(ROOF),), load_study(STUDY), (load_scene(STREET),), np.eye(4))
    how = {
        "above": {},
        "camera": {"camera": Camera(np.array([-9.0, -12, 6]), np.array([2.0, 0, 1]), 70.0), "by": "height", "worst": 2},
        "down": {"camera": Camera(np.array([0.0, 0, 25]), np.zeros(3), 80.0), "by": "intensity", "worst": 0},
    }[name]
    save_still(staged, tmp_path / "p.png", (480, 270), **how)
    ours = drawn(tmp_path / "p.png")
    stored = drawn(STILLS / f"{name}.png")
    assert ours.shape == stored.shape == (270, 480, 3)
    assert (abs(ours - stored).max(axis=-1) > 24).mean() < 0.02
    shifted = np.roll(stored, 3, axis=1)  # the tolerance would not let this pass
    assert (abs(ours - shifted).max(axis=-1) > 24).mean() > 0.04


@pytest.mark.slow
def test_a_window_has_what_a_still_has():
    staged = Contents(cloud([[1, 2, 3]]), None, (load_rig(ROOF),), load_study(STUDY), (load_scene(STREET),), np.eye(4))
    kinds = [type(part).__name__ for part in parts(staged, "sensor")]
    assert kinds == ["TriangleMesh", "PointCloud", "TriangleMesh", "TriangleMesh", "TriangleMesh", "LineSet", "LineSet"]


@pytest.mark.slow
def test_stills_show_where_bases_may_be_and_zones(tmp_path):
    """The middle of each cell of a roof that bases fit on is green in a view from above; a zone's edges are yellow."""
    text = (STUDY.parent / "mounts.yaml").read_text().replace("../vehicles", str(STUDY.parents[1] / "vehicles"))
    (tmp_path / "m.yaml").write_text(text + "zones: [{name: ahead, min_m: [4, -3, 0], max_m: [9, 3, 2]}]\n")
    staged = load_contents([tmp_path / "m.yaml"], None, None, np.eye(4), no_warning)
    camera = Camera(np.array([0.0, 0, 16]), np.zeros(3), 70.0)
    save_still(staged, tmp_path / "p.png", (640, 480), camera=camera, worst=0)
    image = drawn(tmp_path / "p.png")
    roof = next(slot.surface for slot in staged.study.slots if slot.surface.side == "above")
    column, row, _ = camera.project(roof.patch.cells_m.mean(axis=1), 640, 480)
    red, green, blue = image[row.astype(int), column.astype(int)].T
    assert np.mean((green > red + 30) & (green > blue + 10)) > 0.8  # some are under a sensor's marker
    column, row, _ = camera.project(np.array([[4.0, 0, 2], [4, 0, 0]]), 640, 480)
    beside = image[(row - 2).astype(int)[:, None] + np.arange(5), column.astype(int)[:, None]]
    assert ((beside[..., 0] > 130) & (beside[..., 2] < 110)).any(axis=1).all()


@pytest.mark.slow
def test_a_study_with_choices_is_shown_with_the_first(tmp_path):
    """One warning says which, and how to see others."""
    (tmp_path / "choice.yaml").write_text(CHOICE.replace("RETURNS", "10"))
    done = CliRunner().invoke(view, [str(tmp_path / "choice.yaml"), "--html", str(tmp_path / "t.html")])
    assert done.exit_code == 0
    assert done.stderr.startswith(
        "lidarcfg: warning: choice: the study lets models be chosen; the first of each are shown: left vlp-16, "
    )
    assert done.stderr.endswith("optimize writes a study of each choice\n")
    assert (tmp_path / "t.html").exists()
