"""Sensors on a surface of the body: moved on the page they stay on it, as plain loops over the body's triangles find it."""

import json
from pathlib import Path

import numpy as np
import pytest

from lidarcfg.geometry import rotation
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.viewer.contents import load_contents
from lidarcfg.viewer.evaluation import with_poses
from lidarcfg.viewer.mounting import slide, surface_mounts
from tests.capture_fixtures import no_warning
from tests.naive import surfaces as naive
from tests.viewer.driver import asked, click, drag, in_browser, opened, poses_of, put, serving, settled, shown_vsr, told

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
STANDOFF_M = 0.1
RADIUS_M = 0.103 / 2
STEP_M = 0.01
ROOF = [-1.1, -0.65, 1.3], [0.2, 0.65, 1.6]
FENDER = [1.65, 0.7, 0.4], [2.15, 1.0, 0.75]
STUDY = f"""
region: {{min_m: [-8, -5, 0], max_m: [8, 5, 3], cuboid_m: [0.5, 0.5, 0.25]}}
vehicle:
  meshes: [{{name: body, file: {ROOT / "data/vehicles/sedan.ply"}, exclude: true}}]
sensors:
  - name: free
    model: vlp-16
    min: {{position_m: [-1, -1, 1.7], rpy_deg: [0, 0, 0]}}
    max: {{position_m: [1, 1, 2.0], rpy_deg: [0, 0, 0]}}
  - name: roof
    model: vlp-16
    on: {{body: body, from: above, within: {{min_m: {ROOF[0]}, max_m: {ROOF[1]}}}, standoff_m: 0.1, upright: false}}
    yaw_deg: [-180, 180]
  - name: fender
    model: vlp-16
    count: 2
    mirror_y_m: 0
    on: {{body: body, from: left, within: {{min_m: {FENDER[0]}, max_m: {FENDER[1]}}}, standoff_m: 0.1}}
    roll_deg: [-15, 15]
"""
SIDE = {1: ("above", ROOF), 2: ("left", FENDER), 3: ("right", ([1.65, -1.0, 0.4], [2.15, -0.7, 0.75]))}


@pytest.fixture(scope="module")
def contents(tmp_path_factory):
    """A study of a free sensor, one along the normal of the roof, and a mirrored pair on the fenders; and its rig."""
    folder = tmp_path_factory.mktemp("seats")
    (folder / "study.yaml").write_text(STUDY)
    alone = load_contents([folder / "study.yaml"], None, None, np.eye(4), no_warning)
    save_rig(alone.rigs[0], folder / "rig.yaml")
    return load_contents([folder / "study.yaml", folder / "rig.yaml"], None, None, np.eye(4), no_warning)


def sits(contents, poses, number):
    """Whether the base is on the body's triangles to 1e-6 m and fits, and the axis is the surface's; by plain loops."""
    mesh = contents.study.vehicle.scene
    triangles = mesh.mesh()[0][mesh.mesh()[1]]
    side, within = SIDE[number]
    axis = rotation(poses[number, 3:])[:, 2]
    out = np.array(naive.OUT[side], float)
    base = poses[number, :3] - STANDOFF_M * (axis if number == 1 else out)
    low, high = (np.array(corner) for corner in within)
    owner = np.zeros(len(triangles), int)
    found = naive.sits(triangles, owner, 0, side, base, RADIUS_M, STEP_M + 1e-9, low - 1e-6, high + 1e-6, number != 1)
    assert found is not None
    assert np.linalg.norm(found[0] - base) <= 1e-6
    if number == 1:
        assert axis == pytest.approx(found[1], abs=1e-6)
    else:
        roll, pitch, _ = np.degrees(poses[number, 3:])
        assert abs(roll) <= 15 + 1e-9
        assert pitch == 0
    return True


