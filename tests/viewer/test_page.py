"""The page in a real browser, its server and the data of both, against evaluate, numpy and plain loops."""

import base64
import hashlib
import json
import re
import signal
import sys
import time
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from lidarcfg.capture.ground_truth import Objects
from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import ConfigError
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.viewer.camera import Camera
from lidarcfg.viewer.contents import Contents, load_contents
from lidarcfg.viewer.evaluation import with_poses
from lidarcfg.viewer.page import ASSETS, MODULES, page_of, save_html
from lidarcfg.viewer.server import Server
from tests.chromium import asked_for, browser, complaints
from tests.command_line import started
from tests.viewer.driver import (
    NIGHT,
    asked,
    click,
    different,
    drag,
    in_browser,
    on_screen,
    opened,
    picture,
    put,
    serving,
    settled,
    shown_vsr,
)

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "data/studies/sedan.yaml"
ROOF = ROOT / "data/rigs/roof.yaml"
THREE = "5435a9cdb8214b51fd9d402f7f227ba5f712559b8a4347275e4fa18503f0f10c"  # of vendor/three.js, by tools/bundle_three


@pytest.fixture(scope="module")
def contents():
    """A rig, its study, and 30,000 points on a wall and the ground, in three frames, seen by both sensors."""
    rng = np.random.default_rng(1)
    count = 30_000
    xyz = rng.uniform((-12, -8, 0), (12, 8, 0), (count, 3))
    wall = np.arange(count) % 2 == 0
    xyz[wall, 1] = 8.0
    xyz[wall, 2] = rng.uniform(0, 3, wall.sum())
    cloud = PointCloud(
        xyz=xyz,
        intensity=rng.integers(0, 200, count).astype(np.uint8),
        ring=rng.integers(0, 16, count).astype(np.uint8),
        time_ns=1_767_225_600 * 10**9 + rng.integers(0, 300_000_000, count),
        sensor=(np.arange(count) % 3 == 0).astype(np.uint16),
        sensor_names=("left", "right"),
        return_type=np.zeros(count, np.uint8),
    )
    return Contents(cloud, None, (load_rig(ROOF),), load_study(STUDY), (), np.eye(4))


@pytest.fixture(scope="module")
def served(contents):
    """The address of the page."""
    with serving(contents) as url:
        yield url


@in_browser
def test_the_served_page_asks_its_own_server_alone(chromium, served):
    opened(chromium, served)
    asked = asked_for(chromium)
    assert {url.removeprefix(served) for url in asked} >= {"", "about.json", "array/position", "page/vendor/three.js"}
    assert all(url.startswith(served) for url in asked), asked
    assert complaints(chromium) == []
    image = picture(chromium)
    assert (abs(image - NIGHT).max(axis=-1) > 24).mean() > 0.05


@in_browser
def test_a_standalone_file_asks_nothing_and_shows_the_same(chromium, served, contents, tmp_path):
    save_html(page_of(contents), tmp_path / "p.html")
    url = (tmp_path / "p.html").as_uri()
    opened(chromium, url)
    assert asked_for(chromium) == [url]
    assert complaints(chromium) == []
    alone = picture(chromium)
    click(chromium, "#sensor-0")
    assert different(picture(chromium), alone) > 2000
    assert not chromium.execute_script("return document.getElementById('mount')")  # no server, no handles
    opened(chromium, served)
    assert different(picture(chromium), alone) < 100


MODES = ("sensor", "intensity", "ring", "height", "time", "object")


