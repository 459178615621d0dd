"""Sensors to choose: the combinations of a study, what is refused, and that each combination is an ordinary study."""

import itertools
import math
from collections import Counter
from itertools import product

import numpy as np
import pytest
import yaml

from lidarcfg.config.models import load
from lidarcfg.errors import ConfigError
from lidarcfg.search.combinations import combinations
from lidarcfg.study.criterion import objective_of
from lidarcfg.study.file import StudyFile
from lidarcfg.study.loading import load_study
from lidarcfg.study.mounting import lidars_at
from lidarcfg.vsr.metric import max_vsr
from tests.refusals import exchanged, refused
from tests.studies import study_of

CHOICES = """region: {min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 0.5, 0.25]}
prices: {vlp-16: 4000, fan-4: 500.5, os1-64: 12000}
sensors:
  - {name: roof, choose: [vlp-16, fan-4, none], count: 3, min: {position_m: [5, 3, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [7, 5, 2.5], rpy_deg: [0, 0, 0]}}
  - {choose: [os1-64, none], count: 2, mirror_y_m: 4, min: {position_m: [1, 1, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [2, 3, 2], rpy_deg: [0, 0, 0]}}
  - {name: nose, model: fan-4, min: {position_m: [6, 4, 1.5], rpy_deg: [0, 0, 0]}, max: {position_m: [6, 4, 2.5], rpy_deg: [0, 0, 0]}}
"""


def study(tmp_path, text=CHOICES):
    return study_of(tmp_path, text)


def test_the_combinations_are_those_of_every_sensor_by_itself(tmp_path):
    """Each of the three on the roof chosen by itself, the pair as one; what differs in order alone is the same."""
    prices = {"vlp-16": 4000, "fan-4": 500.5, "os1-64": 12000, "none": 0}
    expected = {
        (tuple(sorted(roof)), pair): sum(map(prices.get, roof)) + 2 * prices[pair] + prices["fan-4"]
        for *roof, pair in product(*[("vlp-16", "fan-4", "none")] * 3, ("os1-64", "none"))
    }
    found = {}
    for one in combinations(study(tmp_path)):
        counts = Counter(slot.sensor.name for slot in one.study.slots)
        assert counts["os1-64"] in (0, 2)
        assert one.study.slots[-1].name == "nose"
        pair = "os1-64" if counts["os1-64"] else "none"
        roof = ["vlp-16"] * counts["vlp-16"] + ["fan-4"] * (counts["fan-4"] - 1)
        found[tuple(sorted(roof + ["none"] * (3 - len(roof)))), pair] = one.price
    assert found == expected


@pytest.mark.parametrize(
    ("kinds", "count", "others"), [(("vlp-16", "none"), 1, 0), (("vlp-16", "fan-4", "none"), 4, 1), (("fan-4",), 2, 2)]
)
def test_combinations_are_counted_without_making_them(kinds, count, others, tmp_path):
    group = "{choose: [%s], count: %d, min: {position_m: [5, 3, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [7, 5, 2.5], rpy_deg: [0, 0, 0]}}"
    text = CHOICES.partition("sensors:")[0] + f"sensors:\n  - {group % (', '.join(kinds), count)}\n"
    text += f"  - {group % ('os1-64, none', 1)}\n" * others
    loaded = study(tmp_path, text)
    names = [one.name for one in combinations(loaded)]
    assert len(names) == len(set(names))
    assert load(tmp_path / "study.yaml", StudyFile).combinations == len(names)


def test_a_combination_is_the_study_that_its_file_describes(tmp_path):
    """Written to a file and loaded, it is the same: sensors, names, bounds, mirrors and values."""
    for one in combinations(study(tmp_path))[::3]:
        path = tmp_path / "one.yaml"
        path.write_text(yaml.safe_dump(one.study.file))
        again = load_study(path)
        assert not again.to_choose
        assert again.slots == one.study.slots
        assert again.file == one.study.file
        for key in ("lower", "upper", "mirror"):
            np.testing.assert_array_equal(getattr(again.space, key), getattr(one.study.space, key))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "prices: {vlp-16: 4000, fan-4: 500.5, os1-64: 12000}\n",
            "",
            "3:27: sensors[0].choose[0]: 'vlp-16' has no price",
        ),
        ("os1-64: 12000", "os1-32: 12000", "sensors[1].choose[0]: 'os1-64' has no price; give it one in prices"),
        ("fan-4: 500.5, ", "", "sensors[0].choose[1]: 'fan-4' has no price; give it one in prices"),
        ("vlp-16: 4000", "vlp-16: -1", "2:10: prices.vlp-16: -1 is too small; allowed: above 0"),
        ("vlp-16: 4000", "vlp-16: 0", "2:10: prices.vlp-16: 0 is too small; allowed: above 0"),
        ("vlp-16: 4000", "vlp-16: .nan", "prices.vlp-16: .nan is not a finite number"),
        ("vlp-16: 4000", "vlp-16: 1e13", "prices.vlp-16: 10000000000000 is too large; allowed: at most 1000000000000"),
        ("vlp-16: 4000", "vlp-16: cheap", "prices.vlp-16: 'cheap' is not a number"),
        ("vlp-16: 4000", "none: 0, vlp-16: 4000", "prices.none: 0 is too small; allowed: above 0"),
        ("vlp-16: 4000", "none: 1, vlp-16: 4000", "prices.none: costs nothing; remove its price"),
        ("[os1-64, none]", "[none]", "sensors[1].choose: the only choice is none; give a model, or remove the sensor"),
        ("[os1-64, none]", "[]", "sensors[1].choose: has 0 values; allowed: at least 1"),
        ("fan-4, none]", "vlp-16, none]", "sensors[0].choose[1]: 'vlp-16' is a choice already; each may be given once"),
        ("[os1-64, none]", "[none, os1-64, none]", "sensors[1].choose[2]: 'none' is a choice already"),
        (
            "name: roof, ",
            "name: roof, model: vlp-16, ",
            "sensors[0].choose: conflicts with model; give only one of them",
        ),
        ("model: fan-4, ", "", "sensors[2]: missing; give model, elevation_deg or choose"),
        ("model: fan-4, ", "elevation_deg: [1, 2], ", "sensors[2].elevation_deg: has no model, so no price"),
        ("[vlp-16, fan-4, none]", "[x-1, none]", "has no price"),
    ],
)
def test_what_is_refused_and_where(old, new, message, tmp_path):
    with refused(message, f"^{tmp_path}/study.yaml:", ConfigError):
        study(tmp_path, exchanged(CHOICES, old, new))


