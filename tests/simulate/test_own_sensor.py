"""Sensors of one's own: any beam table seen as points, a horizontal field of view, files of few facts."""

import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from lidarcfg import inputs
from lidarcfg.clouds.cloud import load_cloud, row_bytes
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.packets.families import pattern
from lidarcfg.sensors.rig import load_rig
from lidarcfg.sensors.sensor import catalogue, load_sensor
from lidarcfg.simulate.scans import most_returns, simulated_scans
from lidarcfg.simulate.scene_drive import SceneDrive
from lidarcfg.study.loading import load_study
from lidarcfg.world.motion import Trajectory, load_path
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import no_warning
from tests.command_line import lidarcfg
from tests.refusals import refused

SENSOR = {"name": "mine", "beams": {"elevation_deg": [-30, -10, -45, 5]}, "range": {"max_m": 50}}
HEIGHT_M = 2.0
START_NS = 1_767_225_600 * 10**9


def folder_with(tmp_path, sensor=None, **mount):
    """A rig of one own sensor over bare ground."""
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(SENSOR | (sensor or {})))
    one = {"name": "top", "model": "mine.yaml", "position_m": [1, 0, HEIGHT_M], **mount}
    if "elevation_deg" in one:
        del one["model"]
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"name": "own", "sensors": [one]}))
    (tmp_path / "scene.yaml").write_text("name: plain\nground: {reflectivity: 30}\n")
    return tmp_path


def exported(folder, output, *words, duration=0.2, code=0):
    words = ("export", "rig.yaml", "--scene", "scene.yaml", "--duration", duration, "-o", output, *words)
    return lidarcfg(*words, cwd=folder, code=code)


def by_hand(step_ns, offset_ns, rpm, count, fov_deg=(0.0, 360.0)):
    """(ring, time, place) of each return from flat ground, firing by firing."""
    found = []
    elevations = SENSOR["beams"]["elevation_deg"]
    rings = [sorted(elevations).index(angle) for angle in elevations]
    for n in range(count):
        begun = n * step_ns * rpm / 60e9 % 1 * 360
        if not (begun - fov_deg[0]) % 360 <= fov_deg[1] - fov_deg[0]:
            continue
        for laser, angle in enumerate(elevations):
            turned = math.radians((n * step_ns + offset_ns[laser]) * rpm / 60e9 * 360)
            if angle < 0 and HEIGHT_M / math.sin(math.radians(-angle)) <= 50:
                away = HEIGHT_M / math.tan(math.radians(-angle))
                place = (1 + away * math.cos(turned), -away * math.sin(turned), 0.0)
                found.append((rings[laser], START_NS + n * step_ns + offset_ns[laser], place))
    return found


def check(cloud, found):
    order = np.lexsort((cloud.ring, cloud.time_ns))
    found = sorted(found, key=lambda one: (one[1], one[0]))
    assert cloud.ring[order].tolist() == [ring for ring, _, _ in found]
    assert cloud.time_ns[order].tolist() == [time_ns for _, time_ns, _ in found]
    np.testing.assert_allclose(cloud.xyz[order], [place for _, _, place in found], atol=1e-6)


