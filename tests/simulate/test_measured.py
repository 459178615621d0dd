"""The roughness of real sensors: what is exported is as rough as recordings, measured in the same way; and as is said."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.rig import Rig, load_rig, save_rig
from lidarcfg.sensors.sensor import Reported, catalogue, load_sensor
from lidarcfg.simulate.echoes import Echoes, add_noise, drop_one_return, laser_errors_m
from lidarcfg.units import SECOND_NS
from lidarcfg.vsr.cones import sensor_lidar
from lidarcfg.world.scene import load_scene
from tests.capture_fixtures import datagrams_of, decoded, mount, recording, scene
from tests.refusals import refused
from tests.simulate import roughness

ROOT = Path(__file__).parents[2]
ROOM = ROOT / "data/scenes/room.yaml"
NEAR = 0.25  # by which two figures may differ, as a fraction
NO_GREATEST = "laser_error_max_mm"  # one laser's, of a few: it says little


@pytest.fixture(autouse=True)
def _few_revolutions(monkeypatch):
    monkeypatch.setattr(roughness, "REVOLUTIONS", 3)


def exported(tmp_path, model, realism, mode="strongest"):
    """Half a second in a hall."""
    one = mount(position_m=(0.3, 0.2, 1.6), rpy_deg=(2.0, 3.0, 10.0))
    one = replace(one, sensor=load_sensor(model), model=model, return_mode=mode, realism=realism)
    path = tmp_path / f"{model}.pcap"
    write_pcap(path, in_time_order(simulated_packets(Rig("r", (one,)), load_scene(ROOM), np.eye(4), SECOND_NS // 2)))
    return path


def of_file(tmp_path, model, said):
    """The realism that a rig's file means."""
    rig = {"name": "r", "sensors": [{"name": "a", "model": model, "position_m": [0, 0, 2], "realism": said}]}
    (tmp_path / "r.yaml").write_text(yaml.safe_dump(rig))
    return load_rig(tmp_path / "r.yaml")


def measured(path, model=None):
    """The figures of a capture's only source."""
    (one,) = roughness.read(path, model).values()
    return roughness.measure(one)


@pytest.mark.parametrize(
    ("model", "mode", "names"),
    [
        ("vlp-16", "dual", ["mrpt_vlp16_gps", "jerry_vlp16", "nebula_vlp16"]),
        ("hdl-32e", "strongest", ["veloview_hdl32e_monterey"]),
    ],
)
def test_exports_are_as_rough_as_recordings(tmp_path, model, mode, names):
    """By one measurement, which knows nothing of simulation: within 25 % of the recordings' medians."""
    recorded = [measured(recording(f"{name}.pcap"), model) for name in names]
    realism = of_file(tmp_path, model, "measured").mounts[0].realism
    ours = measured(exported(tmp_path, model, realism, mode))
    compared = 0
    for name in (field.name for field in fields(ours)):
        known = [getattr(one, name) for one in recorded if np.isfinite(getattr(one, name))]
        if known and name != NO_GREATEST:
            assert getattr(ours, name) == pytest.approx(np.median(known), rel=NEAR), name
            compared += 1
    assert compared == (13 if mode == "dual" else 5)


@pytest.mark.slow
def test_what_was_put_in_is_measured(tmp_path):
    """And without any, steps of 2 mm alone: their sigma is 2 mm / sqrt 12."""
    exact = measured(exported(tmp_path, "vlp-16", None))
    assert exact.noise_mm == pytest.approx(2 / 12**0.5, rel=0.2)
    assert exact.laser_error_mm < 1
    assert exact.dropout_percent == exact.intensity_levels == 0
    put_in = Realism(
        range_noise_m=0.02, laser_error_m=0.015, dropout_fraction=0.02, intensity_noise=4, dark_noise_m=0.025
    )
    found = measured(exported(tmp_path, "vlp-16", put_in))
    assert found.noise_mm == pytest.approx(20, rel=0.1)
    assert found.dark_noise_mm == pytest.approx(25, rel=0.15)
    assert found.laser_error_mm == pytest.approx(15, rel=0.15)
    assert found.dropout_percent == pytest.approx(2, rel=0.1)
    assert found.intensity_levels == pytest.approx(4, rel=0.1)


