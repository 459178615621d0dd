"""HDL-64E units: the calibration that their status bytes carry, ours and velodyne-decoder's reading of it."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import velodyne_decoder as vd
import yaml

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.export import simulated_packets
from lidarcfg.capture.ground_truth import records
from lidarcfg.cli.main import cli
from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.geometry import transform
from lidarcfg.packets.velodyne.encode import sent as are_sent
from lidarcfg.packets.velodyne.model import unit as unit_of
from lidarcfg.packets.velodyne.telemetry import calibration
from lidarcfg.sensors.rig import Rig, load_rig
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.simulate.echoes import Echoes
from lidarcfg.units import START_NS
from lidarcfg.world.scene import load_scene
from lidarcfg.world.tracer import Tracer
from tests.capture_fixtures import AT_NS, ROOM, decoded, hdl_64e, mount, scene
from tests.packets.velodyne.captures import MODES, OTHERS, agree, calibrating, elsewhere, sent, write
from tests.packets.velodyne.shaped import (
    decode,
    encode,
    facts,
    firings,
    packet_period_ns,
    packet_stamps_ns,
    rays,
    with_facts,
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hdl-64e-s2", "hdl-64e-s3"])
@pytest.mark.parametrize("mode", MODES)
def test_a_unit_is_heard_as_it_was_met(name, mode, tmp_path):
    """By the calibration that its packets carry, ours and velodyne-decoder's: no return is missing or extra.

    Points are along the beam within half a step of what was met, and where the corrections end, with a jump, within a
    fifth of them more; across it within half of what x and y are corrected apart. Intensities are the nearest there are.
    """
    unit = hdl_64e(name)
    dual = mode == "dual"
    fired = firings(unit, 600, AT_NS, range(4160), dual)
    rng = np.random.default_rng(4)
    range_m = np.full((*fired.time_ns.shape, 1 + dual), np.inf)
    range_m[:20] = rng.uniform(2, 40, range_m[:20].shape)
    range_m[20:40] = rng.uniform(25, 27, range_m[20:40].shape)
    if dual:
        range_m[..., 1] = range_m[..., 0] + rng.uniform(1, 20, fired.time_ns.shape)
    reflectivity = rng.integers(0, 256, range_m.shape, np.uint8)
    seen = (range_m, reflectivity) if dual else (range_m[..., 0], reflectivity[..., 0])
    packets = encode(unit, mode, fired, *seen)
    write(tmp_path / "a.pcap", unit, packets, fired)

    model, read_elsewhere = vd.hdl64e.read_calibration_from_pcap(str(tmp_path / "a.pcap"))
    assert model == OTHERS[name]
    lasers = yaml.safe_load(read_elsewhere.to_string())["lasers"]
    for key, (theirs, unit_of_theirs) in READ_ELSEWHERE.items():
        read = np.array([laser.get(theirs, 0) for laser in lasers]) / unit_of_theirs
        np.testing.assert_allclose(
            read, getattr(unit.beams if hasattr(unit.beams, key) else facts(unit).calibration, key), atol=1e-5
        )
    ours = decoded(tmp_path / "a.pcap")  # no warning: recognised, and its calibration found
    xyz, time_s, intensity, ring, _ = elsewhere(tmp_path / "a.pcap", OTHERS[name], read_elsewhere)
    agree(ours, xyz, time_s, intensity, ring, 2e-6)
    assert dual or (ours.return_type == (mode == "last")).all()

    got = decode(unit, packets[:60], packet_stamps_ns(unit, fired)[1][:60])
    assert (got.xyz_m == ours.xyz).all()
    assert (got.intensity == ours.intensity).all()
    origins, directions = (np.broadcast_to(values[..., None, :], (*range_m.shape, 3)) for values in rays(unit, fired))
    laser, time_ns = (
        np.broadcast_to(values[..., None], range_m.shape)
        for values in (np.broadcast_to(np.arange(64), fired.time_ns.shape), fired.time_ns)
    )
    met = [v[:40].reshape(-1, *v.shape[4:]) for v in (range_m, laser, time_ns, reflectivity, origins, directions)]
    mine = np.lexsort((got.range_m, got.time_ns, got.laser))
    theirs = np.lexsort((met[0], met[2], met[1]))
    range_m, laser, _, reflectivity, origins, directions = (values[theirs] for values in met)
    assert (got.laser[mine] == laser).all()

    away_m = away_along(unit, laser, got.xyz_m[mine], range_m, origins, directions)
    assert (away_m > 0.0011).any()

    raw = np.rint((got.range_m[mine] - unit_of(unit).distance_offset_m[laser]) / 0.002)
    distance_m, slope, least, most = unit_of(unit).focal[laser].T
    raised = slope * abs(256 * (1 - distance_m / 131) ** 2 - 256 * (1 - raw / 65535) ** 2)
    in_reach = np.clip(np.rint(np.arange(256) + raised[:, None]), least[:, None], most[:, None])
    nearest = abs(in_reach - reflectivity[:, None]).min(axis=1)
    assert (abs(got.intensity[mine] - reflectivity.astype(float)) == nearest).all()
    assert np.mean(nearest == 0) > 0.4  # others are out of reach


def away_along(unit, laser, xyz, range_m, origins, directions):
    """How far points (N, 3) are along the beam from what was met; within the bounds, across it too."""
    far_m, near_m = unit_of(unit).distance_offset_m[laser], unit_of(unit).near_offset_m[laser]
    apart_m = abs(near_m - far_m[:, None]).max(axis=1)
    along_m = np.einsum("ij,ij->i", xyz - origins, directions)
    jump_m = np.where(abs(range_m - far_m - 25.04) < apart_m, apart_m / 5, 0)
    away_m = abs(along_m - range_m)
    assert (away_m <= 0.001 + jump_m + 2e-5).all()  # and what the rounding of the azimuth does
    across_m = np.linalg.norm(xyz - origins - along_m[:, None] * directions, axis=1)
    uneven_m = (near_m - far_m[:, None]) * (range_m - far_m < 25.04 + apart_m)[:, None]
    side_m, ahead_m = (uneven_m * (25.04 - abs(xyz[:, 1::-1])) / (25.04 - np.array([2.4, 1.93]))).T
    assert (across_m <= abs(ahead_m - side_m) / 2 + range_m * np.radians(0.0051) + 2e-4).all()
    return away_m


READ_ELSEWHERE = {
    "elevation_deg": ("vert_correction", math.pi / 180),
    "azimuth_offset_deg": ("rot_correction", -math.pi / 180),
    "distance_offset_mm": ("dist_correction", 1e-3),
    "near_x_offset_mm": ("dist_correction_x", 1e-3),
    "near_y_offset_mm": ("dist_correction_y", 1e-3),
    "vertical_offset_mm": ("vert_offset_correction", 1e-3),
    "lateral_offset_mm": ("horiz_offset_correction", 1e-3),
    "focal_distance_mm": ("focal_distance", 1e-3),
    "focal_slope": ("focal_slope", 1),
    "intensity_min": ("min_intensity", 1),
    "intensity_max": ("max_intensity", 1),
}


@pytest.mark.slow
def test_a_unit_through_the_commands(tmp_path):
    """A rig with a unit's file, exported and decoded: with the rig, or with what the capture carries, the same points."""
    unit = hdl_64e("hdl-64e-s3")
    text = yaml.safe_dump({**unit.model_dump(mode="json", exclude_none=True), "name": "unit-7"})
    (tmp_path / "unit.yaml").write_text(text)
    sensor = "{name: roof, model: unit.yaml, position_m: [0.3, 0, 2], rpy_deg: [3, -4, 30]}"
    (tmp_path / "rig.yaml").write_text(f"name: one\nsensors:\n- {sensor}\n")
    rig = str(tmp_path / "rig.yaml")
    out = str(tmp_path / "a")
    for words in (
        ["export", rig, "--scene", str(ROOM), "--duration", "1.5", "-o", f"{out}.pcap", "--truth", f"{out}.npz"],
        ["decode", f"{out}.pcap", "--rig", rig, "-o", f"{out}-rig.npz"],
        ["decode", f"{out}.pcap", "--rig", "none", "-o", f"{out}-bare.npz"],
    ):
        assert not cli.main([*words, "--quiet"], prog_name="lidarcfg", standalone_mode=False)
    mine, bare = (load_cloud(f"{out}-{name}.npz", print) for name in ("rig", "bare"))

    T = load_rig(rig).mounts[0].T_vehicle_sensor
    np.testing.assert_allclose(mine.xyz, transform(T, bare.xyz), rtol=0, atol=1e-12)
    fired = firings(unit, 600, START_NS, range(1_500_000_000 // packet_period_ns(unit)))
    origins, directions = (values.reshape(-1, 3) for values in rays(unit, fired))
    hits = Tracer(load_scene(ROOM), np.zeros(3)).cast(transform(T, origins), directions @ T[:3, :3].T)
    least_m, most_m = unit.range.reported_m
    met = np.flatnonzero((hits.range_m >= least_m) & (hits.range_m <= most_m))
    assert len(mine.xyz) == len(met) > 1_000_000
    assert abs(mine.time_ns - fired.time_ns.ravel()[met]).max() <= 1000
    laser = met % 64
    away_along(unit, laser, bare.xyz, hits.range_m[met], origins[met], directions[met])
    _, _, least, most = unit_of(unit).focal[laser].T
    assert (mine.intensity >= least).all()
    assert (mine.intensity <= most).all()
    assert (mine.intensity == bare.intensity).all()
    with np.load(f"{out}.npz") as truth:
        np.testing.assert_allclose(truth["range_m"], hits.range_m[met], rtol=0, atol=1e-9)
        assert (truth["laser"] == laser).all()


def test_returns_that_are_alike_on_the_wire_are_one():
    """Two intensities for which there is only one byte: one point, and one record of the truth."""
    unit = hdl_64e("hdl-64e-s3")
    fired = firings(unit, 600, AT_NS, range(4), dual=True)
    range_m = np.full((*fired.time_ns.shape, 2), 10.0)
    reflectivity = np.broadcast_to(np.array([3, 9], np.uint8), range_m.shape)
    packets = encode(unit, "dual", fired, range_m, reflectivity)
    echoes = Echoes(
        *(v.reshape(-1, 2) for v in (range_m, 0 * range_m, reflectivity, np.zeros(range_m.shape, np.int32))),
        range_m.reshape(-1, 2)[:, 0],
    )
    true = records(
        0,
        np.broadcast_to(np.array([0, 1]), echoes.range_m.shape),
        fired.flat,
        np.broadcast_to(fired.time_ns.reshape(-1, 1), echoes.range_m.shape),
        echoes,
        are_sent(unit_of(unit), "dual", packets),
    )
    got = decode(unit, packets, packet_stamps_ns(unit, fired)[1])
    assert fired.time_ns.size < len(true) < 2 * fired.time_ns.size
    assert len(got.laser) == len(true)
    assert (np.sort(got.laser) == np.sort(true["laser"])).all()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("near_x_offset_mm", 32768.0, "32768 is beyond what status bytes can say; allowed: -32768 to 32767"),
        ("focal_distance_mm", -32769.0, "-32769 is beyond what status bytes can say; allowed: -32768 to 32767"),
        ("focal_slope", 3276.8, "3276.8 is beyond what status bytes can say; allowed: -3276.8 to 3276.7"),
        ("azimuth_offset_deg", -328.0, "-328 is beyond what status bytes can say; allowed: -327.67 to 327.68"),
        ("elevation_deg", -7.7349, "-7.7349 is another beam's already in the hundredths of status bytes"),
    ],
)
def test_a_unit_that_status_bytes_cannot_say(tmp_path, key, value, message):
    unit = hdl_64e("hdl-64e-s3")
    tables = unit.beams if hasattr(unit.beams, key) else facts(unit).calibration
    table = list(getattr(tables, key))
    table[5] = value
    if tables is unit.beams:
        unit = unit.model_copy(update={"beams": tables.model_copy(update={key: tuple(table)})})
    else:
        unit = with_facts(unit, calibration={key: tuple(table)})
        key = f"velodyne.calibration.{key}"
    key = key if "." in key else f"beams.{key}"
    rig = Rig("one", (replace(mount(), sensor=unit),))
    where = re.escape(f"lidar_0: sensor 'hdl-64e-s3': {key}[5]: {message}")
    with pytest.raises(ConfigError, match=f"^{where}$"):
        simulated_packets(rig, scene(tmp_path, "ground: {reflectivity: 9}"), np.eye(4), 10**9)


