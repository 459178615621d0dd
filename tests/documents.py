"""Studies, rigs, scenes and sensors to make odd, and what each must then be: an answer, or an error in one line."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from hypothesis import strategies as st

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.config.models import load
from lidarcfg.errors import LidarcfgError
from lidarcfg.packets.velodyne.layout import PACKET
from lidarcfg.sensors.rig import Rig, load_rig, save_rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.study.bounded_costs import BoundedCosts
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.file import StudyFile
from lidarcfg.study.loading import load_study
from lidarcfg.vsr.cones import rig_lidars
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import segment
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import PLY, datagrams_of, mount, room
from tests.packets.velodyne.shaped import decode, packet_period_ns

ROOT = Path(__file__).parents[1]
ODD_NUMBERS = (0, -1, 1, 2, 0.5, 1e-12, 1e-300, 5e-324, 1e7, 1e8, 1e9, 1e154, 1e300, -1e300, 1.7e308, 90, -90, 360, 2**31, 2**63, 2**64, 10**30)  # fmt: skip
ODD = st.sampled_from((*ODD_NUMBERS, "", "a", "\0", "..", "é", None, True, (), {}, ((),), "vlp-16", 1e-7)) | st.text(max_size=5)  # fmt: skip
TEXTS = {
    "study": """
region: {min_m: [0, 0, 0], max_m: [4, 3, 2], cuboid_m: [1, 0.5, 0.25], exclude: [{min_m: [1, 1, 0], max_m: [2, 2, 3]}]}
sensors:
  - {elevation_deg: [-20, -8, 3, 12], count: 2, mirror_y_m: 1.5, min: {position_m: [1, 1, 1], rpy_deg: [-20, -20, 0]}, max: {position_m: [2, 2, 1.5], rpy_deg: [20, 20, 0]}}
  - {model: fan-4, name: a, min: {position_m: [1, 1, 1], rpy_rad: [0, 0, 1]}, max: {position_m: [2, 1, 2], rpy_rad: [0, 0, 1]}}
objective: {max_vsr: 1, inscribed_radius: 0.5, detection: {box: 1}}
constraints: {max_tilt_deg: 60, min_distance_m: 0.1}
solver: {method: abc, bees: 4, cycles: 2, limit: 3, evaluations: 10, seconds: 5, seed: 4}
detection: [{name: box, size_m: [1, 1, 1], threshold: 1, on_ground: true}, {name: pole, size_m: [0.1, 0.1, 1], samples: 16}]
""",
    "rig": """
name: r
sensors:
  - {name: a, model: vlp-16, position_m: [0.3, 0.5, 1.9], rpy_deg: [-5, 3, 0], host: 192.168.1.7, data_port: 2368, telemetry_port: 8308, rpm: 600, return_mode: strongest}
  - {name: b, elevation_deg: [-3, 0, 4], position_m: [0.3, -0.5, 1.9], rpy_rad: [0.1, 0, 1]}
""",
    "scene": """
