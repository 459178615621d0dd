"""The cheapest rig, where a rig made by hand meets all: no dearer one is the answer, and its combination is searched."""

import pytest
import yaml

from lidarcfg.requirements.verify import Verifier
from lidarcfg.search.cheapest import cheapest
from lidarcfg.search.requirements_search import unachievable
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.loading import load_study

pytestmark = pytest.mark.slow

REGION = {"min_m": [-10, -10, 0], "max_m": [10, 10, 4], "cuboid_m": [1, 1, 0.5]}
BODY = {"name": "body", "center_m": [0, 0, 0.75], "size_m": [4, 1.8, 1.5]}


def group(name, choose, low_m, high_m, pitch_deg=0, count=1):
    """Sensors in a box, none of which need be there."""
    return {
        "name": name,
        "choose": ["none", choose],
        "count": count,
        "min": {"position_m": low_m, "rpy_deg": [0, pitch_deg, 0]},
        "max": {"position_m": high_m, "rpy_deg": [0, pitch_deg, 0]},
    }


MAST = group("mast", "os1-64", [0, 0, 2.5], [0, 0, 2.6])
CHILD_AHEAD = {
    "name": "child ahead",
    "object": {"size_m": [0.6, 0.6, 1.1]},
    "within_m": [3, 3.5],
    "sector_deg": [-4, 4],
    "headings_deg": [0],
    "returns": 10,
}
# A table of firings that looks ahead and to the right alone, from the front corners: the left one sees what is ahead.
MIRRORED = {
    "vehicle": {"boxes": [BODY]},
    "prices": {"side.yaml": 1000, "os1-64": 9000},
    "sensors": [
        group("left", "side.yaml", [2.1, 0.8, 1.0], [2.1, 0.9, 1.2]),
        group("right", "side.yaml", [2.1, -0.9, 1.0], [2.1, -0.8, 1.2]),
        MAST,
    ],
    "requirements": [CHILD_AHEAD],
}
# The midpoint and the ends of the roof's bounds are inside bars; between these is room.
BARS = {
    "vehicle": {
        "boxes": [
            BODY,
            *(
                {"name": f"bar{n}", "center_m": [x, 0, 1.6], "size_m": [0.2, 0.2, 0.3]}
                for n, x in enumerate((-0.7, 0, 0.7))
            ),
        ]
    },
    "prices": {"vlp-16": 4000, "os1-64": 9000},
    "sensors": [group("roof", "vlp-16", [-0.7, 0, 1.6], [0.7, 0, 1.65]), MAST],
    "requirements": [
        {
            "name": "pedestrian",
            "object": "pedestrian",
            "within_m": [4, 4.5],
            "sector_deg": [85, 95],
            "headings_deg": [0],
            "step_m": 1,
            "returns": 10,
        }
    ],
}
# A sensor behind a slit 0.1 m high sees boxes 0.6 to 1 m above the ground: neither corners nor middles of edges.
SLIT = {
    "vehicle": {
        "boxes": [
            {"name": "lower", "center_m": [0, 0, 0.375], "size_m": [4, 1.8, 0.75]},
            {"name": "upper", "center_m": [0, 0, 1.2], "size_m": [4, 1.8, 0.7]},
            {"name": "back", "center_m": [-1.5, 0, 0.8], "size_m": [1, 1.8, 0.1]},
        ]
    },
    "prices": {"pandar-xt32": 5000, "os1-64": 9000},
    "sensors": [
        group("slit", "pandar-xt32", [1.1, 0, 0.8], [1.1, 0, 0.8]),
        group("mast", "os1-64", [0, 0, 2.5], [0, 0, 2.6], pitch_deg=30),
    ],
    "requirements": [
        {
            "name": "box",
            "object": {"size_m": [0.4, 0.4, 1.1]},
            "within_m": [2, 2.5],
            "sector_deg": [-10, 10],
            "headings_deg": [0],
            "returns": 10,
        }
    ],
}
# Three at 0.1 are wanted, in floats 0.30000000000000004: each side has one, and one of them fails.
DIMES = {
    "vehicle": {"boxes": [BODY]},
    "prices": {"vlp-16": 0.1, "os1-64": 0.7},
    "sensors": [group("roof", "vlp-16", [-0.7, -0.5, 1.6], [0.7, 0.5, 1.65], count=3)],
    "requirements": [
        {
            "name": "crate",
            "object": {"size_m": [0.5, 0.5, 1.5]},
            "within_m": [3, 4],
            "sector_deg": [-20, 20],
            "headings_deg": [0],
            "step_m": 1,
            "sensors": 3,
            "returns": 1,
        },
        {"name": "budget", "price_at_most": 0.3},
    ],
}
BY_HAND = {
    "a mirror image": (MIRRORED, [("side.yaml", [2.1, 0.9, 1.2])], 1000),
    "between the bars": (BARS, [("vlp-16", [0.35, 0, 1.65])], 4000),
    "through the slit": (SLIT, [("pandar-xt32", [1.1, 0, 0.8])], 5000),
    "for three dimes": (DIMES, [("vlp-16", [0, y, 1.65]) for y in (-0.5, 0, 0.5)], 0.3),
}


