"""Rigs: defaults, refusals, and that what is written reads back bit for bit."""

import math

import pytest

import lidarcfg.sensors.rig as rigs
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.rig import load_rig, rig_to_dict, save_rig
from tests.refusals import refused

MINIMAL = "name: r\nsensors:\n  - {name: a, model: vlp-16, position_m: [1, 2, 3]}\n"


def rig(tmp_path, text):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return load_rig(path)


def test_defaults(tmp_path):
    second = "  - {name: b, elevation_deg: [0, 1], position_m: [0, 0, 1], rpy_deg: [180, 0, 90]}\n"
    first, second = rig(tmp_path, MINIMAL + second).mounts
    assert (first.host, first.data_port, first.telemetry_port) == ("192.168.1.201", 2368, 8308)
    assert (first.rpm, first.return_mode, first.rpy_rad) == (600.0, "strongest", (0.0, 0.0, 0.0))
    assert second.host == "192.168.1.202"
    assert second.rpy_rad == (math.pi, 0.0, math.pi / 2)
    assert second.T_vehicle_sensor[:3, 2] == pytest.approx([0, 0, -1], abs=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            MINIMAL.replace("vlp-16", "vlp-17"),
            "rig.yaml:3:15: sensors[0].model: no sensor is called 'vlp-17'",
        ),
        (
            MINIMAL.replace("model: vlp-16, ", ""),
            "rig.yaml:3:5: sensors[0]: missing; give model or elevation_deg",
        ),
        (MINIMAL.replace("]}", "], host: 300.1.1.1}"), "sensors[0].host: '300.1.1.1' is not an IPv4 address"),
        (
            MINIMAL.replace("]}", "], rpm: 100}"),
            "rig.yaml:3:53: sensors[0].rpm: 100 is outside vlp-16's 300 to 1200",
        ),
        (MINIMAL.replace("]}", "], rpm: -1}"), "sensors[0].rpm: -1 is too small; allowed: above 0"),
        (
            "name: r\nsensors:\n  - {name: a, elevation_deg: [0, 1], position_m: [0, 0, 1], realism: {divergence: true}}\n",
            "rig.yaml:3:71: sensors[0].realism.divergence: sensor 'custom' has no optics facts",
        ),
        (
            MINIMAL.replace("]}", "], data_port: 70000}"),
            "data_port: 70000 is too large; allowed: at most 65535",
        ),
        (MINIMAL.replace("]}", "], return_mode: both}"), "return_mode: 'both' is not allowed; allowed: 'strongest'"),
        (
            MINIMAL.replace("]}", "], rpy_rad: [0, 0, 0], rpy_deg: [0, 0, 0]}"),
            "rpy_deg: conflicts with rpy_rad",
        ),
        (
            MINIMAL.replace("position_m", "position"),
            "sensors[0].position: unknown key without a unit; allowed: pos",
        ),
        (
            MINIMAL + "  - {name: a, model: vlp-16, position_m: [0, 0, 0]}\n",
            "sensors[1].name: 'a' is a sensor",
        ),
        (
            MINIMAL + "  - {name: b, model: vlp-16, position_m: [0, 0, 0], host: 192.168.1.201}\n",
            "rig.yaml:4:5: sensors[1]: 192.168.1.201:2368 is already used by 'a'; give each sensor its own address and port",
        ),
        (
            MINIMAL + "  - {name: b, model: vlp-16, position_m: [0, 0, 0], host: 192.168.1.201, data_port: 8308}\n",
            "rig.yaml:4:5: sensors[1]: 192.168.1.201:8308 is the data_port of one and the telemetry_port of the other, this and 'a'",
        ),
        (MINIMAL.replace("[1, 2, 3]", "[1, 2]"), "sensors[0].position_m[2]: missing"),
        ("name: r\nsensors: []\n", "rig.yaml:2:1: sensors: has 0 values; allowed: at least 1"),
    ],
)
def test_refused(tmp_path, text, message):
    with refused(message, kind=ConfigError):
        rig(tmp_path, text)


def test_no_default_address_beyond_the_network(tmp_path):
    rows = "".join(f"  - {{name: s{i}, model: vlp-16, position_m: [0, 0, {i}]}}\n" for i in range(55))
    with pytest.raises(ConfigError, match=r"sensors\[54\]: no default address is left"):
        rig(tmp_path, "name: r\nsensors:\n" + rows)


def test_written_and_read_back_bit_for_bit(tmp_path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own/s.yaml").write_text("name: s\nbeams: {elevation_deg: [0]}\n")
    text = MINIMAL.replace("[1, 2, 3]", "[0.1, -1e-17, 2.2000000000000006]") + (
        "  - {name: b, elevation_deg: [-0.3333333333333333], position_m: [0, 0, 1]}\n"
        "  - {name: c, model: own/s.yaml, position_m: [0, 0, 1], data_port: 4000}\n"
    )
    before = rig(tmp_path, text)
    (tmp_path / "out").mkdir()
    save_rig(before, tmp_path / "out/rig.yaml")
    after = load_rig(tmp_path / "out/rig.yaml")
    assert after == before
    assert rig_to_dict(after) == rig_to_dict(before)


def test_a_model_is_read_once_however_many_sensors_have_it(tmp_path, monkeypatch):
    """A thousand sensors of 10,000 beams would take minutes; by the number of times that files are read."""
    (tmp_path / "fan.yaml").write_text("name: fan\nbeams: {elevation_deg: [-5, 0, 5]}\n")
    names = [
        f"{{name: {one}{n}, model: {one}, position_m: [0, 0, 2]}}" for n in range(3) for one in ("fan.yaml", "vlp-16")
    ]
    names.append("{name: own, elevation_deg: [-5, 0, 5], position_m: [0, 0, 2]}")
    (tmp_path / "rig.yaml").write_text("name: r\nsensors:\n" + "".join(f"  - {one}\n" for one in names))
    asked = []
    load = rigs.load_sensor
    monkeypatch.setattr(rigs, "load_sensor", lambda name, base: asked.append(name) or load(name, base))
    found = load_rig(tmp_path / "rig.yaml")
    assert sorted(asked) == ["fan.yaml", "vlp-16"]
    assert [mount.sensor.name for mount in found.mounts] == ["fan", "vlp-16"] * 3 + ["custom"]