@pytest.fixture(scope="module")
def scattered():
    """4,000 points at every distance, far from the origin, of three sensors and four objects."""
    rng = np.random.default_rng(7)
    count = 4000
    xyz = np.array([4.5e5, 5.4e6, 300.0]) + rng.normal(0, 1, (count, 3)) * rng.choice([2, 10, 40], (count, 1))
    cloud = PointCloud(
        xyz=xyz,
        intensity=rng.integers(0, 256, count).astype(np.uint8),
        ring=rng.integers(0, 128, count).astype(np.uint8),
        time_ns=rng.integers(0, 500_000_000, count),
        sensor=rng.integers(0, 3, count).astype(np.uint16),
        sensor_names=("a", "b", "c"),
        return_type=np.zeros(count, np.uint8),
    )
    objects = Objects(("car", "wall", "sign", "other"), rng.integers(0, 4, count).astype(np.uint16))
    camera = Camera(np.array([4.5e5 - 60, 5.4e6 + 10, 320.0]), np.array([4.5e5, 5.4e6, 300.0]))
    return page_of(Contents(cloud, objects, (), None, (), np.eye(4)), camera=camera)


@in_browser
def test_the_gpu_draws_what_the_rasteriser_draws(chromium, scattered, tmp_path):
    """Pixel by pixel, but where rounding puts a point into the next pixel: by colour, slice in time, sensor and size."""
    save_html(scattered, tmp_path / "p.html")
    pictures = {}
    for points in ("cpu", "gpu"):
        opened(chromium, f"{(tmp_path / 'p.html').as_uri()}?points={points}")
        assert chromium.execute_script("return Boolean(lidarcfg.cloud.object.isPoints)") == (points == "gpu")
        seen = pictures[points] = {}
        for mode in MODES:
            put(chromium, "#colour", mode, "change")
            seen[mode] = picture(chromium)
        put(chromium, "#size", 5)
        seen["large"] = picture(chromium)
        put(chromium, "#time", 2)
        seen["frame"] = picture(chromium)
        click(chromium, "#whole")
        click(chromium, "#sensor-1")
        seen["without b"] = picture(chromium)
        x, y = chromium.execute_script("return [lidarcfg.stage.size.x / 2, lidarcfg.stage.size.y / 2]")
        seen["picked"] = chromium.execute_script("return lidarcfg.cloud.pick(arguments[0], arguments[1])", x, y)
        assert complaints(chromium) == []
    for name, image in pictures["cpu"].items():
        other = pictures["gpu"][name]
        if name == "picked":
            assert image is not None
            assert image == other
            continue
        drawn = int((abs(image - NIGHT).max(axis=-1) > 24).sum())
        assert drawn > 2000, name
        assert different(image, other) < 0.02 * drawn, name
    images = list(pictures["gpu"].items())[:-1]
    for i, (name, image) in enumerate(images):  # and each control changes what the GPU draws
        for _, other in images[:i]:
            assert different(image, other) > 500, name


@in_browser
def test_a_gpu_draws_points(chromium, scattered, tmp_path):
    """The browser's own renderer is SwiftShader; under a graphics card's name it draws as a card would."""
    save_html(scattered, tmp_path / "p.html")
    code = (
        "const own = WebGL2RenderingContext.prototype.getParameter;"
        "WebGL2RenderingContext.prototype.getParameter = function (name) {"
        "return name === 0x9246 ? 'ANGLE (NVIDIA, NVIDIA GeForce RTX 3060, OpenGL 4.5)' : own.call(this, name) };"
    )
    drawn = "return [lidarcfg.stage.hasGpu, Boolean(lidarcfg.cloud.object.isPoints)]"
    opened(chromium, (tmp_path / "p.html").as_uri())
    assert chromium.execute_script(drawn) == [False, False]
    script = chromium.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": code})
    try:
        opened(chromium, (tmp_path / "p.html").as_uri())
    finally:
        chromium.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)
    assert chromium.execute_script(drawn) == [True, True]
    assert (abs(picture(chromium) - NIGHT).max(axis=-1) > 24).sum() > 2000


