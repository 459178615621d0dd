"""Scenarios as requirements: verdicts, mistakes in files, and drives whose files export the same returns."""

import numpy as np
import pytest

from lidarcfg.capture.export import in_time_order, simulated_packets
from lidarcfg.config.models import loads
from lidarcfg.errors import ConfigError
from lidarcfg.report.plots import save_figure
from lidarcfg.report.scenario import draw_scenario, save_drive
from lidarcfg.requirements.scenarios.requirement import ScenarioJudge
from lidarcfg.requirements.verify import Verifier
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.file import StudyFile
from lidarcfg.study.loading import load_study, study_of
from lidarcfg.units import SECOND_NS, START_NS
from lidarcfg.world.motion import Trajectory, load_path
from lidarcfg.world.scene import load_scene
from lidarcfg.world.vehicle import rig_vehicle

STUDY = """\
region: {min_m: [-30, -10, 0], max_m: [30, 10, 4], cuboid_m: [1, 0.5, 0.2]}
vehicle: {boxes: [{name: body, center_m: [0, 0, 0.75], size_m: [4.8, 1.9, 1.1]}]}
sensors:
  - name: bumper
    model: vlp-16
    count: 2
    min: {position_m: [2.45, -0.9, 0.5], rpy_deg: [0, 0, 0]}
    max: {position_m: [2.45, 0.9, 0.8], rpy_deg: [0, 0, 0]}
requirements:
  - {name: crossing, scenario: short.yaml, speeds_km_h: [50]}
"""
SHORT = """\
name: short
before_impact_s: 2.4
target: {size_m: [0.711, 0.298, 1.154]}
path: {crosses_from: right, speed_km_h: 5, start_m: 4, gain_m: 1}
cars:
  - {name: small, size_m: [4.316, 1.79, 1.48], beside_m: 1, before_m: 1}
"""
RIG = """\
name: two
sensors:
  - {name: left, model: vlp-16, position_m: [2.45, 0.9, 0.6]}
  - {name: right, model: vlp-16, position_m: [2.45, -0.9, 0.6]}
"""


@pytest.fixture
def files(tmp_path):
    for name, text in (("study", STUDY), ("short", SHORT), ("rig", RIG)):
        (tmp_path / f"{name}.yaml").write_text(text)
    return tmp_path


def judged(files, *changes):
    """The verdict on the rig after changes of the study's text."""
    text = STUDY
    for change in changes:
        text = text.replace(*change)
    (files / "study.yaml").write_text(text)
    study = load_study(files / "study.yaml")
    (found,) = Verifier(study.requirements).verify(load_rig(files / "rig.yaml").mounts).requirements
    return study.requirements.items[0], found


@pytest.mark.slow
def test_the_verdict_in_seconds(files):
    """The left sensor sees the child earlier: without it the margin is that of the right one alone."""
    both, found = judged(files)
    assert (found.kind, found.unit, found.at_most, found.lost) == ("scenario", "s", False, ())
    assert found.margin == found.reached > 0
    assert found.shortfall == 0
    assert found.passed
    lost, without = judged(files, ("[50]", "[50], lost: 1"))
    assert (without.lost, without.margin < found.margin) == (("left",), True)
    mounts = load_rig(files / "rig.yaml").mounts
    judge = ScenarioJudge(both)
    judge.judge(mounts)  # keeps its runs for the evidence, which are those of a rig that is run anew
    shown = judge.evidence(mounts, found).frames
    for one, other in zip(shown.cases[0].runs, both.result(mounts).cases[0].runs, strict=True):
        np.testing.assert_array_equal(one.returns, other.returns)
    alone = both.result(mounts[1:])
    assert without.margin == pytest.approx(alone.worst.worst.margin_s)
    assert ("left" in found.breaking) == (without.margin < 0)
    assert lost.result(mounts).worst.sight_margin_s >= alone.worst.sight_margin_s
    place = found.worst  # 50 km/h: 13.9 · 0.3 + 13.9² / 16 = 16.2 m ahead, 1.17 s or 1.62 m right of the middle
    assert (place.x_m, place.y_m, place.heading_deg) == (
        pytest.approx(2.4 + 16.2, abs=0.05),
        pytest.approx(-1.62, abs=0.02),
        90,
    )


@pytest.mark.slow
def test_what_no_rig_can_do(files):
    """Comfortably, the child comes into sight too late, from all places that are tried, which proves nothing; and nothing
    is said of it where a rig does it all the same.
    """
    (files / "short.yaml").write_text(SHORT.replace("2.4", "4.0"))
    _, found = judged(files, ("[50]", "[20], braking: comfort"))
    assert not found.passed
    late = "at 20 km/h that is too late for a frame before the last moment to brake"
    assert late in found.notes
    assert found.not_achievable is None
    assert 0 < found.shortfall < 1
    assert any(
        note.startswith("the last moment to brake at 20 km/h is 2.29 s and 12.7 m before") for note in found.notes
    )
    _, found = judged(files)
    assert late not in found.notes


