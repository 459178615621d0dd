"""Metadata of firmware before 2.0, reduced metadata, and the names that Ouster's recorder gives: as ouster-sdk has it."""

import json
import shutil

import numpy as np
import pytest

from lidarcfg.capture.decode import decode
from lidarcfg.errors import PacketError
from lidarcfg.packets.families import codec
from lidarcfg.packets.ouster.telemetry import read_metadata
from tests.capture_fixtures import no_warning
from tests.packets.ouster.judge import core
from tests.packets.ouster.test_encode import exported, mount, street

__all__ = ["street"]

UNKNOWN = "error: Command not recognized."
BEAMS = "beam_altitude_angles", "beam_azimuth_angles"
FLAT = "prod_line", "prod_sn", "build_rev", "image_rev", "prod_pn", "status"


def metadata_of(of) -> dict:
    """What an export writes."""
    return json.loads(codec(of.sensor).sidecar_files(of)[".json"])


def nested(of) -> dict:
    """As firmware 1.12 and 1.13 answer: what it does not know is an error in the file."""
    full = metadata_of(of)
    for key in ("beam_to_lidar_transform", "lidar_origin_to_beam_origin_mm"):
        del full["beam_intrinsics"][key]
    for key in ("udp_profile_lidar", "udp_profile_imu", "columns_per_packet"):
        del full["config_params"][key]
    return full | {"lidar_data_format": UNKNOWN, "calibration_status": UNKNOWN}


def flat(of, *keys: str) -> dict:
    """As drivers wrote it then: beams and mode, and these keys."""
    full = metadata_of(of)
    parts = (full["beam_intrinsics"], full["lidar_intrinsics"], full["sensor_info"])
    values = {"lidar_mode": full["config_params"]["lidar_mode"]} | parts[0] | parts[1] | parts[2]
    form = {key: value for key, value in full["lidar_data_format"].items() if "profile" not in key}
    values |= {"data_format": {key: form[key] for key in form if key != "column_window"}}
    return {key: values[key] for key in (*BEAMS, "lidar_mode", *keys)}


OLD = {
    "1.12 nested": ("os1-64", nested),
    "1.12 flat": ("os1-64", lambda of: flat(of, "lidar_to_sensor_transform", *FLAT)),
    "1.14 flat": ("os0-32", lambda of: flat(of, "lidar_to_sensor_transform", "data_format", *FLAT)),
    "reduced": ("os1-64", flat),
}


@pytest.mark.parametrize("kind", OLD)
def test_what_old_metadata_does_not_say_is_as_in_ouster_sdk(kind):
    """The packets' layout, the beams' origin and the lidar's pose; they come from the product's line, or none."""
    model, make = OLD[kind]
    content = json.dumps(make(mount(model, profile="LEGACY")))
    theirs = core.SensorInfo(content)
    ours = read_metadata("a.json", content.encode())
    form = theirs.format
    assert form.columns_per_frame == 1024
    assert ours.layout.name == str(form.udp_profile_lidar) == "LEGACY"
    assert ours.layout.pixels == form.pixels_per_column
    assert ours.layout.columns_per_frame == form.columns_per_frame
    assert ours.layout.columns_per_packet == form.columns_per_packet
    assert ours.window == tuple(form.column_window)
    np.testing.assert_allclose(np.degrees(ours.elevation_rad), theirs.beam_altitude_angles)
    np.testing.assert_allclose(np.degrees(ours.azimuth_rad), theirs.beam_azimuth_angles)
    to_lidar = theirs.beam_to_lidar_transform
    np.testing.assert_allclose(ours.start_m, (to_lidar[0, 3] / 1000, to_lidar[2, 3] / 1000), atol=1e-12)
    assert ours.start_m[0] > 0.01
    to_sensor = ours.T_sensor_lidar.copy()
    to_sensor[:3, 3] *= 1000
    np.testing.assert_allclose(to_sensor, theirs.lidar_to_sensor_transform)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lidar_mode": "1000x10"}, "neither a lidar_data_format with columns_per_frame nor a lidar_mode like 1024x10"),
        ({"data_format": [1]}, r"data_format is '\[1\]', not keys and values"),
        ({"beam_altitude_angles": [1.0]}, "64 pixels a column, 1 altitude and 64 azimuth angles"),
    ],
)
def test_reduced_metadata_that_is_not_enough(change, message):
    content = json.dumps(flat(mount("os1-64", profile="LEGACY")) | change)
    with pytest.raises(PacketError, match=message):
        read_metadata("a.json", content.encode())


def test_the_recorders_name(street, tmp_path):
    """NAME_0.json beside NAME.pcap; but not if it is NAME_0.pcap's."""
    path, metadata, _ = exported(tmp_path, street, mount("os1-32"), duration_ns=20_000_000)
    expected = decode(path, on_warning=no_warning).xyz
    metadata.rename(tmp_path / "a_0.json")
    np.testing.assert_array_equal(decode(path, on_warning=no_warning).xyz, expected)
    shutil.copy(path, tmp_path / "a_0.pcap")
    with pytest.raises(PacketError, match="need the sensor's metadata"):
        decode(path, on_warning=no_warning)