@pytest.fixture
def folder(tmp_path):
    """With a sensor whose firings point ahead and up to 59° to the right."""
    rows = [f"{azimuth},{elevation}" for elevation in range(-25, 6) for azimuth in range(60)]
    table = ["time_ns,azimuth_deg,elevation_deg,channel", *(f"{2000 * n},{row},0" for n, row in enumerate(rows))]
    (tmp_path / "side.csv").write_text("\n".join(table))
    side = {"name": "side", "scan_pattern": {"file": "side.csv", "frame_ms": 100}, "range": {"min_m": 0.1, "max_m": 60}}
    (tmp_path / "side.yaml").write_text(yaml.safe_dump(side))
    return tmp_path


@pytest.mark.parametrize("name", BY_HAND)
def test_what_a_rig_made_by_hand_meets_is_found_for_its_price(name, folder):
    values, sensors, price = BY_HAND[name]
    (folder / "study.yaml").write_text(
        yaml.safe_dump({"region": REGION, "solver": {"evaluations": 2000, "seed": 1}} | values)
    )
    mounts = [{"name": f"s{n}", "model": model, "position_m": at} for n, (model, at) in enumerate(sensors)]
    (folder / "rig.yaml").write_text(yaml.safe_dump({"name": "hand", "sensors": mounts}))
    study = load_study(folder / "study.yaml")
    by_hand = Verifier(study.requirements).verify(load_rig(folder / "rig.yaml").mounts)
    assert by_hand.passed
    assert unachievable(study) == {}
    found = cheapest(study, threads=2)
    assert found.meets
    assert found.combination.price == price
    assert not any(one.excluded for one in found.tried if one.price == price)


def test_what_has_no_rig_yet_is_searched_on(folder):
    """With plain rigs alone, none of which keeps the constraints, it misses these, and nothing is proved."""
    body, *bars = BARS["vehicle"]["boxes"]
    boxes = [body, *(bar | {"size_m": [0.56, 0.2, 0.3]} for bar in bars)]
    values = BARS | {"vehicle": {"boxes": boxes}, "region": REGION, "solver": {"evaluations": 1}}
    (folder / "study.yaml").write_text(yaml.safe_dump(values))
    found = cheapest(load_study(folder / "study.yaml"), threads=2)
    roof = next(one for one in found.tried if one.price == 4000)
    assert found.combination.price == 9000
    assert (roof.failing, roof.meets, roof.excluded) == (("the constraints",), False, None)
    assert roof.evaluations > 0


def test_beams_that_start_ahead_of_a_sensor_reach_farther(tmp_path):
    """Of a range of 3 m, 0.4 m ahead: a box 3.34 m away, whose farthest corner is 0.12 m from its place, gets returns."""
    beams = {"elevation_deg": [-2, 0, 2], "forward_offset_mm": [400, 400, 400]}
    sensor = {"name": "arm", "beams": beams, "firing": {"step_deg": 0.2}, "range": {"min_m": 0.1, "max_m": 3}}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(sensor))
    pose = {"position_m": [0, 0, 0.05], "rpy_deg": [0, 0, 0]}
    box = {
        "name": "box",
        "object": {"size_m": [0.1, 0.1, 0.1]},
        "region": {"min_m": [3.28, -0.06, -0.1], "max_m": [3.4, 0.06, 1]},
        "headings_deg": [0],
        "returns": 1,
    }
    values = {"region": REGION, "sensors": [{"model": "arm.yaml", "min": pose, "max": pose}], "requirements": [box]}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(values))
    study = load_study(tmp_path / "study.yaml")
    assert Verifier(study.requirements).verify(study.rig(study.space.lower).mounts).passed
    assert unachievable(study) == {}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(values | {"requirements": [box | {"returns": 2000}]}))
    assert "at most" in unachievable(load_study(tmp_path / "study.yaml"))["box"]