name: s
ground: {z_m: -1, reflectivity: 12}
boxes: [{name: b, center_m: [5, 0, 0], size_m: [2, 2, 1.5], yaw_deg: 3, reflectivity: 30}]
spheres: [{name: sphere, center_m: [0, 5, 0], radius_m: 1, reflectivity: 40}]
cylinders: [{name: c, base_m: [0, -5, 0], radius_m: 1, height_m: 1, reflectivity: 40}]
planes: [{name: p, center_m: [-5, 0, 0], size_m: [1, 2], rpy_deg: [0, 90, 0], reflectivity: 1}]
meshes: [{name: m, file: m.ply, position_m: [8, 0, 0], rpy_deg: [1, 2, 3], scale: 2, reflectivity: 1}]
geo_origin: {latitude_deg: 45, longitude_deg: 8}
""",
    "sensor": (ROOT / "sensors/vlp-16.yaml").read_text(),
}
GOOD = {name: yaml.safe_load(text) for name, text in TEXTS.items()}


def places(value, key=()):
    """The keys of all that stands in a document."""
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list | tuple) else ()
    return [key] * bool(key) + [place for k, child in children for place in places(child, (*key, k))]


@st.composite
def mutated(draw, name):
    """A good file with one to three things in it made odd, dropped, doubled, or given to others."""
    document = json.loads(json.dumps(GOOD[name]))
    for _ in range(draw(st.integers(1, 3))):
        all_places = places(document)
        if not all_places:
            break
        *way, last = draw(st.sampled_from(all_places))
        parent = document
        for key in way:
            parent = parent[key]
        what = draw(st.sampled_from(("odd", "odd", "odd", "scale", "drop", "double", "unknown")))
        if what == "odd":
            parent[last] = json.loads(json.dumps(draw(ODD)))
        elif what == "scale" and type(parent[last]) in (int, float):
            parent[last] = parent[last] * draw(st.sampled_from((-1, 1e-3, 1e3, 1 + 1e-15, 1e-12)))
        elif what == "double" and isinstance(parent, list):
            parent.append(parent[last])
        elif what == "unknown" and isinstance(parent, dict):
            parent[draw(st.text(max_size=5))] = parent[last]
        elif what == "drop":
            del parent[last]
    return json.dumps(document, ensure_ascii=draw(st.booleans()))


def documents(name):
    """Mutated files, and any text; sometimes cut off."""
    cut = st.tuples(st.just(TEXTS[name]), st.integers(0, len(TEXTS[name])), st.text(max_size=3)).map(
        lambda t: t[0][: t[1]] + t[2] + t[0][t[1] + 1 :]
    )
    return mutated(name) | mutated(name) | mutated(name) | cut | st.text(max_size=80)


CUBOIDS_MAX = 20_000  # of a study that is searched: larger ones are read only


def use_study(path):
    """Load it, and search for a moment: everything is a number."""
    region = load(path, StudyFile).region
    if math.prod((np.subtract(region.max_m, region.min_m) / region.cuboid_m).round()) > CUBOIDS_MAX:
        return
    study = load_study(path)
    corners = study.space.poses(np.array([[0.0], [0.3], [1.0]]) * np.ones(study.space.dimensions))
    assert np.isfinite(corners).all()
    assert (corners >= study.space.lower)[:, np.isnan(study.space.mirror)].all()
    assert (corners <= study.space.upper)[:, np.isnan(study.space.mirror)].all()
    assert np.isfinite(study.space.violation(corners)).all()
    with BoundedCosts(study.region, [slot.lidar for slot in study.slots], threads=1) as bounded:
        cost = bounded.costs(corners, np.zeros(3, int), corners[:1], np.full(3, np.inf))
    assert (cost > 0).all()
    assert np.isfinite(cost).all()
    assert math.isfinite(objective_of(study, corners[1]))


def use_rig(path):
    """Load it, look with it, and write it back."""
    rig = load_rig(path)
    vsr = vsr_m(segment(Region.from_boxes((0, 0, 0), (4, 3, 2), (1, 0.5, 0.5)), rig_lidars(rig)))
    assert np.isfinite(vsr).all()
    save_rig(rig, path.with_name("again.yaml"))
    again = load_rig(path.with_name("again.yaml"))
    assert (again.name, again.mounts) == (rig.name, rig.mounts)


def use_scene(path):
    """Load it, and cast rays from where a vehicle may stand."""
    loaded = load_scene(path)
    assert np.isfinite(loaded.vertices_m).all()
    way = np.array([[1.0, 0, 0], [0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    hit = Tracer(loaded, np.zeros(3)).cast(np.zeros((5, 3)), way)[0]
    assert (hit >= 0).all()


def use_sensor(path):
    """Load it, and let it send a packet, if it can."""
    sensor = load_sensor(path)
    assert np.isfinite(sensor.sin_elevation).all()
    assert (np.diff(sensor.sin_elevation) >= 0).all()
    rig = Rig("r", (replace(mount(), sensor=sensor, model=str(path)),))
    if sensor.rotation is None or not sensor.rotation.rpm_min <= 600 <= sensor.rotation.rpm_max:
        return
    sent = path.with_name("sent.pcap")
    write_pcap(
        sent, in_time_order(simulated_packets(rig, HALL[0], np.eye(4), packet_period_ns(sensor), start_ns=10**18))
    )
    data = b"".join(d.payload for d in datagrams_of(sent) if len(d.payload) == PACKET.itemsize)
    returns = decode(sensor, np.frombuffer(data, PACKET), np.full(len(data) // PACKET.itemsize, 10**18))
    assert np.isfinite(returns.xyz_m).all()


USES = {"study": use_study, "rig": use_rig, "scene": use_scene, "sensor": use_sensor}
HALL = []  # the scene that use_sensor looks at: prepare puts it here


def prepare(folder):
    """What the files of a folder name."""
    (folder / "m.ply").write_text(PLY.format(n=3, m=1) + "0 0 0\n1 0 0\n0 2 0\n3 0 1 2\n")
    HALL[:] = [room(folder, (0.0, 0.0, 2.0))]


def outcome(name, text, folder):
    """What comes of a file: "an answer" that is right, or what the error says; all else is raised."""
    path = folder / f"{name}.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        USES[name](path)
    except LidarcfgError as error:
        return str(error)
    return "an answer"


def one_line(said):
    """Whether something is said: one mistake a line."""
    return bool(said) and all(line.strip() for line in said.split("\n"))


def value_at(document, key):
    for part in key:
        document = document[part]
    return document
