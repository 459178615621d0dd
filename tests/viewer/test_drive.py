"""A recorded drive: points, vehicle and objects at every time, against an arc by hand and the surfaces that were hit."""

from itertools import pairwise
from math import cos, radians, sin

import numpy as np
import pytest
import yaml

from lidarcfg.capture.manifest import DriveInputs, parse_time_ns
from lidarcfg.capture.selection import ALL
from lidarcfg.geometry import pose, transform
from lidarcfg.viewer.contents import complete_inputs, load_contents
from lidarcfg.viewer.page import page_of, save_html
from lidarcfg.viewer.timeline import mesh_at, parts, timeline, tracks
from tests.capture_fixtures import no_warning
from tests.command_line import lidarcfg
from tests.viewer.driver import click, different, in_browser, on_screen, opened, picture, put, serving, settled

SPEED = 12.0
RATE_DEG = 40.0
AT = (1.0, 2.0, 20.0)
START_NS = parse_time_ns("2026-05-01T10:00:00")
VAN = {"name": "van", "center_m": [16, 3, 1.5], "size_m": [5, 2, 3], "reflectivity": 60}
SCENE = {
    "name": "yard",
    "ground": {"reflectivity": 20},
    "boxes": [
        {"name": "house", "center_m": [8, 19, 4], "size_m": [20, 6, 8], "reflectivity": 40},
        VAN | {"motion": {"velocity_m_s": [9, 0, 0]}},
    ],
    "spheres": [
        {
            "name": "sun",
            "center_m": [9, -3, 1.5],
            "radius_m": 1,
            "reflectivity": 60,
            "motion": {"velocity_m_s": [0, -4, 0]},
        }
    ],
}
RIG = {
    "name": "top",
    "sensors": [{"name": "a", "model": "vlp-16", "position_m": [0.5, 0, 2], "rpy_deg": [4, -3, 30]}],
    "vehicle": {"boxes": [{"name": "cab", "center_m": [0, 0, 0.6], "size_m": [3, 1.5, 1.2]}]},
}


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """A capture of 0.4 s in a tight curve, past a van and a sphere that move, and what its export noted."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "yard.yaml").write_text(yaml.safe_dump(SCENE))
    (folder / "top.yaml").write_text(yaml.safe_dump(RIG))
    (folder / "arc.yaml").write_text(f"arc: {{speed_m_s: {SPEED}, yaw_rate_deg_s: {RATE_DEG}}}\n")
    words = ("--scene", "yard.yaml", "--trajectory", "arc.yaml", "--at", ",".join(map(str, AT)), "--duration", 0.4)
    lidarcfg("export", "top.yaml", *words, "--start", "2026-05-01T10:00:00", "-o", "drive.pcap", "--quiet", cwd=folder)
    return folder


@pytest.fixture(scope="module")
def contents(here):
    """The capture alone is named; all else is noted beside it."""
    paths, known = complete_inputs([here / "drive.pcap"], DriveInputs(), pytest.fail)
    drive = known.motion()
    return load_contents(paths, known.rig, None, drive, no_warning, ALL, known.vehicle)


def arc(seconds):
    """Where a vehicle is on the arc: x, y and heading in the frame in which it starts."""
    rate = radians(RATE_DEG)
    return SPEED / rate * sin(rate * seconds), SPEED / rate * (1 - cos(rate * seconds)), rate * seconds


def on_arc(seconds):
    """T_world_vehicle (4, 4)."""
    x, y, heading = arc(seconds)
    return pose((AT[0], AT[1], 0), (0, 0, radians(AT[2]))) @ pose((x, y, 0), (0, 0, heading))


def outside(points, center, size):
    """How far points are from the surface of a box, as seen from outside."""
    return np.linalg.norm(np.maximum(abs(points - center) - np.array(size) / 2, 0), axis=1)


def test_all_points_lie_where_they_were_hit(contents):
    """In the world, each on the ground, on the house, or on van and sphere where these were at the point's time."""
    world = transform(contents.T_world_vehicle, contents.cloud.xyz)
    seconds = (contents.cloud.time_ns - START_NS) / 1e9
    house, van = SCENE["boxes"]
    moved = np.column_stack([9 * seconds, 0 * seconds, 0 * seconds])
    fallen = np.column_stack([0 * seconds, -4 * seconds, 0 * seconds])
    (sun,) = SCENE["spheres"]
    away = {
        "ground": abs(world[:, 2]),
        "house": outside(world, house["center_m"], house["size_m"]),
        "van": outside(world - moved, van["center_m"], van["size_m"]),
        "sun": abs(np.linalg.norm(world - fallen - sun["center_m"], axis=1) - 1),
    }
    nearest = np.stack(list(away.values()))
    assert nearest.min(axis=0).max() < 0.01
    assert (np.bincount(nearest.argmin(axis=0), minlength=4) > 100).all()


