"""Every mistake in a requirement is one line that says where, what and what is allowed."""

import pytest

from tests.command_line import lidarcfg

STUDY = """region: {min_m: [-10, -10, 0], max_m: [10, 10, 4], cuboid_m: [1, 1, 1]}
VEHICLE
sensors:
  - model: vlp-16
    count: 2
    min: {position_m: [0, -1, 1.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [0, 1, 2], rpy_deg: [0, 0, 0]}
requirements:
  - {name: a, ITEM}
"""
VEHICLE = "vehicle: {boxes: [{name: body, center_m: [0, 0, 0.7], size_m: [2, 1, 1.4]}]}"
CHILD = "object: child, returns: 10"


def study(folder, item, vehicle=VEHICLE):
    path = folder / "study.yaml"
    path.write_text(STUDY.replace("VEHICLE", vehicle).replace("ITEM", item))
    return path


@pytest.mark.parametrize(
    ("item", "said"),
    [
        (
            "object: horse, within_m: [1, 2], returns: 1",
            "requirements[0].object: no object is called 'horse'; allowed: car,",
        ),
        (f"{CHILD}, within_m: [2, 1]", "requirements[0].within_m[1]: 1 is not above 2"),
        (
            f"{CHILD}, region: {{min_m: [2, 0, 0], max_m: [2.1, 0.1, 3]}}",
            "requirements[0].region: the object fits nowhere",
        ),
        (
            f"{CHILD}, region: {{min_m: [2, 0, 0], max_m: [4, 2, 1]}}",
            "requirements[0].region: the object, on the ground, re",
        ),
        (
            f"{CHILD}, region: {{min_m: [-0.9, -0.4, 0], max_m: [0.9, 0.4, 3]}}",
            "requirements[0].region: the object fits now",
        ),
        ("object: child, returns: 0, within_m: [1, 2]", "requirements[0].returns: 0 is too small; allowed: at least 1"),
        (f"{CHILD}, within_m: [1, 2], at_least: 1.5", "requirements[0].at_least: 1.5 is too large; allowed: at most 1"),
        (f"{CHILD}", "requirements[0]: missing; give within_m or region"),
        ("object: child, within_m: [1, 2]", "requirements[0].returns: missing"),
        (
            f"{CHILD}, within_m: [1, 2], height_m: [0, 1]",
            "requirements[0].height_m: does not go with object; it goes with",
        ),
        (f"{CHILD}, within_m: [1, 2], sector_deg: [45, -45]", "requirements[0].sector_deg[1]: -45 is not above 45"),
        (
            f"{CHILD}, within_m: [1, 2], lost: 2",
            "requirements[0].lost: 2 of 2 sensors lost leave none; allowed: at most 1",
        ),
        ("price_at_most: 100", "requirements[0].price_at_most: needs the study's prices, and there are none"),
        ("price_at_most: 100, object: child", "requirements[0].price_at_most: conflicts with object; make it a requir"),
        ("scenario: cpnco, speeds_km_h: [0]", "requirements[0].speeds_km_h[0]: 0 is too small; allowed: above 0"),
        (
            "scenario: cpnco, speeds_km_h: [1000]",
            "requirements[0].speeds_km_h[0]: 1000 is too large; allowed: at most 300",
        ),
        ("lost: 1", "requirements[0]: asks for nothing; give one of object, post_height_m"),
        ("post_height_m: 0.5", "requirements[0]: asks for nothing; give first_seen_at_most_m, gap_at_most_m, or both"),
        (f"{CHILD}, within: [1, 2]", "requirements[0].within: unknown key without a unit; allowed: within_m"),
        (f"{CHILD}, within_m: [1, 2], file: x.yaml", "requirements[0].name: conflicts with file"),
    ],
)
def test_one_line(item, said, tmp_path):
    path = study(tmp_path, item)
    done = lidarcfg("validate", path, code=2)
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(f"lidarcfg: {path}:9:")
    assert said in done.stderr


@pytest.mark.parametrize(
    ("item", "said"),
    [
        (
            f"{CHILD}, within_m: [1, 2]",
            "requirements[0].within_m: is the distance to the vehicle's body, and the study has",
        ),
        ("scenario: cpnco, speeds_km_h: [20]", "requirements[0].scenario: needs the vehicle's body"),
        ("post_height_m: 0.5, gap_at_most_m: 1", "requirements[0].post_height_m: needs the vehicle's body"),
        ("shadow_at_most_m3: 1", "requirements[0].shadow_at_most_m3: needs the vehicle's body"),
    ],
)
def test_without_a_vehicle(item, said, tmp_path):
    assert said in lidarcfg("validate", study(tmp_path, item, ""), code=2).stderr


RIG = """name: two
sensors:
  - {name: left, model: vlp-16, position_m: [0, 0.5, Z], rpy_deg: [0, 0, 0]}
  - {name: right, model: MODEL, position_m: [0, -0.5, 1.6], rpy_deg: [0, 0, 0]}
"""


