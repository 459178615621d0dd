"""The catalogue against the manuals' numbers."""

import math
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.config.models import load
from lidarcfg.errors import ConfigError
from lidarcfg.packets.velodyne.model import unit
from lidarcfg.report.sensors import print_sensor
from lidarcfg.sensors.sensor import Sensor, catalogue, custom_sensor, load_sensor
from tests.capture_fixtures import datagrams_of, recording
from tests.refusals import exchanged, refused


def test_the_whole_catalogue_loads():
    assert {"vlp-16", "fan-4", "fan-8", "fan-16"} <= set(catalogue())
    for name in catalogue():
        assert load_sensor(name).name == name


def test_the_catalogue_of_a_codec_is_found_without_reading_every_file():
    """By a line of each; the same as by their models."""
    codecs = {name: load_sensor(name).codec for name in catalogue()}
    assert {"velodyne", "ouster", "hesai", "robosense", "livox", "seyond", None} == set(codecs.values())
    for codec in set(codecs.values()) - {None}:
        assert list(catalogue(codec)) == [name for name in codecs if codecs[name] == codec]


def test_the_page_has_each_sensor_of_a_maker():
    """With its number of lasers, its range, and its range at 10 % where the file has it."""
    page = (Path(__file__).parents[2] / "docs/sensors.md").read_text()
    rows = {
        row.split("`")[1]: [cell.strip() for cell in row.split("|")] for row in page.splitlines() if row[:3] == "| `"
    }
    for name in catalogue():
        sensor = load_sensor(name)
        if not sensor.maker:
            continue
        cells = rows[name]
        assert str(sensor.count) in cells
        if sensor.maker != "Velodyne":
            known = sensor.range
            assert cells[5] == (f"{known.min_m:g} to {known.max_m:g}" if known else "not known")
            assert cells[6] == (f"{known.at_10_percent_m:g}" if known and known.at_10_percent_m else "not known")


def test_the_page_says_what_is_not_known():
    page = (Path(__file__).parents[2] / "docs/sensors.md").read_text()
    makers = {name: sensor for name in catalogue() if (sensor := load_sensor(name)).maker}
    for figure, known in {
        "range": lambda sensor: sensor.range,
        "range at 10 % reflectivity": lambda sensor: sensor.range and sensor.range.at_10_percent_m,
        "wavelength, divergence": lambda sensor: sensor.optics,
        "diameter of the base": lambda sensor: sensor.housing,
    }.items():
        (row,) = (line for line in page.splitlines() if line.startswith(f"| {figure} |"))
        assert row.split("|")[2].split("`")[1::2] == [name for name in makers if not known(makers[name])]


def test_the_catalogue_is_read_as_any_file_is():
    for path in catalogue().values():
        assert load(path, Sensor, own=True) == load(path, Sensor)


def test_vlp_16_as_its_manual_has_it():
    sensor = load_sensor("vlp-16")
    # table 9-1: laser 2i at -15 + 2i degrees, laser 2i + 1 at 1 + 2i
    assert sensor.beams.elevation_deg == tuple(-15 + i if i % 2 == 0 else i for i in range(16))
    assert sensor.ring.tolist() == [0, 8, 1, 9, 2, 10, 3, 11, 4, 12, 5, 13, 6, 14, 7, 15]
    facts = unit(sensor).facts
    assert facts.firing.offset_ns == tuple(2304 * laser for laser in range(16))
    assert facts.firing.sequence_ns == 16 * 2304 + 18432
    assert facts.packet.product_id == 0x22
    modes = facts.packet.return_modes
    assert (modes.strongest, modes.last, modes.dual) == (0x37, 0x38, 0x39)


def test_vertical_offsets_are_the_focal_distance_seen_under_the_elevation():
    sensor = load_sensor("vlp-16")
    expected = [-0.04191 * math.tan(math.radians(angle)) for angle in sensor.beams.elevation_deg]
    assert sensor.vertical_offset_m == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("beams", [4, 8, 16])
def test_fans_are_even(beams):
    elevation = load_sensor(f"fan-{beams}").beams.elevation_deg
    assert elevation == pytest.approx(np.linspace(-15, 15, beams), abs=1e-14)


def test_the_sixteen_beam_fan_has_the_cones_of_the_vlp_16():
    assert load_sensor("fan-16").sin_elevation == pytest.approx(load_sensor("vlp-16").sin_elevation, abs=1e-16)


def test_unknown_names_are_told_with_the_known_ones():
    with pytest.raises(
        ConfigError,
        match=r"no sensor is called 'vlp16'; did you mean vlp-16\? allowed: a name that lidarcfg sensors lists, or a path to a .yaml$",
    ):
        load_sensor("vlp16")


VLP = catalogue()["vlp-16"].read_text()


def of_beams(count: int, flags: int, sequences: int) -> dict[str, object]:
    """A VLP-16 with other beams in other blocks, as its file would say it."""
    facts = load_sensor("vlp-16").model_dump()
    facts["beams"] = {"elevation_deg": tuple(i * 0.25 - 60 for i in range(count))}
    section = dict(facts["velodyne"])
    section["firing"] = section["firing"] | {"offset_ns": (0,) * count}
    section["packet"] = section["packet"] | {"block_flags": (0xEEFF,) * flags, "sequences_per_block": sequences}
    facts["velodyne"] = section
    return facts