@in_browser
@pytest.mark.parametrize("unmasked", [True, False])
def test_renderers_by_name(chromium, served, unmasked):
    """As Chromium, Firefox and Safari call them, with or without the extension for it."""
    opened(chromium, served)
    code = (
        "const [name, unmasked, done] = arguments; import('lidarcfg/stage').then(({ gpuDraws }) => done(gpuDraws({"
        "RENDERER: 7937, getExtension: () => unmasked ? { UNMASKED_RENDERER_WEBGL: 0x9246 } : null,"
        "getParameter: (asked) => asked === (unmasked ? 0x9246 : 7937) ? name : 'none' })))"
    )
    for name, gpu in (
        ("ANGLE (Intel, Mesa Intel(R) UHD Graphics 620 (KBL GT2), OpenGL 4.6)", True),
        ("Apple M2", True),
        ("AMD Radeon RX 6700 XT (radeonsi, navi22, LLVM 15.0.7)", True),
        ("ANGLE (Google, Vulkan 1.3.0 (SwiftShader Device (Subzero) (0x0000C0DE)), SwiftShader driver)", False),
        ("ANGLE (Mesa, llvmpipe (LLVM 15.0.6, 256 bits), OpenGL 4.5)", False),
        ("ANGLE (Microsoft, Microsoft Basic Render Driver (0x0000008C) Direct3D11 vs_5_0 ps_5_0, D3D11)", False),
        ("softpipe", False),
        ("Apple Software Renderer", False),
    ):
        assert chromium.execute_async_script(code, name, unmasked) is gpu, name


@in_browser
def test_without_webgl_the_page_says_so(scattered, tmp_path):
    save_html(scattered, tmp_path / "p.html")
    with browser(800, 600, "--disable-3d-apis") as driver:
        driver.get((tmp_path / "p.html").as_uri())
        end = time.monotonic() + 30
        while (text := driver.find_element("id", "loading").text) == "Loading …":
            assert time.monotonic() < end
            time.sleep(0.05)
        assert text.startswith("The page cannot be shown: this browser has no WebGL 2 to draw the scene with.")
        image = matplotlib.image.imread(BytesIO(driver.get_screenshot_as_png()))[..., :3] * 255
        assert (abs(image - NIGHT).max(axis=-1) > 100).sum() > 1000  # letters


@in_browser
def test_the_page_opens_on_the_vehicle_the_points_and_what_is_missed(chromium, served, contents):
    """No slab is drawn before a click asks for it: as if the rig had none; the ground shows what is missed."""
    opened(chromium, served)
    before = picture(chromium)
    chromium.execute_script("lidarcfg.worst.set([]); lidarcfg.stage.redraw()")
    assert different(picture(chromium), before) == 0
    opened(chromium, served)
    click(chromium, "#bodies")
    assert different(picture(chromium), before) > 1000
    click(chromium, "#bodies")
    put(chromium, "#worst", 2)  # asks for them, too
    assert different(picture(chromium), before) > 1000
    click(chromium, "#bodies")
    click(chromium, "#missed")
    assert different(picture(chromium), before) > 100
    at = on_screen(chromium, contents.study.vehicle.scene.mesh()[0].mean(axis=0))
    assert abs(np.array(at)).max() < 160  # pixels from the middle


@in_browser
def test_a_saved_picture_is_what_the_browser_shows(chromium, served):
    """Compared with the browser's own screenshot, labels included."""
    opened(chromium, served)
    shown = picture(chromium)
    chromium.find_element("tag name", "body").send_keys("p")
    path = chromium.downloads / "lidarcfg.png"
    end = time.monotonic() + 30
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    saved = matplotlib.image.imread(path)[..., :3] * 255
    assert saved.shape == shown.shape
    assert different(saved, shown) < 600  # letters
    click(chromium, "#sensor-0")
    assert different(picture(chromium), saved) > 1000


@in_browser
def test_controls_change_the_picture(chromium, served):
    opened(chromium, served)
    click(chromium, "#fit")
    before = picture(chromium)
    for turn in ("#sensor-1", "#region", "#bodies"):
        click(chromium, turn)
        assert different(picture(chromium), before) > 300, turn
        click(chromium, turn)
        assert different(picture(chromium), before) < 100, turn
    seen = [before]
    for mode in ("intensity", "ring", "height", "time"):
        put(chromium, "#colour", mode, "change")
        image = picture(chromium)
        assert all(different(image, other) > 1000 for other in seen), mode
        seen.append(image)
    put(chromium, "#colour", "sensor", "change")
    put(chromium, "#cones", 10)
    assert different(picture(chromium), before) > 1000
    put(chromium, "#cones", 0)
    click(chromium, "#look-top")
    assert different(picture(chromium), before) > 1000
    assert complaints(chromium) == []