def test_each_laser_has_its_own_error_and_keeps_it():
    """Their standard deviation is exactly what was said; another seed or sensor mixes them."""
    one = laser_errors_m(Realism(laser_error_m=0.01), 0, 32)
    assert one.std() == pytest.approx(0.01, rel=1e-12)
    assert one.mean() == pytest.approx(0, abs=1e-12)
    assert len(set(one.tolist())) == 32
    for other in (
        laser_errors_m(Realism(laser_error_m=0.01, seed=1), 0, 32),
        laser_errors_m(Realism(laser_error_m=0.01), 1, 32),
    ):
        assert sorted(other) == sorted(one)
        assert other.tolist() != one.tolist()
    assert not laser_errors_m(Realism(), 0, 32).any()


def flat(count, columns, byte):
    return Echoes(
        np.full((count, columns), 10.0),
        np.zeros((count, columns)),
        np.full((count, columns), byte, np.uint8),
        np.zeros(()),
        np.full(count, 10.0),
    )


def test_the_noise_of_dark_targets_and_of_intensities():
    realism = Realism(seed=3, range_noise_m=0.01, dark_noise_m=0.03, intensity_noise=3)
    for byte, sigma_m in ((1, 0.03), (2, 0.01), (90, 0.01)):
        found = flat(20_000, 4, byte)
        add_noise(found, realism, 0, 0)
        assert found.noise_m.std() == pytest.approx(sigma_m, rel=0.02)
        assert (found.noise_m == found.noise_m[:, :1]).all()  # one echo, four times
        assert (found.reflectivity == found.reflectivity[:, :1]).all()
        if byte == 90:
            assert found.reflectivity[:, 0].std() == pytest.approx((9 + 1 / 12) ** 0.5, rel=0.02)
    whole = flat(64, 4, 50)
    parts = [flat(16, 4, 50) for _ in range(4)]
    add_noise(whole, realism, 0, 0)
    for i, part in enumerate(parts):
        add_noise(part, realism, 0, 16 * i)
    assert (whole.noise_m == np.concatenate([part.noise_m for part in parts])).all()
    assert (whole.reflectivity == np.concatenate([part.reflectivity for part in parts])).all()


def test_one_slot_of_a_pair_is_empty():
    pairs = flat(100_000, 2, 50)
    drop_one_return(pairs, Realism(last_alone_fraction=0.02, strongest_alone_fraction=0.01), 0, 0)
    assert (~np.isfinite(pairs.range_m)).mean(axis=0).tolist() == pytest.approx([0.02, 0.01], rel=0.1)
    assert np.isfinite(pairs.range_m).any(axis=1).all()


def test_a_rig_says_measured(tmp_path):
    """Alone, or with values of its own; what it is saved as has all values, and reads back the same."""
    known = load_sensor("vlp-16").realism
    alone = of_file(tmp_path, "vlp-16", "measured")
    assert alone.mounts[0].realism == of_file(tmp_path, "vlp-16", {"preset": "measured"}).mounts[0].realism
    assert alone.mounts[0].realism.model_dump(exclude={"preset"}) == known.model_dump(exclude={"preset", "source"})
    own = of_file(tmp_path, "vlp-16", {"preset": "measured", "seed": 4, "divergence": False, "range_noise_m": 0})
    changed = {"seed": 4, "divergence": False, "range_noise_m": 0.0, "preset": None}
    assert own.mounts[0].realism.model_dump() == known.model_dump(exclude={"source"}) | changed
    save_rig(alone, tmp_path / "b.yaml")
    assert load_rig(tmp_path / "b.yaml").mounts[0].realism == alone.mounts[0].realism