@pytest.mark.parametrize(("beams", "flags", "sequences"), [(80, 5, 2), (224, 7, 1), (384, 12, 1), (192, 12, 2)])
def test_a_packet_holds_whole_firing_sequences(beams, flags, sequences):
    with pytest.raises(ConfigError, match=f"has {flags} values; allowed: 1, 2, 3, 4, 6, which divide a packet's 12"):
        unit(Sensor.model_validate(of_beams(beams, flags, sequences)))


@pytest.mark.parametrize("flags", [1, 2, 3, 4, 6])
def test_what_has_packets_has_rings_of_a_byte(flags):
    sensor = Sensor.model_validate(of_beams(32 * flags, flags, 1))
    assert unit(sensor).count == 32 * flags
    assert sensor.ring.tolist() == list(range(32 * flags))
    assert sensor.ring.max() <= 255


def test_rings_of_a_placement_sensor_do_not_wrap():
    ring = custom_sensor(tuple(i * 0.25 for i in range(300))).ring
    assert ring.tolist() == list(range(300))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sequence_ns: 55296", "sequence_ns: 34560", "velodyne.firing.offset_ns: a firing lies beyond the sequence's"),
        ("[0, 2304, ", "[0, ", "velodyne.firing.offset_ns: has 15 values; allowed: 16, one a beam"),
        ("azimuth_offset_deg: [0, ", "azimuth_offset_deg: [", "beams.azimuth_offset_deg: has 15 values"),
        (
            "sequences_per_block: 2",
            "sequences_per_block: 1",
            "velodyne.packet.sequences_per_block: 16 beams × 1 do not fill",
        ),
        ("rpm_min: 300", "rpm_min: 1201", "rotation.rpm_min: 1201 is above rpm_max, 1200"),
        (
            "rate_hz: 147",
            "rate_hz: 10001",
            "velodyne.position_packet.rate_hz: 10001 is too large; allowed: at most 10000",
        ),
        ("rate_hz: 147", "rate_hz: 0", "velodyne.position_packet.rate_hz: 0 is too small; allowed: above 0"),
        ("  min_m: 0.5\n  max", "  min_m: 100\n  max", "range.min_m: 100.0 is not below max_m"),
        ("    min_m: 0.5\n", "    min_m: 110\n", "range.reported.min_m: 110 is not below max_m"),
        ("    min_m: 0.5\n", "", "range.reported.min_m: missing"),
        ("max_m: 100\n", "max_m: 100\n  at_10_percent_m: 100.5\n", "range.at_10_percent_m: 100.5 is above max_m, 100"),
        ("product_id: 0x22", "product_id: 256", "velodyne.packet.product_id: 256 is too large; allowed: at most 255"),
    ],
)
def test_facts_that_contradict_each_other(tmp_path, old, new, message):
    path = tmp_path / "s.yaml"
    path.write_text(exchanged(VLP, old, new))
    with refused(message, f"^{path}:", ConfigError):
        unit(load_sensor(path))


def test_what_is_promised_and_what_is_reported():
    """Every model says both, with sources; a file with the former alone reports just that."""
    for name in catalogue():
        if known := load_sensor(name).range:
            assert known.source
            assert known.reported.source
            assert known.reported_m == (known.reported.min_m, known.reported.max_m)
    alone = load_sensor("vlp-16").range.model_copy(update={"reported": None})
    assert alone.reported_m == (alone.min_m, alone.max_m) == (0.5, 100)


@pytest.mark.parametrize(
    ("name", "model", "least", "most"),
    [
        ("jerry_vlp16", "vlp-16", 2.43, 109.848),
        ("nebula_vlp16", "vlp-16", 0.5, 14.624),
        ("veloview_hdl32e_monterey", "hdl-32e", 1.35, 105.292),
        ("nebula_vls128", "vls-128-2020", 1.076, 238.68),
        ("nebula_vlp32", "vlp-32c", 0.712, 24.008),
    ],
)
def test_recordings_are_within_what_is_reported(name, model, least, most):
    """All of their distances, read from the bytes alone: the figures that the files quote."""
    sensor = load_sensor(model)
    packets = [one.payload for one in datagrams_of(recording(f"{name}.pcap")) if len(one.payload) == 1206]
    units = np.stack([np.frombuffer(one, np.uint8)[:1200].reshape(12, 100)[:, 4:].reshape(-1, 3) for one in packets])
    metres = (units[..., 0] + 256.0 * units[..., 1]) * sensor.range.resolution_m
    metres = metres[metres > 0]
    assert (metres.min(), metres.max()) == pytest.approx((least, most), abs=1e-9)
    assert sensor.range.reported_m[0] <= metres.min() <= metres.max() <= sensor.range.reported_m[1]


@pytest.mark.parametrize(
    ("firing", "times"),
    [("{step_deg: 0.2}", ["0", "0"]), ("{sequence_ns: 50000, offset_ns: [0, 700]}", ["0", "700"]), (None, ["–", "–"])],
)
def test_a_sensor_of_ones_own_shows_when_its_lasers_fire(tmp_path, capsys, firing, times):
    """Each laser's row ends with it; tables that the file does not have are not listed."""
    text = "name: own\nbeams: {elevation_deg: [-5, 5]}\n" + (f"firing: {firing}\n" if firing else "")
    (tmp_path / "own.yaml").write_text(text)
    print_sensor(load_sensor("own.yaml", tmp_path))
    said = capsys.readouterr().out
    assert [line.split()[-1] for line in said.splitlines() if line.split()[:1] in (["0"], ["1"])] == times
    assert "[]" not in said