@in_browser
def test_the_slider_shows_a_frame_and_play_goes_on(chromium, served, contents):
    opened(chromium, served)
    whole = picture(chromium)
    put(chromium, "#time", 1)
    second = picture(chromium)
    assert different(second, whole) > 1000
    first, last = chromium.execute_script("return [lidarcfg.cloud.first, lidarcfg.cloud.last]")
    since_us = (contents.cloud.time_ns - contents.cloud.time_ns.min()) // 1000
    assert (first, last) == (100_000, 199_999)
    code = "const c = lidarcfg.cloud; return c.arrays.time.filter((t) => t >= c.first && t <= c.last).length"
    assert chromium.execute_script(code) == ((since_us >= first) & (since_us <= last)).sum()
    click(chromium, "#play")
    end = time.monotonic() + 30
    while len(set(seen := chromium.execute_script("return (window.seen ??= []).push(lidarcfg.time.at) && seen"))) < 3:
        assert time.monotonic() < end, seen
        time.sleep(0.02)
    click(chromium, "#play")
    click(chromium, "#whole")
    assert different(picture(chromium), whole) < 100


@in_browser
def test_a_handle_moves_the_rig_and_max_vsr_follows(chromium, served, contents):
    opened(chromium, served)
    started = evaluate(contents.study, contents.rigs[0]).max_vsr_m
    assert shown_vsr(chromium) == started
    click(chromium, "#fit")
    before = picture(chromium)
    put(chromium, "#mount", 0, "change")
    at = np.array(contents.rigs[0].mounts[0].position_m)
    drag(chromium, at, 2, 0.6)
    poses = np.array(chromium.execute_script("return lidarcfg.handles.poses"))
    assert poses[0, 2] > at[2] + 0.1
    rig = with_poses(contents.rigs[0], poses)
    assert rig.mounts[0].rpy_rad == contents.rigs[0].mounts[0].rpy_rad
    found = evaluate(contents.study, rig)
    assert shown_vsr(chromium) == found.max_vsr_m != started
    shown = chromium.find_element("id", "vsr").text
    assert shown == f"max VSR {found.max_vsr_m:.6f} m"
    click(chromium, "#undo")  # the whole drag
    assert shown_vsr(chromium) == started
    click(chromium, "#redo")
    assert shown_vsr(chromium) == found.max_vsr_m
    assert different(picture(chromium), before) > 300
    click(chromium, "#reset")
    assert shown_vsr(chromium) == started
    assert complaints(chromium) == []


@in_browser
def test_poses_can_be_typed_and_the_rig_saved(chromium, served, contents):
    opened(chromium, served)
    put(chromium, "#mount", 1, "change")
    put(chromium, "#pose-y", -0.8)
    put(chromium, "#pose-roll", 20)
    x, _, z = contents.rigs[0].mounts[1].position_m
    _, pitch, yaw = contents.rigs[0].mounts[1].rpy_rad
    poses = np.array([(*m.position_m, *m.rpy_rad) for m in contents.rigs[0].mounts])
    poses[1] = (x, -0.8, z, 20 * np.pi / 180, pitch, yaw)
    rig = with_poses(contents.rigs[0], poses)
    assert shown_vsr(chromium) == evaluate(contents.study, rig).max_vsr_m
    click(chromium, "#download")
    path = chromium.downloads / "rig.yaml"
    end = time.monotonic() + 30
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    assert load_rig(path) == rig


