"""Files of the sensors that are given by name: those that lie beside a capture, elsewhere, are the witness."""

import json
import struct

import numpy as np
import pytest

from lidarcfg.capture.decode import decode
from lidarcfg.capture.emulation import find_emulated
from lidarcfg.capture.export import in_time_order, save_sidecar_files, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.capture.selection import ALL
from lidarcfg.errors import PacketError
from lidarcfg.geometry import pose
from lidarcfg.sensors.rig import load_rig
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import STREET, no_warning
from tests.command_line import lidarcfg

OUSTER, HESAI = "10.77.0.1", "10.77.0.2"
FIRING_TIMES = b"Channel,fire time(us)\n" + b"".join(b"%d,%d.5\n" % (k, 3 * k) for k in range(1, 17))
GET_FIRING_TIMES = bytes.fromhex("4774a90000000000")  # of Hesai's PTC: start, command, reserved, no payload


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """A capture of an Ouster and a Hesai, decoded with the files beside it; then these are elsewhere, renamed."""
    folder = tmp_path_factory.mktemp("both")
    settings = {"columns": 512, "firmware": "3.2"}
    rig = load_rig(
        {
            "name": "r",
            "sensors": [
                {"name": "o", "model": "os0-32", "position_m": [0, 0, 2], "host": OUSTER, "ouster": settings},
                {"name": "h", "model": "pandar-xt16", "position_m": [0, 1, 2], "host": HESAI},
            ],
        }
    )
    path = folder / "a.pcap"
    streams = simulated_packets(rig, load_scene(STREET), pose((0, 0, 0), (0, 0, 0)), 20_000_000)
    write_pcap(path, in_time_order(streams))
    beside = save_sidecar_files(path, rig.mounts)
    cloud = decode(path, "none", no_warning)
    given = {".json": folder / "files" / "unit 7", ".csv": folder / "files" / "angles of unit 8.txt"}
    (folder / "files").mkdir()
    for one in beside:
        one.rename(given[one.suffix])
    return path, list(given.values()), cloud


def test_files_of_any_name_and_place(both):
    path, given, cloud = both
    for sidecars in (given, [str(one) for one in reversed(given)]):
        found = decode(path, "none", no_warning, sidecars=sidecars)
        np.testing.assert_array_equal(found.xyz, cloud.xyz)
        np.testing.assert_array_equal(found.time_ns, cloud.time_ns)


def test_they_are_read_instead_of_those_beside(both, tmp_path):
    """With beams that point a degree higher, points of both sensors rise by it, seen from where their beams start."""
    path, (metadata, angles), cloud = both
    beside = path.with_name("a-o.json")
    beside.write_bytes(metadata.read_bytes())
    said = json.loads(metadata.read_text())
    said["beam_intrinsics"]["beam_altitude_angles"] = [
        angle + 1 for angle in said["beam_intrinsics"]["beam_altitude_angles"]
    ]
    (tmp_path / "higher").write_text(json.dumps(said))
    head, *rows = angles.read_text().split()
    higher = [f"{k},{float(elevation) + 1},{azimuth}" for k, elevation, azimuth in (row.split(",") for row in rows)]
    (tmp_path / "higher.csv").write_text("\n".join([head, *higher]))
    found = decode(path, "none", no_warning, sidecars=[tmp_path / "higher", tmp_path / "higher.csv"])
    beside.unlink()
    for sensor, up_m in (("o", 0.03618), ("h", 0.0)):
        mine = cloud.sensor == [OUSTER in name for name in cloud.sensor_names].index(sensor == "o")
        far = mine & (np.linalg.norm(cloud.xyz[:, :2], axis=1) > 5)
        assert far.sum() > 100

        def elevation_deg(one, far=far, up_m=up_m):
            xyz = one.xyz[far]
            return np.degrees(np.arctan2(xyz[:, 2] - up_m, np.linalg.norm(xyz[:, :2], axis=1)))

        assert np.median(elevation_deg(found) - elevation_deg(cloud)) == pytest.approx(1, abs=0.02)


def test_firing_times_are_for_drivers(both, tmp_path):
    """`replay --emulate` hands them out; `decode` takes those of the sensor's model, and says so."""
    path, given, cloud = both
    file = tmp_path / "times"
    file.write_bytes(FIRING_TIMES)
    sensors = find_emulated(path, "127.0.0.1", None, ALL, no_warning, [*given, file])
    (hesai,) = [one for one in sensors if one.host == HESAI]
    answer = hesai.emulator.services[0].answer(GET_FIRING_TIMES, "127.0.0.1").data
    assert struct.unpack(">2sBBI", answer[:8]) == (b"Gt", 0xA9, 0, len(FIRING_TIMES))
    assert answer[8:] == FIRING_TIMES
    warnings = []
    found = decode(path, "none", warnings.append, sidecars=[*given, file])
    assert warnings == [f"{file}: is not read: nothing in {path} needs it"]
    np.testing.assert_array_equal(found.time_ns, cloud.time_ns)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file or directory"),
        (b"", "no file of a sensor's; allowed: an Ouster's metadata, a Hesai's angles or firing times"),
        (b"{}", "no file of a sensor's"),
        (bytes(range(256)) * 9, "no file of a sensor's"),
        (b'{"beam_intrinsics": {}}', "not the metadata of an Ouster: there is neither a lidar_data_format"),
        (b"Channel,Elevation,Azimuth\n1,2,nan\n", ":2: an angle is nan; allowed: degrees"),
        (b"Channel,Elevation,Azimuth\n1,2,3\n", " has 1 channels; the packets have 16"),
    ],
)
def test_files_that_are_none(both, tmp_path, content, message):
    path, given, _ = both
    file = tmp_path / "file"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(PacketError) as error:
        decode(path, "none", no_warning, sidecars=[given[0], file])
    assert str(file) in str(error.value)
    assert message in str(error.value)


def test_the_command(both, tmp_path):
    path, given, cloud = both
    out = tmp_path / "a.npz"
    words = [word for one in given for word in ("--sidecar", one)]
    said = lidarcfg("decode", path, "--rig", "none", *words, "-o", out)
    assert (said.stdout, said.stderr) == (f"{out}: {len(cloud.xyz):,} points\n", "")
    said = lidarcfg("decode", path, "--rig", "none", "--sidecar", out, "-o", tmp_path / "b.npz", code=2)
    assert f"{out}: no file of a sensor's; allowed: " in said.stderr
    said = lidarcfg("replay", path, "127.0.0.1", *words, code=2)
    assert "--sidecar needs --emulate" in said.stderr