def test_status_bytes_have_64_beams():
    status = facts(load_sensor("hdl-64e-s3")).packet.status
    with pytest.raises(ConfigError, match="sensor 'hdl-32e' has 32 beams; status bytes say those of 64"):
        calibration(unit_of(load_sensor("hdl-32e")), status, "strongest")


def test_without_a_calibration_the_example_unit_is_taken(tmp_path):
    sensor, packets, fired, *_ = sent("hdl-64e-s2", "strongest", 30)
    write(tmp_path / "a.pcap", sensor, packets, fired)
    warnings: list[str] = []
    list(decode_pcap(tmp_path / "a.pcap", warnings.append))
    assert warnings == [
        f"{tmp_path}/a.pcap: 192.168.1.201:2368: no whole calibration in its packets; "
        "hdl-64e-s2's example unit is taken"
    ]


def test_a_calibration_that_makes_no_sense(tmp_path):
    sensor = load_sensor("hdl-64e-s2")
    beams = sensor.beams.model_copy(update={"elevation_deg": (95.0, *sensor.beams.elevation_deg[1:])})
    bad = sensor.model_copy(update={"beams": beams})
    write(tmp_path / "a.pcap", bad, *calibrating(bad))
    with pytest.raises(PacketError, match=r"carry a calibration that no sensor has: .*95 is outside the allowed"):
        decoded(tmp_path / "a.pcap")