def test_far_from_the_origin_nothing_is_lost(here, contents):
    """At UTM coordinates points and sensors are the same, bit for bit: the page's frame is the vehicle's."""
    paths, known = complete_inputs([here / "drive.pcap"], DriveInputs(at="450000,5400000,20"), pytest.fail)
    drive = known.motion()
    far = load_contents(paths[:1], known.rig, None, drive, no_warning)
    assert (far.cloud.xyz == contents.cloud.xyz).all()
    assert far.T_world_vehicle[:2, 3] - contents.T_world_vehicle[:2, 3] == pytest.approx([449999, 5399998], abs=1e-8)
    assert tracks(far, timeline(far))[0] == pytest.approx(tracks(contents, timeline(contents))[0], abs=1e-8)


def test_the_frames_have_the_vehicle_and_the_objects_where_they_are(contents):
    """At the middle of each frame of 100 ms: on the arc, and where constant velocities lead."""
    line = timeline(contents)
    assert line.frames.tolist() == [0, 1, 2, 3]
    first = (contents.first_ns - START_NS) / 1e9
    found = tracks(contents, line)
    assert found.shape == (3, 4, 7)
    to_page = np.linalg.inv(on_arc(first))
    for k in range(4):
        seconds = first + 0.1 * k + 0.05
        wanted = to_page @ on_arc(seconds)
        assert found[0, k, :3] == pytest.approx(wanted[:3, 3], abs=2e-5)
        turn = np.arctan2(wanted[1, 0], wanted[0, 0])
        assert found[0, k, 3:] == pytest.approx((0, 0, sin(turn / 2), cos(turn / 2)), abs=2e-6)
        for track, place, velocity in ((1, VAN["center_m"], (9, 0, 0)), (2, (9, -3, 1.5), (0, -4, 0))):
            there = to_page @ [*(np.array(place) + np.array(velocity) * seconds), 1]
            assert found[track, k, :3] == pytest.approx(there[:3], abs=2e-5)


def test_parts_of_a_scene_make_the_whole(contents):
    """At time 0 they are the scene's own mesh; later each is moved as one."""
    (scene,) = contents.scenes
    assert [bool(part.path) for part in parts(scene)] == [False, True, True]
    now = mesh_at(scene, 0)[0]
    later = mesh_at(scene, 500_000_000)[0]
    whole = scene.mesh()[0]
    assert np.sort(now, axis=0) == pytest.approx(np.sort(whole, axis=0))
    shift = np.unique(np.round(later - now, 9), axis=0)
    assert shift.tolist() == [[0, -2, 0], [0, 0, 0], [4.5, 0, 0]]


@pytest.mark.slow
@in_browser
def test_the_page_shows_one_time(chromium, contents, tmp_path):
    """The vehicle's sensor is on the arc in each frame; the camera follows; scans accumulate; the whole is deskewed."""
    mount = np.array([0.5, 0, 2])
    first = (contents.first_ns - START_NS) / 1e9
    to_page = np.linalg.inv(on_arc(first))
    there = "const m = lidarcfg.stage.vehicle.children.find((o) => o.children.length === 3); return m.getWorldPosition(m.position.clone()).toArray()"
    shown = "const { time } = lidarcfg.cloud.arrays; const { first, last } = lidarcfg.cloud; return time.filter((t) => t >= first && t <= last).length"
    with serving(contents) as url:
        opened(chromium, url)
        assert chromium.execute_script(shown) == len(contents.cloud.xyz)
        assert "whole recording, deskewed" in chromium.find_element("id", "panel").text
        pictures = []
        for k in range(4):
            put(chromium, "#time", k)
            at = to_page @ on_arc(first + 0.1 * k + 0.05) @ [*mount, 1]
            assert chromium.execute_script(there) == pytest.approx(at[:3], abs=1e-4)
            pictures.append(picture(chromium))
        assert min(different(one, other) for one, other in pairwise(pictures)) > 200
        click(chromium, "#follow")
        before = on_screen(chromium, at[:3])
        put(chromium, "#time", 0)
        settled(chromium)
        at = to_page @ on_arc(first + 0.05) @ [*mount, 1]
        assert on_screen(chromium, at[:3]) == pytest.approx(before, abs=1)
        put(chromium, "#time", 2)
        put(chromium, "#joined", 2, "change")
        us = (contents.cloud.time_ns - contents.cloud.time_ns.min()) // 1000
        assert chromium.execute_script(shown) == ((us >= 100_000) & (us < 300_000)).sum()
        chromium.find_element("tag name", "body").send_keys("w")
        settled(chromium)
        assert chromium.execute_script(shown) == len(contents.cloud.xyz)
    save_html(page_of(contents), tmp_path / "p.html")  # and so does a file of its own
    opened(chromium, (tmp_path / "p.html").as_uri())
    put(chromium, "#time", 3)
    settled(chromium)
    assert chromium.execute_script(there) == pytest.approx((to_page @ on_arc(first + 0.35) @ [*mount, 1])[:3], abs=1e-4)