@pytest.mark.parametrize(
    ("model", "said", "message"),
    [
        ("vlp-16", "rough", "sensors[0].realism: 'rough' is not allowed; allowed: measured, or keys and values"),
        ("vlp-16", {"preset": "rough"}, "sensors[0].realism.preset"),
        ("vlp-16", {"laser_error_m": -1}, "sensors[0].realism.laser_error_m"),
        ("vlp-16", {"divergence": [1, 0]}, "sensors[0].realism.divergence"),
        (
            "os1-64",
            "measured",
            "sensors[0].realism: nothing has been measured of sensor 'os1-64'; allowed: its own values, or",
        ),
    ],
)
def test_what_is_not_allowed(tmp_path, model, said, message):
    with refused(message, f"^{tmp_path}/r.yaml:", ConfigError):
        of_file(tmp_path, model, said)


def test_every_preset_says_where_it_is_from():
    measured = [name for name in catalogue() if load_sensor(name).realism]
    known = ["hdl-32e", "helios-32", "os0-128", "os0-32", "os2-128", "pandar-xt16", "pandar-xt32", "vlp-16", "vlp-32c"]
    known += ["vls-128", "vls-128-2020"]
    assert measured == known
    assert all("tests/simulate/roughness.py" in load_sensor(name).realism.source for name in measured)


def test_surfaces_that_bend_by_more_than_the_noise_are_refused():
    """Firings 20 mm apart with 5 mm of noise, on a wall and on bends of 20 and 1.5 m radius: along these the range changes
    by up to 2 and 27 mm from firing to firing. On a wall again, but of few firings."""
    across_m = (np.arange(200) - 100) * 0.02
    noise_m = np.random.default_rng(0).normal(0, 0.005, (200, 4))
    bend_m = across_m[:, None] ** 2 / (2 * np.array([np.inf, 20, 1.5, np.inf]))
    plane = np.zeros((199, 4), np.int64)
    plane[20:, 3] = -1
    found = roughness.bent(np.diff(bend_m + noise_m, axis=0), plane)
    assert found.all(axis=0).tolist() == [False, False, True, True]
    assert not found[:, :2].any()


def test_lasers_that_take_turns_are_not_measured():
    with pytest.raises(ValueError, match="qt128: its lasers take turns"):
        roughness.read(recording("hesai/nebula_qt128.pcap"), None)