@in_browser
def test_rotating_by_a_handle_keeps_equivalent_angles(chromium, served, contents):
    """The page's angles make the same matrix as geometry.py's, also where two sets of angles are the same orientation."""
    opened(chromium, served)
    code = (
        "const m = lidarcfg.handles.mounts[0]; const before = m.pose; m.pose = arguments[0]; "
        "const e = m.object.matrix.compose(m.object.position, m.object.quaternion, m.object.scale).elements;"
        "const after = m.moved(true); m.pose = before; return [e, after]"
    )
    for rpy in ((0.3, -0.4, 2.0), (3.0, 2.5, 0.0), (-4.0, 0.2, 7.0)):
        pose = [1.0, 2.0, 3.0, *rpy]
        elements, after = chromium.execute_script(code, pose)
        (mount, *_) = with_poses(contents.rigs[0], np.array([pose, pose])).mounts
        assert np.array(elements).reshape(4, 4).T == pytest.approx(mount.T_vehicle_sensor, abs=1e-12)
        assert after == pytest.approx(pose, abs=1e-9)


@in_browser
def test_measuring_between_two_points(chromium, served, contents):
    from selenium.webdriver import ActionChains

    opened(chromium, served)
    click(chromium, "#bodies")
    click(chromium, "#fit")
    click(chromium, "#measure")
    settled(chromium)
    canvas = chromium.find_element("id", "canvas")
    for place in ((-6.0, 8.0, 1.0), (4.0, 8.0, 2.0)):
        ActionChains(chromium, duration=50).move_to_element_with_offset(
            canvas, *on_screen(chromium, place)
        ).click().perform()
    ends = np.array(chromium.execute_script("return lidarcfg.measure.ends.map((end) => end.toArray())"))
    for end, place in zip(ends, ((-6.0, 8.0, 1.0), (4.0, 8.0, 2.0)), strict=True):
        assert np.linalg.norm(contents.cloud.xyz - end, axis=1).min() < 1e-5
        assert np.abs(np.subtract(on_screen(chromium, end.tolist()), on_screen(chromium, place))).max() <= 3  # pixels
    told = chromium.find_element("id", "status").text
    dx, dy, dz = ends[1] - ends[0]
    assert told.startswith(f"{np.linalg.norm(ends[1] - ends[0]):.3f} m: dx {dx:.3f} m, dy {dy:.3f} m, dz {dz:.3f} m")


@in_browser
def test_a_cloud_far_away_is_not_blurred(chromium, tmp_path):
    """At coordinates as of UTM a point that is clicked is within a tenth of a millimetre of where it is."""
    rng = np.random.default_rng(2)
    xyz = np.array([4.5e5, 5.4e6, 300.0]) + rng.uniform(-5, 5, (200, 3))
    zeros = np.zeros(200, np.uint8)
    cloud = PointCloud(xyz, zeros, zeros, np.zeros(200, np.int64), zeros.astype(np.uint16), ("a",), zeros)
    save_html(page_of(Contents(cloud, None, (), None, (), np.eye(4))), tmp_path / "far.html")
    opened(chromium, (tmp_path / "far.html").as_uri())
    assert (abs(picture(chromium) - NIGHT).max(axis=-1) > 24).sum() > 200
    assert complaints(chromium) == []
    places = np.array(
        chromium.execute_script("return [...Array(200).keys()].map((i) => lidarcfg.cloud.place(i).toArray())")
    )
    off = np.linalg.norm(places[:, None] - xyz[None], axis=2).min(axis=1)
    assert off.max() < 1e-4
    x, y = next((x, y) for x, y in (on_screen(chromium, place) for place in places) if abs(x) < 300 and abs(y) < 200)
    half = "const { size } = lidarcfg.stage; return lidarcfg.cloud.pick(arguments[0] + size.x / 2, arguments[1] + size.y / 2)"
    found = chromium.execute_script(half, x, y)
    assert np.linalg.norm(np.array(on_screen(chromium, places[found])) - (x, y)) < 8