def test_a_drive_without_a_capture(here):
    """Rig, scene and trajectory alone have a timeline, too: of ten seconds, or of the timed poses."""
    drive = DriveInputs(trajectory=here / "arc.yaml").motion()
    staged = load_contents([here / "top.yaml", here / "yard.yaml"], None, None, drive, no_warning)
    line = timeline(staged)
    assert (len(line.frames), line.frame) == (100, 100_000)
    assert tracks(staged, line)[0, 50, :2] == pytest.approx(arc(5.05)[:2], abs=1e-6)
    (here / "p.tum").write_text("2 0 0 0 0 0 0 1\n2.45 4.5 0 0 0 0 0 1\n")
    staged = load_contents([here / "top.yaml"], None, None, DriveInputs(trajectory=here / "p.tum").motion(), no_warning)
    line = timeline(staged)
    assert tracks(staged, line)[0, :, 0] == pytest.approx([0.5, 1.5, 2.5, 3.5, 4.5], abs=1e-6)
    (here / "p.tum").write_text("0 0 0 0 0 0 0 1\n1e9 4.5 0 0 0 0 0 1\n")
    staged = load_contents([here / "top.yaml"], None, None, DriveInputs(trajectory=here / "p.tum").motion(), no_warning)
    assert len(timeline(staged).frames) == 36_000
    assert tracks(staged, timeline(staged))[0, -1, 0] == pytest.approx(4.5 * (1 - 0.5 / 36_000))
    assert timeline(load_contents([here / "top.yaml"], None, None, np.eye(4), no_warning)) is None


def test_a_start_of_nothing(here):
    told = lidarcfg("view", "top.yaml", "--start", "2026-01-01", "--html", "no.html", code=2, cwd=here).stderr
    assert "--start is the time at which a --trajectory or a scene's motion starts; there is neither" in told


def test_what_is_noted_may_be_said_otherwise(here):
    """--at moves the whole drive; a manifest's file that has changed is a warning, and is missing."""
    done = lidarcfg("view", "drive.pcap", "--html", "p.html", cwd=here)
    assert done.stderr == ""
    motion = (here / "arc.yaml").read_text()
    try:
        (here / "arc.yaml").write_text(motion + "# another\n")
        told = lidarcfg("view", "drive.pcap", "--html", "p.html", cwd=here).stderr
        assert "arc.yaml has changed since the export; name what fits it: --trajectory; it is not shown" in told
        assert told.count("\n") == 1
        assert not lidarcfg("view", "drive.pcap", "--trajectory", "arc.yaml", "--html", "p.html", cwd=here).stderr
    finally:
        (here / "arc.yaml").write_text(motion)
    top = (here / "top.yaml").read_text()
    try:  # without the rig points stay in their sensors' frames, and are not deskewed
        (here / "top.yaml").write_text(top + "# another\n")
        told = []
        _, known = complete_inputs([here / "drive.pcap"], DriveInputs(), told.append)
        assert (len(told), known.rig, known.trajectory) == (1, None, None)
        _, known = complete_inputs([here / "drive.pcap", here / "top.yaml"], DriveInputs(), pytest.fail)
        assert known.trajectory.name == "arc.yaml"
    finally:
        (here / "top.yaml").write_text(top)
    paths, known = complete_inputs([here / "drive.pcap"], DriveInputs(at="5,6,7"), pytest.fail)
    assert (known.at, known.rig.name, [path.name for path in paths]) == (
        "5,6,7",
        "top.yaml",
        ["drive.pcap", "yard.yaml"],
    )
    other = (here / "drive.pcap.yaml").read_text().replace("at: 1.0,2.0,20.0", "at: 0,0,0")
    (here / "b.pcap").write_bytes((here / "drive.pcap").read_bytes())
    (here / "b.pcap.yaml").write_text(other)
    told = lidarcfg("view", "drive.pcap", "b.pcap", "--html", "no.html", code=2, cwd=here).stderr
    assert "b.pcap.yaml: is of another at than drive.pcap.yaml; choose one with --at" in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--trajectory", "none.yaml"), "none.yaml: no such file"),
        (("--trajectory", "top.yaml"), "top.yaml:1:1: this is a rig; a trajectory belongs here"),
        (("--trajectory", "short.yaml"), "a pose is needed at"),
        (("--start", "noon"), "'noon' is not a time such as 2026-01-01T00:00:00"),
        (("--start", "2026-04-01T00:00:00"), "s after the trajectory's start; allowed: at most 86400 s after it; give its start with --start"),
        (("--start", "2026-05-01T10:00:05"), "s before the trajectory's start; allowed: at most"),
        ((), "bare.pcap: deskewing needs the rig that recorded it; give it with --rig"),
        (("--at", "1,2"), "'1,2' is not three numbers X,Y,YAW_DEG"),
    ],
)  # fmt: skip
def test_mistakes(here, words, message):
    (here / "bare.pcap").write_bytes((here / "drive.pcap").read_bytes())
    (here / "short.yaml").write_text(
        "poses: [{time_s: 0, position_m: [0, 0, 0]}, {time_s: 0.1, position_m: [1, 0, 0]}]\n"
    )
    capture = "drive.pcap" if words else "bare.pcap"
    done = lidarcfg("view", capture, *(words or ("--trajectory", "arc.yaml")), "--html", "bad.html", code=2, cwd=here)
    assert message in done.stderr
    assert done.stderr.strip().count("\n") == 0
    assert not (here / "bad.html").exists()