@pytest.mark.slow
def test_more_is_demanded(files):
    """More returns, or of one cluster, come later; another target, smaller, too."""
    _, plain = judged(files)
    for more in ("returns: 60", "returns: 60, cluster_m: 0.15", "target: tyre", "braking: {reaction_s: 0.6}"):
        _, found = judged(files, ("[50]", f"[50], {more}"))
        assert found.margin < plain.margin, more


def test_a_studys_values_are_whole(files):
    """Its scenario's file is found from anywhere; a preset's name stays."""
    study = load_study(files / "study.yaml")
    (item,) = study.file["requirements"]
    assert item["scenario"] == str(files.resolve() / "short.yaml")
    (files / "study.yaml").write_text(STUDY.replace("short.yaml", "cpna"))
    assert load_study(files / "study.yaml").file["requirements"][0]["scenario"] == "cpna"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            ("short.yaml", "cpxy"),
            "study.yaml:10:22: requirements[0].scenario: no scenario is called 'cpxy'; allowed: ccrs",
        ),
        (("short.yaml", "none.yaml"), "none.yaml: no such file"),
        (("[50]", "[0]"), "speeds_km_h[0]: 0 is too small; allowed: above 0"),
        (("[50]", "[1000]"), "speeds_km_h[0]: 1000 is too large; allowed: at most 300"),
        ((", speeds_km_h: [50]", ""), "short: has no speeds of its own; give speeds_km_h"),
        (
            ("[50]", "[5], braking: {deceleration_m_s2: 0.2}"),
            "let it start earlier (before_impact_s, from_m), or brake",
        ),
        (("[50]", "[50], braking: sudden"), "braking: 'sudden' is not allowed; allowed: emergency, comfort, or keys"),
        (("[50]", "[50], target: giraffe"), "requirements[0].target: no object is called 'giraffe'; allowed: car"),
        (("[50]", "[50], target: {mesh: none.ply}"), "none.ply: no such file"),
        (("[50]", "[-50]"), "speeds_km_h[0]: -50 is too small; allowed: above 0"),
        (("[50]", "[]"), "speeds_km_h: has 0 values; allowed: at least 1"),
        (("speeds_km_h: [50]", "speeds_m_s: [14]"), "speeds_m_s: unknown key; did you mean speeds_km_h?"),
        (("[50]", "[50], returns: 0"), "returns: 0 is too small; allowed: at least 1"),
        (("[50]", "[50], lost: 2"), "2 of 2 sensors lost leave none"),
        (("[50]", "[50], within_m: [0, 1]"), "within_m: does not go with scenario"),
        (("vehicle:", "#"), "needs the vehicle's body, and the study has no vehicle; give one"),
    ],
)
def test_mistakes(files, wrong, said):
    with pytest.raises(ConfigError) as caught:
        study_of(loads(STUDY.replace(*wrong), StudyFile, str(files / "study.yaml")), files / "study.yaml")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["{size_m: [0.711, 0.298, 1.154]}", "child"])
def test_the_files_of_a_drive(files, target):
    """Exported from its files, the worst run has the same returns in each frame; the plot shows all cases."""
    (files / "short.yaml").write_text(SHORT.replace("{size_m: [0.711, 0.298, 1.154]}", target))
    item, _ = judged(files)
    mounts = load_rig(files / "rig.yaml").mounts
    found = item.result(mounts)
    run = found.worst.worst
    written = save_drive(run, mounts, item.vehicle, files / "drive")
    assert (written.detected_s, written.last_s) == (run.detected_s, run.last_s)
    rig = load_rig(written.rig)
    scene = load_scene(written.scene)
    motion = Trajectory(np.eye(4), load_path(written.trajectory), START_NS)
    records = []
    streams = simulated_packets(
        rig, scene, motion, 23 * SECOND_NS // 10, on_truth=records.append, vehicle=rig_vehicle(rig)
    )
    for _ in in_time_order(streams):
        pass
    truth = np.concatenate(records)
    number = (truth["time_ns"][truth["object"] == scene.names.index("target")] - START_NS) // (SECOND_NS // 10)
    counts = np.bincount(number, minlength=23)
    np.testing.assert_array_equal(run.returns[:22], counts[:22])
    assert counts.sum() > 100
    figure = draw_scenario(found)
    assert len(figure.axes) == len(found.cases) == 1
    (line,) = (line for line in figure.axes[0].lines if line.get_label() == "detected")
    assert run.approach.lead_s - line.get_xdata()[0] == pytest.approx(run.detected_s)
    save_figure(figure, files / "plot.png")
    assert {"1", "10", "100"} <= {label.get_text() for label in figure.axes[0].get_yticklabels()}