def test_a_beam_table_is_enough(tmp_path):
    """Its lasers fire all at once every 0.2 degrees, which a warning says."""
    folder = folder_with(tmp_path)
    result = exported(folder, "a.ply")
    assert "top: mine has no firing facts; all lasers fire together every 0.2 deg" in result.stderr
    cloud = load_cloud(folder / "a.ply", no_warning)
    check(cloud, by_hand(55_556, [0] * 4, 600, 200_000_000 // 55_556))
    assert cloud.object_names == ("ground",)


def test_firing_facts(tmp_path):
    """A sequence's time and each laser's place in it."""
    firing = {"sequence_ns": 100_000, "offset_ns": [0, 30_000, 60_000, 90_000]}
    folder = folder_with(tmp_path, {"firing": firing}, rpm=1200.0)
    assert exported(folder, "a.npz").stderr.count("warning") == 0
    check(load_cloud(folder / "a.npz", no_warning), by_hand(100_000, firing["offset_ns"], 1200, 2000))


def test_beams_in_the_rig_and_its_range(tmp_path):
    folder = folder_with(tmp_path, elevation_deg=SENSOR["beams"]["elevation_deg"], range_m=[0.5, 50])
    exported(folder, "a.pcd")
    check(load_cloud(folder / "a.pcd", no_warning), by_hand(55_556, [0] * 4, 600, 200_000_000 // 55_556))
    folder_with(tmp_path, elevation_deg=[-10, 0])
    result = exported(folder, "b.ply", code=2)
    assert (
        "top: sensor 'custom' has no range; add range: {max_m: ...} to its file, or range_m to the rig" in result.stderr
    )
    assert "write points instead: .ply, .pcd, .npz, .mcap or a folder" in exported(folder, "c.pcap", code=2).stderr
    assert not any((folder / name).exists() for name in ("b.ply", "c.pcap"))


def test_a_sensors_own_field_of_view(tmp_path):
    """It fires within it, and a scan is one sweep through it; a rig may narrow it, and not widen it."""
    folder = folder_with(tmp_path, {"azimuth_fov_deg": [300, 60], "firing": {"sequence_ns": 100_000}})
    exported(folder, "a.npz")
    cloud = load_cloud(folder / "a.npz", no_warning)
    azimuth_deg = np.degrees(np.arctan2(-cloud.xyz[:, 1], cloud.xyz[:, 0] - 1))
    assert (abs(azimuth_deg) <= 60 + 1e-6).all()
    assert len(cloud.xyz) == 3 * sum(abs((n * 0.36 + 180) % 360 - 180) <= 60 + 1e-9 for n in range(2000))
    exported(folder, "k", "--to", "kitti-odometry", duration=0.3)
    sizes = [one.stat().st_size // 16 for one in sorted((folder / "k/sequences/00/velodyne").iterdir())]
    assert sizes[1] == sizes[2] == 3 * 333
    assert len(sizes) == 4  # it starts in the middle of a sweep
    mounted = load_rig(folder / "rig.yaml").mounts[0]
    assert mounted.azimuth_fov_deg == (300, 60)
    assert load_rig(folder_with(tmp_path, {"azimuth_fov_deg": [300, 60]}, azimuth_fov_deg=[350, 10]) / "rig.yaml")
    folder_with(tmp_path, {"azimuth_fov_deg": [300, 60]}, azimuth_fov_deg=[290, 10])
    with pytest.raises(ConfigError, match=r"azimuth_fov_deg: is not within mine's own, 300 to 60"):
        load_rig(folder / "rig.yaml")


STUDY = """
region: {{min_m: [-6, -6, 0], max_m: [6, 6, 2], cuboid_m: [0.5, 0.5, 0.5]}}
sensors:
  - {{{model}, count: 1, min: {{position_m: [0, 0, 1], rpy_deg: [0, 0, 0]}}, max: {{position_m: [0.5, 0.5, 1.2], rpy_deg: [9, 9, 9]}}{more}}}
"""


def test_placement_knows_the_field_of_view(tmp_path):
    """A sensor's own counts as one that the study gives; models to choose from have each their own."""
    (tmp_path / "wide.yaml").write_text(yaml.safe_dump(SENSOR))
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(SENSOR | {"azimuth_fov_deg": [270, 90]}))
    slots = []
    for model, more in (("model: mine.yaml", ""), ("model: wide.yaml", ", azimuth_fov_deg: [270, 90]")):
        (tmp_path / "study.yaml").write_text(STUDY.format(model=model, more=more))
        slots.append(load_study(tmp_path / "study.yaml").slots[0])
    assert slots[0].azimuth_fov_deg == slots[1].azimuth_fov_deg == (270, 90)
    (tmp_path / "study.yaml").write_text(STUDY.format(model="model: mine.yaml", more=", azimuth_fov_deg: [0, 180]"))
    with pytest.raises(ConfigError, match=r"sensors\[0\]\.azimuth_fov_deg: is not within mine's own, 270 to 90"):
        load_study(tmp_path / "study.yaml")


def test_returns_are_counted_where_the_file_says_how_it_fires(tmp_path):
    folder = folder_with(tmp_path)
    with pytest.raises(
        ConfigError, match="'mine' has no codec, which would say where its lasers fire; add firing to its file"
    ):
        pattern(load_rig(folder / "rig.yaml").mounts[0])
    folder_with(tmp_path, {"firing": {"step_deg": 0.5}})
    found = pattern(load_rig(folder / "rig.yaml").mounts[0])
    assert math.degrees(found.step_rad) == pytest.approx(0.5, abs=1e-5)
    assert found.laser.tolist() == [0, 1, 2, 3]


FEW = """
name: few
beams: {elevation_deg: [-21, 3, -14, 5, -8, 7, -3, 0]}
rotation: {rpm_min: 300, rpm_max: 1200}
range: {max_m: 120, resolution_m: 0.002}
codec: velodyne
velodyne:
  firing: {offset_ns: [0, 2304, 4608, 6912, 9216, 11520, 13824, 16128], sequence_ns: 27648}
  packet: {product_id: 0x77, block_flags: [0xEEFF], sequences_per_block: 4, return_modes: {strongest: 0x37}}
  headers:
    mac_prefix: "60:76:88"
    destination_mac: "ff:ff:ff:ff:ff:ff"
    destination_ip: 255.255.255.255
    data: {ttl: 255, dont_fragment: true, numbered: false, checksum: false}
"""


def test_only_facts_that_something_reads_are_required(tmp_path):
    """Packets of a model without sources, steps, accuracy, and with one return mode: written, refused, read."""
    folder = folder_with(tmp_path)
    (folder / "mine.yaml").write_text(FEW.replace("name: few", "name: mine"))
    exported(folder, "a.pcap")
    lidarcfg("decode", "a.pcap", "--rig", "rig.yaml", "-o", "a.ply", cwd=folder)
    assert len(load_cloud(folder / "a.ply", no_warning).xyz) > 5000
    result = exported(folder, "b.pcap", "--return-mode", "last", code=2)
    assert "sensor 'mine' has no last returns; allowed: strongest" in result.stderr
    (folder / "mine.yaml").write_text(FEW.replace("name: few", "name: mine").replace(", resolution_m: 0.002", ""))
    result = exported(folder, "b.pcap", code=2)
    assert "sensor 'mine' has no range.resolution_m, the unit of distances in its packets" in result.stderr


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ({"firing": {}}, "firing: give step_deg or sequence_ns, one of them"),
        ({"firing": {"step_deg": 1, "sequence_ns": 5}}, "firing: give step_deg or sequence_ns, one of them"),
        ({"firing": {"step_deg": 1, "offset_ns": [0]}}, "firing.offset_ns: has 1 value; allowed: 4, one a beam"),
        ({"azimuth_fov_deg": [20, 20]}, "azimuth_fov_deg: 20 to 20 is empty"),
        ({"codec": "velodyne", "velodyne": {}, "firing": {"step_deg": 1}}, "firing: belongs under velodyne"),
    ],
)
def test_files_that_are_refused(tmp_path, sensor, message):
    folder = folder_with(tmp_path, sensor)
    with refused(message, kind=ConfigError):
        load_sensor(folder / "mine.yaml")


def test_a_firing_beyond_its_sequence_and_too_many_beams(tmp_path):
    folder = folder_with(tmp_path, {"firing": {"sequence_ns": 1000, "offset_ns": [0, 0, 0, 1000]}})
    assert "top: a laser fires 1000 ns into a sequence of 1000 ns" in exported(folder, "a.ply", code=2).stderr
    beams = {"elevation_deg": [n / 10 - 20 for n in range(300)]}
    folder_with(tmp_path, {"beams": beams})
    assert "has 300 beams; allowed: up to 256" in exported(folder, "a.ply", code=2).stderr


@pytest.mark.parametrize("path", sorted(catalogue().values()), ids=lambda path: path.stem)
def test_each_part_of_the_catalogue_states_its_source(path):
    """What a sensor of one's own may leave out, ours have."""
    file = yaml.safe_load(path.read_text("utf-8"))
    parts = [file[key] for key in ("beams", "rotation", "range", "optics", "housing", "ports") if key in file]
    parts += [
        part
        for key, part in file.get(file.get("codec", ""), {}).items()
        if key in ("firing", "packet", "headers", "position_packet", "dual")
    ]
    assert parts
    assert all(isinstance(part["source"], str) and part["source"] for part in parts)


def test_carla_gets_the_rate_of_an_own_sensor(tmp_path):
    """1000 sequences of 4 lasers in a revolution, 10 a second."""
    folder = folder_with(tmp_path, {"firing": {"step_deg": 0.36}})
    result = lidarcfg("convert", "rig.yaml", "-o", "a.json", cwd=folder)
    (one,) = json.loads((folder / "a.json").read_text())["sensors"]
    assert one["attributes"]["points_per_second"] == 4 * 1000 * 10
    assert one["attributes"]["range"] == 50
    assert "has beams only" not in result.stderr


def test_a_rig_with_a_sensor_that_has_no_packets_is_refused_with_what_to_do(tmp_path):
    folder = folder_with(tmp_path)
    other = {"name": "left", "model": "vlp-16", "position_m": [0, 1, 2]}
    rig = yaml.safe_load((folder / "rig.yaml").read_text())
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig | {"sensors": [other, *rig["sensors"]]}))
    said = exported(folder, "a.pcap", code=2).stderr
    assert "top: sensor 'mine' has no codec, and so no packets; write points instead: .ply, " in said
    assert said.endswith("; for packets of the other sensors, export a rig without top\n")
    assert not (folder / "a.pcap").exists()