def rig(folder, z="1.6", model="vlp-16"):
    path = folder / "rig.yaml"
    path.write_text(RIG.replace("Z", z).replace("MODEL", model))
    return path


def test_verify_needs_requirements(tmp_path):
    path = study(tmp_path, f"{CHILD}, within_m: [1, 2]")
    path.write_text(path.read_text().partition("requirements:")[0])
    assert "has no requirements" in lidarcfg("verify", path, rig(tmp_path), code=2).stderr


@pytest.mark.parametrize("command", ["validate", "optimize"])
def test_requirements_that_ask_for_nothing(command, tmp_path):
    """Without the key, max VSR is minimised: not what one wants who wrote it."""
    path = study(tmp_path, f"{CHILD}, within_m: [1, 2]")
    path.write_text(path.read_text().partition("requirements:")[0] + "requirements: []\n")
    said = lidarcfg(command, path, code=2).stderr
    assert said == f"lidarcfg: {path}:8:1: requirements: asks for nothing; give a requirement, or remove the key\n"


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        (f"requirements:\n  - {{name: a, {CHILD}, within_m: [1, 2]}}\n", ""),
        ("requirements:\n  - {name: a, sensors_at_most: 2}\nobjective: {max_vsr: 1}\n", ""),
        ("", "; or give the study objective: {max_vsr: 1}"),
    ],
)
def test_a_model_of_which_it_is_not_known_how_it_fires(text, hint, tmp_path):
    """The fans of the paper have beams and nothing else: validate says so as optimize does, also of one to choose."""
    path = study(tmp_path, "")
    said = f"sensor 'fan-4' has no codec, which would say where its lasers fire; add firing to its file{hint}\n"
    plain = path.read_text().partition("requirements:")[0]
    for model in ("model: fan-4", "choose: [vlp-16, fan-4]"):
        path.write_text(plain.replace("model: vlp-16", model) + text + "prices: {vlp-16: 1, fan-4: 1}\n")
        for command in ("validate", "optimize"):
            told = lidarcfg(command, path, code=2).stderr
            assert told.startswith(f"lidarcfg: {path}:4:5: sensors[0]: "), command
            assert told.endswith(said), command


def test_a_model_without_a_price(tmp_path):
    path = study(tmp_path, "price_at_most: 100")
    text = path.read_text()
    path.write_text(text + "prices: {os0-32: 50}\n")
    assert "'vlp-16' has no price; give it one in the study's prices" in lidarcfg("validate", path, code=2).stderr
    path.write_text(text + "prices: {vlp-16: 50}\n")
    assert lidarcfg("verify", path, rig(tmp_path)).stdout.count("PASS") == 2
    said = lidarcfg("verify", path, rig(tmp_path, model="os0-32"), code=2).stderr
    assert "right: 'os0-32' has no price, which 'a' needs; prices has vlp-16" in said


@pytest.mark.slow
def test_heights_and_radians_are_warned_of(tmp_path):
    path = study(tmp_path, "object: {size_m: [1, 1, 1]}, within_m: [2, 3], returns: 1, headings_deg: [0, 1.5708]")
    said = "headings_deg: 1.5708 looks like 90° in radians; give degrees"
    assert said in lidarcfg("validate", path).stderr
    assert said in lidarcfg("verify", path, rig(tmp_path)).stderr
    path = study(tmp_path, "sensors_at_most: 2")
    assert (
        "sensors[0].position_m[2]: left is 0.2 m below the ground"
        in lidarcfg("verify", path, rig(tmp_path, "-0.2")).stderr
    )
    assert "rig.yaml:3:" in (said := lidarcfg("verify", path, rig(tmp_path, "50")).stderr)
    assert "left is 49 m from the vehicle's body" in said


def test_a_file_of_requirements(tmp_path):
    shared = tmp_path / "shared.yaml"
    shared.write_text(
        "requirements:\n  - {name: few, sensors_at_most: 2}\n  - {name: a, object: child, within_m: [1, 2], returns: 3}\n"
    )
    assert "requirements: 2 requirements: few, a" in lidarcfg("validate", shared).stdout
    path = study(tmp_path, "sensors_at_most: 3")
    path.write_text(path.read_text().replace("{name: a, sensors_at_most: 3}", "shared.yaml"))
    assert "2 requirements" in lidarcfg("validate", path).stdout
    shared.write_text("requirements:\n  - {name: few, object: horse, within_m: [1, 2], returns: 3}\n")
    assert f"{shared}:2:" in lidarcfg("validate", path, code=2).stderr
    path.write_text(path.read_text().replace("shared.yaml", "absent.yaml"))
    assert "absent.yaml: no such file" in lidarcfg("validate", path, code=2).stderr
