"""Our own scenes as one simulator among others, held against `export`, byte for byte, and against single rays."""

import numpy as np
import pytest

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.writer import Writer
from lidarcfg.sensors.rig import load_rig
from lidarcfg.simulate.caster import Caster
from lidarcfg.simulate.drive import Drive
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Motion, Trajectory, build_path
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from lidarcfg.world.vehicle import rig_vehicle
from tests.refusals import refused

SCENE = {
    "name": "yard",
    "ground": {"reflectivity": 15},
    "boxes": [{"name": "wall", "center_m": [9, 1, 1.5], "size_m": [0.4, 12, 3], "reflectivity": 60}],
    "spheres": [
        {
            "name": "ball",
            "center_m": [5, -3, 0.8],
            "radius_m": 0.8,
            "reflectivity": 180,
            "motion": {"velocity_m_s": [0, 9, 0]},
        }
    ],
}
FOG = {**SCENE, "weather": {"fog_visibility_m": 60, "rain_mm_h": 20}}
VEHICLE = {"boxes": [{"name": "hood", "center_m": [1, 0, 0.6], "size_m": [2, 2, 1], "reflectivity": 5}]}


def rig_of(*models, **keys):
    """Sensors side by side on a van."""
    sensors = [
        {"name": f"s{n}", "model": model, "position_m": [0.3 * n, 0.1, 1.8], "rpy_deg": [2, 6, 40 * n], **keys}
        for n, model in enumerate(models)
    ]
    return load_rig({"name": "rig", "vehicle": VEHICLE, "sensors": sensors})


def arc() -> Trajectory:
    """A bend of 8 m/s, from somewhere."""
    T = np.eye(4)
    T[:3, 3] = -4, 2, 0
    return Trajectory(T, build_path(Motion(arc={"speed_m_s": 8, "yaw_rate_deg_s": 30})), START_NS)


@pytest.mark.parametrize(
    ("models", "mode", "scene"),
    [
        (["vlp-16", "airy", "os1-32", "pandar-xt32", "mid-360"], "strongest", SCENE),
        (["vlp-16", "pandar-xt32"], "dual", SCENE),
        (["vlp-16", "pandar-xt32"], "dual", FOG),
    ],
)
def test_a_caster_s_packets_are_export_s(tmp_path, models, mode, scene):
    rig = rig_of(*models, return_mode=mode)
    scene = load_scene(scene)
    drive = Drive(rig, arc(), origin=scene.file.geo_origin)
    ours, theirs = tmp_path / "a.pcap", tmp_path / "b.pcap"
    with Writer(drive, ours) as writer:
        for rays, range_m, intensity in Caster(drive, scene, threads=3).cast(drive.firings(0, 0.15, 0.04)):
            writer.write(rays, range_m, intensity)
    streams = simulated_packets(rig, scene, arc(), round(0.15 * SECOND_NS), vehicle=rig_vehicle(rig))
    write_pcap(theirs, in_time_order(streams))
    assert ours.read_bytes() == theirs.read_bytes()


def test_rays_hit_what_single_rays_hit():
    """Without the van, each ray traced by itself from where the drive says that it starts."""
    rig = load_rig({"name": "one", "sensors": [{"name": "top", "model": "os1-32", "position_m": [0, 0, 1.8]}]})
    scene = load_scene(SCENE)
    drive = Drive(rig, arc())
    ((rays, range_m, intensity),) = Caster(drive, scene).cast(drive.firings(0.03, 0.07))
    tracer = Tracer(scene, np.zeros(3), START_NS)
    bright = [*scene.reflectivity.tolist(), 0]
    hit = set()
    for n in range(0, len(rays), 41):
        one = slice(n, n + 1)
        found = tracer.cast(
            rays.origins_m[one], rays.directions[one], rays.time_ns[one], rig.mounts[0].sensor.range.reported_m[1] + 1
        )
        np.testing.assert_allclose(range_m[n], found.range_m, rtol=0, atol=1e-9)
        assert intensity[n, 0] == bright[found.object[0]]
        hit.add(int(found.object[0]))
    assert hit == {-1, 0, 1, 2}


def test_what_cannot_be_cast_is_said(tmp_path):
    rig = rig_of("vlp-16")
    drive = Drive(rig)
    with refused('rays are in the frame of the vehicle; allowed: frame="world"'):
        next(Caster(drive, SCENE).cast(drive.firings(0, 0.01, frame="vehicle")))
    with refused("the rays are of another drive"):
        next(Caster(drive, SCENE).cast(Drive(rig).firings(0, 0.01)))
    low = load_rig({"name": "low", "sensors": [{"name": "top", "model": "vlp-16", "position_m": [1, 0, 0.6]}]})
    (tmp_path / "van.yaml").write_text(str(VEHICLE))
    with refused("top is inside the vehicle's 'hood'"):
        Caster(Drive(low), SCENE, tmp_path / "van.yaml")
    assert Caster(Drive(low), SCENE, "none")