def test_the_room_for_points_is_said(tmp_path, monkeypatch):
    """By hand: 4 lasers, 3,600 firings of each in 0.2 s, 47 bytes a point (numpy's own packed sizes), twice while written."""
    folder = folder_with(tmp_path)
    (folder / "scene.yaml").write_text(
        "name: box\nspheres: [{name: all, center_m: [1, 0, 2], radius_m: 9, reflectivity: 5}]\n"
    )
    rig = load_rig(folder / "rig.yaml")
    scene = load_scene(folder / "scene.yaml")
    drive = SceneDrive(rig, scene, Trajectory(np.eye(4), load_path(None), START_NS), None, START_NS, 10**9 // 5)
    assert most_returns(drive) == pytest.approx(4 * 3600, rel=1e-4)
    for suffix, octets in (
        (".ply", 24 + 3 + 4 + 8 + 4 + 4),
        (".pcd", 24 + 3 + 2 + 8 + 4),
        (".npz", 24 + 3 + 2 + 8 + 4),
    ):
        assert row_bytes(f"a{suffix}") == octets
        exported(folder, f"a{suffix}")
        assert (folder / f"a{suffix}").stat().st_size == pytest.approx(octets * most_returns(drive), abs=3000)


@pytest.mark.parametrize(("free", "fits"), [(2 * 47 * 4 * 3600 * 0.4, False), (2 * 47 * 4 * 3600 * 0.9, True)])
def test_points_that_do_not_fit_on_the_disk_end_early(tmp_path, monkeypatch, free, fits):
    """Three of four beams point at the ground and return: by hand, of 4 × 3,600 points at most, at 47 bytes twice."""
    folder = folder_with(tmp_path)
    monkeypatch.setattr("lidarcfg.inputs.shutil.disk_usage", lambda path: SimpleNamespace(free=int(free)))
    said = exported(folder, "a.ply", code=0 if fits else 2).stderr
    refused = re.search(r"a.ply: needs (.*) MB on the disk while it is written; .* MB are free; a shorter time", said)
    assert (folder / "a.ply").exists() == fits == (refused is None)
    assert {path.name for path in folder.iterdir()} >= {"rig.yaml"}
    if refused:
        assert float(refused[1]) == pytest.approx(2 * 47 * 3 * 3600 / 1e6, rel=0.05)
        assert not list(folder.glob(".*"))


def test_more_scans_than_memory_holds_are_refused_with_the_figure(tmp_path, monkeypatch):
    """By hand: 4 lasers, 1,800 firings of each in a revolution, and what may be traced ahead: in all no more than 2 s."""
    folder = folder_with(tmp_path)
    rig = load_rig(folder / "rig.yaml")
    scene = load_scene(folder / "scene.yaml")
    drive = SceneDrive(rig, scene, Trajectory(np.eye(4), load_path(None), START_NS), None, START_NS, 2 * 10**9)
    needed = 60 * 4 * 1800 * 20
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 0.999 * needed)
    with pytest.raises(
        LidarcfgError, match=r"a revolution of each sensor, 1 in all, .* needs 0.0 GB .*; export fewer sensors"
    ):
        simulated_scans(drive)
    monkeypatch.setattr(inputs, "memory_bytes", lambda: 1.001 * needed)
    assert len(list(simulated_scans(drive))) == 20
