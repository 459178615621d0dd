"""`lidarcfg verify`: a line a requirement, and exit codes that scripts can use."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.command_line import lidarcfg

ROOT = Path(__file__).parents[2]

STUDY = """
region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4]}]}
sensors:
  - model: vlp-16
    count: 2
    min: {position_m: [0, -1, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [0, 1, 2], rpy_deg: [0, 0, 0]}
prices: {vlp-16: 4000}
requirements:
  - name: crates ahead
    object: {size_m: [1, 1, 1]}
    within_m: [2, 4]
    sector_deg: [-30, 30]
    headings_deg: [0]
    returns: RETURNS
  - {name: budget, price_at_most: PRICE}
"""
RIG = """name: two
sensors:
  - {name: left, model: vlp-16, position_m: [0, 0.5, 1.6], rpy_deg: [0, 0, 0]}
  - {name: right, model: vlp-16, position_m: [0, -0.5, 1.6], rpy_deg: [0, 0, 0]}
"""


@pytest.fixture
def files(tmp_path):
    def write(returns=10, price=8000):
        study = tmp_path / "study.yaml"
        study.write_text(STUDY.replace("RETURNS", str(returns)).replace("PRICE", str(price)))
        rig = tmp_path / "rig.yaml"
        rig.write_text(RIG)
        return str(study), str(rig)

    return write


@pytest.mark.slow
def test_pass_and_fail(files, tmp_path):
    done = lidarcfg("verify", *files(), "--json", "--junit", tmp_path / "v.xml")
    found = json.loads(done.stdout)
    assert found["pass"]
    assert [one["pass"] for one in found["requirements"]] == [True, True]
    assert ElementTree.parse(tmp_path / "v.xml").getroot().find("testsuite").get("failures") == "0"
    reached = found["requirements"][0]["reached"]
    done = lidarcfg("verify", *files(int(reached) + 1, 7999), code=3)
    assert done.stdout.count("FAIL") == 3
    assert "2 of 2 requirements are not met" in done.stdout


@pytest.mark.slow
def test_sensors_without_which_it_fails_are_named(files, tmp_path):
    """Of a rig with nothing to spare: each of the sensors, as the other one alone fails."""
    reached = json.loads(lidarcfg("verify", *files(), "--json").stdout)["requirements"][0]["reached"]
    study, rig = files(int(reached))
    assert "crates ahead: fails without any one of left, right" in lidarcfg("verify", study, rig).stdout
    for name in ("left", "right"):
        alone = tmp_path / f"{name}.yaml"
        alone.write_text("\n".join(line for line in RIG.splitlines() if f"name: {name}" not in line))
        lidarcfg("verify", study, alone, code=3)


def test_rigs_are_checked_before_any_is_verified(files, tmp_path):
    """Also the other one: a line, at once, that names its file; nothing is written."""
    study, rig = files()
    with open(study, "a") as file:
        file.write("robust: {lost: 1}\n")
    alone = tmp_path / "alone.yaml"
    alone.write_text("\n".join(line for line in RIG.splitlines() if "name: left" not in line))
    done = lidarcfg("verify", study, rig, "--against", alone, "-o", tmp_path / "out", code=2)
    what = "1 of the rig's 1 sensors lost leave none; allowed: at most 0"
    assert done.stderr == f"lidarcfg: {alone}: crates ahead: {what}\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("vehicle", "reached"),
    [
        ("bus", {"child around the bus": 10, "child near the bus with a sensor lost": 14}),
        ("truck", {"pedestrian around the truck": 17, "child around the truck": 21}),
    ],
)
def test_the_rigs_that_come_along_meet_their_requirements(vehicle, reached):
    """Their files say so."""
    study = "bus" if vehicle == "bus" else f"{vehicle}-requirements"
    done = lidarcfg("verify", ROOT / f"data/studies/{study}.yaml", ROOT / f"data/rigs/{vehicle}.yaml", "--json")
    found = {one["name"]: one["reached"] for one in json.loads(done.stdout)["requirements"]}
    assert done.returncode == 0
    assert found | reached == found