def test_an_unknown_model_is_refused_where_it_is_chosen(tmp_path):
    with pytest.raises(ConfigError, match=r"study.yaml:4:27: sensors\[0\].choose\[0\]: .*vlp-15"):
        study(tmp_path, CHOICES.replace("vlp-16", "vlp-15"))


def test_one_model_under_two_names_is_refused(tmp_path):
    sensor = tmp_path / "mine.yaml"
    sensor.write_text("name: mine\nbeams: {elevation_deg: [-5, 0, 5]}\n")
    (tmp_path / "again.yaml").write_text(sensor.read_text())
    text = CHOICES.replace("[os1-64, none]", "[mine.yaml, again.yaml]").replace(
        "os1-64: 1", "mine.yaml: 7, again.yaml: 1"
    )
    with pytest.raises(ConfigError, match=r"choose\[1\]: 'again.yaml' is a choice already under another name"):
        study(tmp_path, text)


def test_a_thousand_million_combinations_are_counted_and_refused(tmp_path):
    """Nine groups of which each allows ten, and no rig without any sensor."""
    group = "  - {choose: [vlp-16, fan-4, none], count: 3, min: {position_m: [5, 3, 1], rpy_deg: [0, 0, 0]}, max: {position_m: [7, 5, 2], rpy_deg: [0, 0, 0]}}\n"
    head = CHOICES.partition("sensors:")[0]
    with pytest.raises(ConfigError) as caught:
        study(tmp_path, head + "sensors:\n" + 9 * group)
    assert str(caught.value).endswith(
        "study.yaml:3:1: sensors: the choices allow 999,999,999 combinations; allowed: at most 1,000"
    )
    many = group.replace("count: 3", "count: 1000")
    assert math.comb(1002, 2) ** 40 > 10**200
    with pytest.raises(ConfigError, match="allow more than 1,000,000,000,000,000,000 combinations"):
        study(tmp_path, head + "sensors:\n" + 40 * many)


def test_a_choice_may_be_none_where_a_sensor_may_fail(tmp_path):
    """With two lost, only rigs of three or more; the cost of each is that of the worst rig left, one by one."""
    whole = {one.name: one for one in combinations(study(tmp_path))}
    found = combinations(study(tmp_path, CHOICES + "robust: {lost: 2}\n"))
    assert {one.name for one in found} == {name for name, one in whole.items() if len(one.study.slots) > 2}
    assert len(found) < len(whole)
    for one in (found[0], min(found, key=lambda one: len(one.study.slots))):
        poses = one.study.space.midpoint
        lidars = lidars_at(one.study.slots, poses)
        left = [max_vsr(one.study.region, some) for some in itertools.combinations(lidars, len(lidars) - 2)]
        assert objective_of(one.study, poses) == pytest.approx(max(left), rel=1e-12)


def test_every_model_sits_on_the_surface_by_its_own_base(tmp_path):
    """On a box whose top is 1.2 m high and 1 m wide: the middle of a base is half a diameter or more from its rim."""
    text = (
        CHOICES.partition("sensors:")[0]
        + """vehicle: {boxes: [{name: box, center_m: [6, 4, 0.6], size_m: [2, 1, 1.2]}]}
sensors:
  - {name: roof, choose: [vlp-16, helios-32, none], count: 2, on: {body: box, from: above, within: {min_m: [5, 3, 1], max_m: [7, 5, 1.3]}, standoff_m: 0.1}, roll_deg: [-10, 10]}
"""
    )
    text = text.replace("fan-4: 500.5, os1-64: 12000", "helios-32: 3000")
    loaded = study(tmp_path, text)
    found = combinations(study(tmp_path, text))
    assert len(found) == 5
    radius = {"vlp-16": 0.0515, "helios-32": 0.05}
    rng = np.random.default_rng(1)
    for one in found:
        poses = one.study.space.poses(rng.random((400, one.study.space.dimensions)))
        fits = one.study.space.violation(poses) == 0
        assert fits.any()
        assert not fits.all()
        assert np.abs(poses[fits, :, 2] - 1.3).max() < 1e-6
        for i, slot in enumerate(one.study.slots):
            away = np.minimum(1.0 - np.abs(poses[:, i, 0] - 6), 0.5 - np.abs(poses[:, i, 1] - 4))
            assert away[fits].min() >= radius[slot.sensor.name] - 1e-6
    assert loaded.to_choose