def test_the_server_answers_what_evaluate_does(served, contents):
    poses = np.array([(*m.position_m, *m.rpy_rad) for m in contents.rigs[0].mounts]) + 0.01
    status, text = asked(served, "POST", "/evaluate", json.dumps({"poses": poses.tolist(), "worst": 2}))
    found = evaluate(contents.study, with_poses(contents.rigs[0], poses))
    said = json.loads(text)
    assert (status, said["max_vsr_m"], said["subspaces"]) == (200, found.max_vsr_m, len(found.subspaces))
    assert [body["vsr_m"] for body in said["worst"]] == [worst.vsr_m for worst in found.worst[:2]]
    mesh = said["worst"][0]["mesh"]
    corners = np.frombuffer(base64.b64decode(mesh["vertices"]), "<f4").reshape(-1, 3) + mesh["origin_m"]
    assert corners.min(axis=0) == pytest.approx(found.worst[0].min_m, abs=1e-5)
    assert corners.max(axis=0) == pytest.approx(found.worst[0].max_m, abs=1e-5)


@pytest.mark.parametrize(
    ("method", "path", "body", "headers", "status", "what"),
    [
        ("GET", "/", None, {"Host": "evil.example"}, 403, "this page answers to 127.0.0.1 and localhost only"),
        ("GET", "/about.json", None, {"Host": "evil.example:80"}, 403, "only"),
        ("POST", "/evaluate", "{}", {"Origin": "https://evil.example"}, 403, "only"),
        ("GET", "/../pyproject.toml", None, {}, 404, "no such page"),
        ("GET", "/page/../../pyproject.toml", None, {}, 404, "no such page"),
        ("GET", "/array/none", None, {}, 404, "no such page"),
        ("POST", "/evaluate", "no", {}, 400, "not JSON"),
        ("POST", "/evaluate", "[]", {}, 400, "not a map"),
        ("POST", "/evaluate", "{}", {}, 400, "poses: allowed are 2 of x, y, z, roll, pitch, yaw"),
        ("POST", "/evaluate", '{"poses": [[0, 0, 0, 0, 0, NaN], [0, 0, 0, 0, 0, 0]]}', {}, 400, "poses: allowed"),
        ("POST", "/evaluate", '{"poses": [[0, 0, 0, 0, 0, "a"], [0]]}', {}, 400, "poses: allowed"),
        ("POST", "/evaluate", '{"poses": [[0,0,1,0,0,0],[0,0,2,0,0,0]], "worst": 99}', {}, 400, "worst: allowed is 0 to 10"),
        ("POST", "/evaluate", "{}", {"Content-Length": "9" * 30}, 400, "Content-Length"),
        ("POST", "/none", '{"poses": [[0,0,1,0,0,0],[0,0,2,0,0,0]]}', {}, 404, "no such page"),
    ],
)  # fmt: skip
def test_the_server_refuses(served, method, path, body, headers, status, what):
    found, text = asked(served, method, path, body, **headers)
    assert (found, what in text.decode()) == (status, True), text
    assert text.count(b"\n") == 1


def test_violations_of_a_moved_rig(served, contents):
    assert (
        json.loads(asked(served, "GET", "/about.json")[1])["evaluation"]["violations"] == []
    )  # another rig than the study's
    study = contents.study
    rig = study.rig(study.space.poses(np.full((1, study.space.dimensions), 0.5))[0])
    from lidarcfg.viewer.mounting import violations

    assert violations(study, rig) == []
    poses = np.array([(*m.position_m, *m.rpy_rad) for m in rig.mounts])
    poses[0, 2] = 2.5
    poses[2, 3] = np.radians(-30)
    poses[1, 3:] += (np.pi, np.pi - 2 * poses[1, 4], np.pi)  # the same angles, said the other way
    assert violations(study, with_poses(rig, poses)) == [
        "roof_0: z 2.500 m is outside 1.65 to 1.9 m",
        "front_bumper: roll -30.00° is outside -10 to 10°",
    ]