def test_what_a_capture_does_not_say_is_no_figure(tmp_path):
    """Nothing but sky, and ten points on a far ball: no zeros, no warning."""
    for text in (
        "{name: far, center_m: [300, 0, 2], radius_m: 9}",
        "{name: ball, center_m: [20, 0, 2], radius_m: 0.2}",
    ):
        one = replace(mount(), return_mode="dual", realism=Realism(range_noise_m=0.01))
        stage = scene(tmp_path, f"spheres: [{text[:-1]}, reflectivity: 40}}]")
        write_pcap(
            tmp_path / "a.pcap", in_time_order(simulated_packets(Rig("r", (one,)), stage, np.eye(4), SECOND_NS // 4))
        )
        found = measured(tmp_path / "a.pcap")
        said = {name for name, value in vars(found).items() if np.isfinite(value)}
        assert "two_at_edges_percent" not in said
        assert "two_at_laser_edges_percent" not in said
        assert said <= (
            {"two_distances_percent", "two_elsewhere_percent", *roughness.PAIRS} if "ball" in text else set()
        )


def test_exports_keep_what_is_reported_and_placement_what_is_promised(tmp_path):
    """An HDL-32E, promised from 1 to 100 m, returns from walls at 0.3, 0.9 and 103 m, not at 0.1 and 106 m."""
    sensor = load_sensor("hdl-32e")
    assert sensor_lidar(sensor, None, None).range_m == (1.0, 100.0)
    one = replace(mount(position_m=(0.0, 0.0, 0.0)), sensor=sensor, model="hdl-32e")
    found = set()
    for at_m in (0.1, 0.3, 0.9, 103.0, 106.0):
        wall = f"planes: [{{name: wall, center_m: [{at_m}, 0, 0], size_m: [90, 90], rpy_deg: [0, -90, 0], reflectivity: 50}}]"
        write_pcap(
            tmp_path / "a.pcap",
            in_time_order(simulated_packets(Rig("r", (one,)), scene(tmp_path, wall), np.eye(4), 10**8)),
        )
        cloud = decoded(tmp_path / "a.pcap")
        near = abs(cloud.xyz[:, 1]) < 0.05 * at_m
        assert cloud.xyz[near, 0] == pytest.approx(at_m, abs=0.01)
        found |= {at_m} if near.any() else set()
    assert found == {0.3, 0.9, 103.0}


WIRE = {  # where returns begin in a packet; blocks, their bytes, and those before returns; returns, their bytes; unit
    "vlp-32c": ("<u2", 0, (12, 100, 4), (32, 3), 0.004),
    "hdl-32e": ("<u2", 0, (12, 100, 4), (32, 3), 0.002),
    "pandar-xt16": ("<u2", 12, (8, 66, 2), (16, 4), 0.004),
    "helios-32": (">u2", 42, (12, 100, 4), (32, 3), 0.0025),
}


@pytest.mark.parametrize("model", WIRE)
def test_nothing_beyond_what_is_reported_is_on_the_wire(tmp_path, model):
    """Flat ground, from a few millimetres off to beyond every range; without the limits there would be more of it."""
    kind, begin, (blocks, size, head), (returns, width), unit_m = WIRE[model]
    sensor = load_sensor(model)
    stage = scene(tmp_path, "ground: {reflectivity: 50}")
    limitless = sensor.range.model_copy(update={"reported": Reported(source="", min_m=0, max_m=10_000)})
    found = []
    for one in (sensor, sensor.model_copy(update={"range": limitless})):
        range_m = []
        for height_m in (0.002, 0.1, 2.6, 3.7):
            placed = replace(mount(position_m=(0.0, 0.0, height_m)), sensor=one, model=model, data_port=6699)
            streams = simulated_packets(Rig("r", (placed,)), stage, np.eye(4), SECOND_NS // 200)
            write_pcap(tmp_path / "a.pcap", in_time_order(streams))
            for packet in (one.payload for one in datagrams_of(tmp_path / "a.pcap") if one.port == 6699):
                octets = np.frombuffer(packet, np.uint8)[begin : begin + blocks * size].reshape(blocks, size)[:, head:]
                pairs = octets[:, : returns * width].reshape(-1, width)[:, :2]
                range_m.append(np.ascontiguousarray(pairs).view(kind)[:, 0] * unit_m)
        found.append(np.concatenate(range_m))
    kept, everything = (values[values > 0] for values in found)
    least_m, most_m = sensor.range.reported_m
    assert len(kept) > 1000
    assert least_m - unit_m / 2 <= kept.min() < kept.max() <= most_m + unit_m / 2
    assert everything.min() < least_m or model == "helios-32"
    assert everything.max() > most_m
    inside = (everything >= least_m - unit_m / 2) & (everything <= most_m + unit_m / 2)
    assert np.array_equal(np.unique(everything[inside]), np.unique(kept))


def test_edges_from_laser_to_laser_are_where_a_surface_ends():
    """Ground 2 m below that a wall at 10 m follows: no edge; the top of a box at 4 m before that wall: the lasers around."""
    elevation = np.radians(np.arange(-15, 16, 2.0))
    with np.errstate(divide="ignore"):
        ground = np.where(elevation < 0, -2 / np.sin(elevation), np.inf)
    wall = 10 / np.cos(elevation)
    corner = np.minimum(ground, wall)
    assert not roughness._laser_edges(np.array([corner, wall]), elevation).any()
    box = np.where(elevation < np.radians(-5), np.minimum(ground, 4 / np.cos(elevation)), corner)
    assert np.flatnonzero(roughness._laser_edges(box[None], elevation)[0]).tolist() == [3, 4, 5]
    box[6] = np.nan  # beside nothing nothing is said
    assert np.flatnonzero(roughness._laser_edges(box[None], elevation)[0]).tolist() == [3, 4]
    across = np.where((np.arange(40) > 10) & (np.arange(40) < 20), 3.0, 8.0)[:, None]
    assert np.flatnonzero(roughness._firing_edges(across)[:, 0]).tolist() == [10, 11, 19, 20]