def test_moves_stay_on_the_surface(contents):
    """Anywhere: within, over the edge, far away, tilted; and a rig whose sensor floats is put back."""
    study = contents.study
    start = poses_of(contents.rigs[0])
    assert surface_mounts(study, contents.rigs[0]) == [1, 2, 3]
    rng = np.random.default_rng(1)
    poses = start
    for trial in range(12):
        number = 1 + trial % 3
        wanted = poses[number] + rng.normal(0, (0.3, 0.3, 0.3, 0.3, 0.3, 1.0)) * (1 + 9 * (trial >= 9))
        after = slide(study, poses, number, wanted, mirrors=trial % 2 == 0)
        assert (np.delete(after, [number, *((2, 3) if number > 1 else ())], axis=0)
                == np.delete(poses, [number, *((2, 3) if number > 1 else ())], axis=0)).all()  # fmt: skip
        assert all(sits(contents, after, i) for i in ((1,), (2, 3))[number > 1])
        poses = after
    exact = start.copy()
    exact[1, 0] = start[1, 0] - 0.05
    assert slide(study, start, 1, exact[1], True)[1, 0] == pytest.approx(exact[1, 0], abs=1e-5)  # as far as was asked
    floating = start + 0.5
    assert sits(contents, slide(study, floating, 1, floating[1] + 0.01, True), 1)
    tilted = slide(study, start, 2, start[2] + [0, 0, 0, np.radians(40), 0.2, 0.3], True)
    assert np.degrees(tilted[2:, 3]) == pytest.approx([15, -15])
    assert tilted[2:, 5] == pytest.approx([start[2, 5] + 0.3, -start[2, 5] - 0.3])


def test_a_server_refuses_what_is_no_move(contents):
    poses = poses_of(contents.rigs[0]).tolist()
    good = {"poses": poses, "mount": 1, "pose": poses[1], "mirrors": True}
    with serving(contents) as url:
        assert asked(url, "POST", "/place", json.dumps(good))[0] == 200
        for wrong, said in (
            ({"mount": 0}, "mount: allowed is one that sits on a surface: 1, 2, 3"),
            ({"mount": True}, "mount: allowed is one that sits on a surface: 1, 2, 3"),
            ({"mount": [1]}, "mount: allowed is one that sits on a surface: 1, 2, 3"),
            ({"pose": poses}, "pose: allowed are x, y, z, roll, pitch, yaw in metres and radians"),
            ({"pose": [*poses[1][:5], 1e99]}, "pose: allowed are x, y, z, roll, pitch, yaw in metres and radians"),
            ({"mirrors": 1}, "mirrors: allowed is true or false"),
        ):
            status, text = asked(url, "POST", "/place", json.dumps(good | wrong))
            assert (status, text.decode()) == (400, f"{said}\n")


@in_browser
def test_a_sensor_stays_on_its_surface_in_the_page(chromium, contents):
    """Dragged off the roof, typed beyond the fender: it stays on; undone, redone and saved, and the study is as it was."""

    def poses():
        settled(chromium)
        found = np.array(chromium.execute_script("return lidarcfg.handles.poses"))
        assert shown_vsr(chromium) == evaluate(contents.study, with_poses(contents.rigs[0], found)).max_vsr_m
        return found

    study_file = contents.source.path.parent / "study.yaml"
    with serving(contents) as url:
        opened(chromium, url)
        put(chromium, "#mount", 2, "change")
        put(chromium, "#pose-x", 1.9)
        put(chromium, "#pose-y", 2.5)  # beside the car
        put(chromium, "#pose-roll", 40)
        typed = poses()
        assert all(sits(contents, typed, i) for i in (2, 3))
        assert typed[2, 0] == pytest.approx(1.9, abs=1e-12)
        for key, value in (("x", 1.95), ("z", 0.6)):  # the second before the first is answered
            put(chromium, f"#pose-{key}", value)
        assert poses()[2, [0, 2]] == pytest.approx([1.95, 0.6], abs=1e-12)
        click(chromium, "#undo")
        click(chromium, "#undo")
        assert (poses() == typed).all()
        assert np.degrees(typed[2:, 3]) == pytest.approx([15, -15])
        put(chromium, "#pose-x", 5)  # ahead of the car
        edge = poses()
        assert all(sits(contents, edge, i) for i in (2, 3))
        assert 1.9 < edge[2, 0] < 2.15 + 1e-6
        put(chromium, "#pose-x", 5, "change")  # the field is left
        assert float(chromium.execute_script("return document.getElementById('pose-x').value")) == pytest.approx(
            edge[2, 0], abs=1e-4
        )

        put(chromium, "#mount", 1, "change")
        drag(chromium, edge[1, :3], 1, 3.0)  # off the roof
        dragged = poses()
        assert sits(contents, dragged, 1)
        assert abs(dragged[1, 1] - edge[1, 1]) > 0.2
        assert chromium.find_element("id", "violations").text == ""

        for _ in range(2):
            click(chromium, "#undo")
        assert (poses() == typed).all()
        for _ in range(2):
            click(chromium, "#redo")
        assert (poses() == dragged).all()
        click(chromium, "#save")
        click(chromium, "#ask-yes")
        told(chromium, f"saved {contents.source.path}")
        assert poses_of(load_rig(contents.source.path)) == pytest.approx(dragged, abs=1e-12)
        assert study_file.read_text() == STUDY