@in_browser
def test_fewer_points_while_moving_are_a_fair_sample(chromium, served, contents):
    """A tenth of them: of each sensor, each half of the time and each half of the place a tenth, within six sigma."""
    opened(chromium, served)
    count = len(contents.cloud.xyz)
    code = (
        "return lidarcfg.cloud.ranges(arguments[0]).flatMap(([a, b]) => Array.from({ length: b - a }, (_, i) => a + i))"
    )
    drawn = np.array(chromium.execute_script(code, count // 10))
    assert len(set(drawn.tolist())) == len(drawn)
    assert count / 10 <= len(drawn) <= count / 10 + 256
    arrays = page_of(contents).arrays
    for part in (arrays["fact"][:, 2] == 1, arrays["time"] < 150_000, arrays["position"][:, 0] < 0):
        expected = len(drawn) * part.mean()
        assert abs(part[drawn].sum() - expected) < 6 * np.sqrt(expected)
    assert len(chromium.execute_script(code, 10 * count)) == count


@in_browser
def test_the_keyboard(chromium, served):
    opened(chromium, served)
    body = chromium.find_element("tag name", "body")
    body.send_keys("4")
    assert (
        chromium.execute_script("return [lidarcfg.cloud.mode, document.getElementById('colour').value]")
        == ["height"] * 2
    )
    from selenium.webdriver import Keys

    body.send_keys(Keys.ARROW_RIGHT)
    assert chromium.execute_script("return [lidarcfg.time.at, lidarcfg.time.whole]") == [1, False]
    for key, width in (("+", 2), ("+", 3), ("+", 3), ("-", 2)):  # of three frames
        body.send_keys(key)
        assert chromium.execute_script("return lidarcfg.time.width") == width
    body.send_keys(" ")
    assert chromium.execute_script("return lidarcfg.time.playing")
    body.send_keys(" m")
    assert chromium.execute_script("return [lidarcfg.time.playing, lidarcfg.measure.on]") == [False, True]
    body.send_keys(Keys.ESCAPE)
    assert not chromium.execute_script("return lidarcfg.measure.on")


def test_nothing_is_lost_in_a_standalone_file(contents, tmp_path):
    """Its arrays, taken out of the HTML again, hold each point with its facts once."""
    save_html(page_of(contents), tmp_path / "p.html")
    pieces = re.findall(
        r'<script data-array="(\w+)" type="text/plain">([^<]*)</script>', (tmp_path / "p.html").read_text()
    )
    raw = {name: b"".join(base64.b64decode(text) for key, text in pieces if key == name) for name, _ in pieces}
    about = page_of(contents).about["points"]
    seen = contents.cloud
    found = np.column_stack(
        [
            np.frombuffer(raw["position"], "<f4").reshape(-1, 3) + np.array(about["origin_m"]),
            np.frombuffer(raw["time"], "<u4"),
            np.frombuffer(raw["fact"], "u1").reshape(-1, 4)[:, :3],
        ]
    )
    since_us = (seen.time_ns - seen.time_ns.min()) // 1000
    given = np.column_stack([seen.xyz, since_us, seen.intensity, seen.ring, seen.sensor])
    order, other = (np.lexsort(rows[:, 3:].T) for rows in (found, given))
    np.testing.assert_allclose(found[order], given[other], atol=1e-6)


def test_the_command_serves_until_ctrl_c():
    words = [sys.executable, "-m", "lidarcfg", "view", str(ROOF), "--port", "0"]
    with started(words) as running:
        told = running.stdout.readline()
        url = told.split()[0]
        assert told == f"{url} shows 0 points; Ctrl-C ends it\n"
        assert asked(url, "GET", "/about.json")[0] == 200
        running.send_signal(signal.SIGINT)
        assert running.wait(30) == 130
        assert running.stderr.read().strip() == "interrupted"


def test_a_port_that_is_taken(served, contents):
    port = int(served.rstrip("/").rpartition(":")[2])
    with pytest.raises(ConfigError, match=f"port {port}: address already in use"):
        Server(contents, page_of(contents), port)


def test_what_is_vendored_is_what_was_made():
    assert hashlib.sha256((ASSETS / "vendor/three.js").read_bytes()).hexdigest() == THREE
    assert "MIT License" in (ASSETS / "vendor/LICENSE-three").read_text()
    made = (ROOT / "tools/bundle_three").read_text().split("three=")[1].split()[0]
    assert f"three.js {made}," in (ASSETS / "vendor/three.js").read_text("utf-8").splitlines()[0]
    assert sorted(MODULES.values()) == sorted(str(path.relative_to(ASSETS)) for path in ASSETS.rglob("*.js"))


def test_no_text_of_the_users_ends_a_script(tmp_path, contents):
    from dataclasses import replace

    name = "</script><script>document.title = 'hit'</script>"
    hostile = replace(contents, cloud=replace(contents.cloud, sensor_names=(name, "b")), rigs=(), study=None)
    save_html(page_of(hostile), tmp_path / "p.html")
    text = (tmp_path / "p.html").read_text()
    assert name not in text
    about = text.split('<script id="about" type="application/json">')[1].split("</script>")[0]
    assert json.loads(about)["sensors"][0]["name"] == name


CAB = """
region: {min_m: [-8, -5, 0], max_m: [8, 5, 3], cuboid_m: [0.5, 0.5, 0.25]}
objective: {max_vsr: 1}
vehicle:
  boxes: [{name: cab, center_m: [0, 0, 0.75], size_m: [4, 2, 1.5], exclude: true}]
sensors:
  - {name: front, elevation_deg: [-20, -8, 3, 12], min: {position_m: [2.2, -0.5, 0.4], rpy_deg: [0, 0, 0]}, max: {position_m: [2.2, 0.5, 0.8], rpy_deg: [0, 0, 0]}}
  - {name: top, elevation_deg: [-20, -8, 3, 12], on: {body: cab, from: above, within: {min_m: [-2, -1, 1], max_m: [2, 1, 2]}, base_radius_m: 0.1}}
"""


@pytest.fixture
def cab(tmp_path):
    """A rig on a vehicle."""
    (tmp_path / "cab.yaml").write_text(CAB)
    return load_contents([tmp_path / "cab.yaml"], None, None, np.eye(4), print)


@in_browser
def test_a_body_may_be_switched_transparent(chromium, cab, tmp_path):
    """Max VSR with and without what has_obstacles, and the blind volume, are evaluate's; where bases may be; served, and in a file."""
    study = cab.study
    rig = cab.rigs[0]
    with_body = evaluate(study, rig)
    without = evaluate(replace(study, visibility=None), rig)
    assert with_body.max_vsr_m != without.max_vsr_m

    def shown():
        settled(chromium)
        ids = ("other-vsr", "blind-volume")
        texts = [
            chromium.execute_script("return document.getElementById(arguments[0]).textContent", key) for key in ids
        ]
        return shown_vsr(chromium), *(float(re.match(r"[0-9.,]+", text)[0].replace(",", "")) for text in texts)

    save_html(page_of(cab), tmp_path / "p.html")
    with serving(cab) as served:
        for url in (served, (tmp_path / "p.html").as_uri()):
            opened(chromium, url)
            assert shown() == (
                with_body.max_vsr_m,
                pytest.approx(without.max_vsr_m, abs=1e-6),
                pytest.approx(with_body.seen_by_m3[0], abs=0.01),
            )
            click(chromium, "#bodies")
            shown_seats = picture(chromium)
            click(chromium, "#bounds")
            solid = picture(chromium)
            assert different(shown_seats, solid) > 500  # the roof is green where a base may be
            click(chromium, "#blind")
            blind = picture(chromium)
            assert different(blind, solid) > 500
            click(chromium, "#transparent")
            assert shown() == (without.max_vsr_m, pytest.approx(with_body.max_vsr_m, abs=1e-6), 0.0)
            assert different(picture(chromium), solid) > 500


def test_the_server_refuses_other_than_true_or_false(cab):
    poses = [[*mount.position_m, *mount.rpy_rad] for mount in cab.rigs[0].mounts]
    with serving(cab) as url:
        found = asked(url, "POST", "/evaluate", json.dumps({"poses": poses, "transparent": "yes"}))
    assert found == (400, b"transparent: allowed is true or false\n")
