"""Speed of the page without a GPU: python tools/bench_view.py [--points N ...] [--viser PYTHON]."""

import argparse
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from lidarcfg.cloud import PointCloud, save_clouds
from lidarcfg.view.page import page_of, save_html
from lidarcfg.view.server import Server
from lidarcfg.view.stage import load_stage
from tests.chromium import browser

SEED = 1
SECONDS = 5.0
STUDIES = ("sedan", "liu2018-4x16")
AT_REST = "const v = window.lidarcfg; return Boolean(v && v.stage.settledAt === v.stage.frames && !v.stage.waiting)"
TURN = """
const [budget, seconds, done] = arguments;
const { stage } = window.lidarcfg;
const gl = stage.renderer.getContext();
const wait = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
stage.budgetMs = budget ?? 1e9;
if (budget === null) stage.limit = 1e9;
const spin = (seconds, end) => {
  const began = performance.now();
  const before = stage.frames;
  const step = () => {
    const { x, y } = stage.camera.position.clone().sub(stage.orbit.target);
    const eye = stage.camera.position.clone();
    eye.x += x * Math.cos(0.02) - y * Math.sin(0.02) - x;
    eye.y += x * Math.sin(0.02) + y * Math.cos(0.02) - y;
    stage.place(eye, stage.orbit.target.clone());
    if (performance.now() - began < seconds * 1000) return requestAnimationFrame(step);
    wait();
    const count = stage.frames - before;
    end([count / ((performance.now() - began) / 1000), stage.points.drawn]);
  };
  step();
};
spin(2, () => spin(seconds, done));
"""
COUNT_CLOUDS = """
const draw = WebGL2RenderingContext.prototype.drawArrays;
window.clouds = 0;
WebGL2RenderingContext.prototype.drawArrays = function (mode, ...others) {
  if (mode === this.POINTS) window.clouds += 1;
  return draw.call(this, mode, ...others);
};
"""
ASK = """
const [poses, done] = arguments;
const { handles } = window.lidarcfg;
const began = performance.now();
const before = window.lidarcfg.evaluator.answered;
handles.move(handles.mounts[0], poses);
const look = () => window.lidarcfg.evaluator.answered > before && !window.lidarcfg.evaluator.busy
  ? done(performance.now() - began) : setTimeout(look, 0);
look();
"""
VISER = """
import sys, time, numpy as np, viser
server = viser.ViserServer(host="127.0.0.1", port=int(sys.argv[1]), verbose=False)
xyz = np.load(sys.argv[2])
colours = np.full((len(xyz), 3), 200, np.uint8)
server.scene.add_point_cloud("cloud", xyz.astype(np.float32), colours, point_size=0.02, precision="float32")
time.sleep(600)
"""


def street(count: int) -> PointCloud:
    """Points as four sensors see a street: rings on the ground and walls to both sides, for count / 1.2 million s."""
    rng = np.random.default_rng(SEED)
    azimuth, ring = rng.uniform(-np.pi, np.pi, count), rng.integers(0, 16, count)
    elevation = np.radians(2.0 * ring - 15)
    ground = np.where(elevation < 0, 2.0 / np.tan(np.maximum(-elevation, 1e-3)), 100.0)
    wall = 8.0 / np.maximum(abs(np.sin(azimuth)), 0.08)
    away = np.minimum(ground, wall) + rng.normal(0, 0.01, count)
    xyz = np.stack([away * np.cos(azimuth), away * np.sin(azimuth), 2.0 + away * np.tan(elevation)], axis=1)
    return PointCloud(
        xyz=xyz,
        intensity=rng.integers(0, 256, count).astype(np.uint8),
        ring=ring.astype(np.uint8),
        time_ns=np.sort(rng.integers(0, int(count / 1.2e6 * 1e9) + 1, count)),
        sensor=rng.integers(0, 4, count).astype(np.uint16),
        sensor_names=("front", "rear", "left", "right"),
        return_type=np.zeros(count, np.uint8),
    )


def measure_points(count: int, folder: Path) -> None:
    """Print the table's lines for a cloud of `count` points."""
    save_clouds(folder / "cloud.ply", [street(count)])
    start, start_cpu = time.perf_counter(), time.process_time()
    stage = load_stage([folder / "cloud.ply"], None, None, np.eye(4), print)
    page = page_of(stage)
    made, cpu = time.perf_counter(), time.process_time() - start_cpu
    line(f"{count:,} points: PLY read, page made", f"{made - start:.2f} s; {cpu:.2f} s of the processor")
    with Server(stage, page) as server, browser(1280, 800) as driver:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        began = time.perf_counter()
        driver.get(server.url)
        at_rest(driver)
        shown = time.perf_counter() - began
        line("browser, from the address to all points drawn", f"{shown:.2f} s")
        line("**from the file to the picture**", f"**{made - start + shown:.2f} s**")
        rate, drawn = driver.execute_async_script(TURN, None, SECONDS)
        line("turning, all points drawn", f"{rate:.1f} frames/s, {drawn:,} points")
        rate, drawn = driver.execute_async_script(TURN, 50, SECONDS)
        line("turning, as many as 50 ms allow", f"{rate:.1f} frames/s, {drawn:,} points")
        driver.get(f"{server.url}?points=gpu")
        at_rest(driver)
        rate, drawn = driver.execute_async_script(TURN, None, SECONDS)
        line("turning, all points as three.Points, which SwiftShader draws", f"{rate:.1f} frames/s, {drawn:,} points")
        server.shutdown()
    began = time.perf_counter()
    save_html(page, folder / "page.html")
    size = (folder / "page.html").stat().st_size / 1e6
    line("standalone file written", f"{time.perf_counter() - began:.2f} s, {size:.1f} MB")
    with browser(1280, 800) as driver:
        began = time.perf_counter()
        driver.get((folder / "page.html").as_uri())
        at_rest(driver)
        line("standalone file, from opening to all points drawn", f"{time.perf_counter() - began:.2f} s")


def measure_handles(name: str) -> None:
    """Print how long it takes from moving a handle to the new max VSR in the page."""
    stage = load_stage([ROOT / f"data/studies/{name}.yaml"], None, None, np.eye(4), print)
    pose = np.array([*stage.rigs[0].mounts[0].position_m, *stage.rigs[0].mounts[0].rpy_rad])
    with Server(stage, page_of(stage)) as server, browser(1280, 800) as driver:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        driver.get(server.url)
        at_rest(driver)
        took = [driver.execute_async_script(ASK, (pose + 0.01 * i).tolist()) for i in range(40)][5:]
        server.shutdown()
    shown = f"{statistics.median(took):.0f} ms, {min(took):.0f} to {max(took):.0f}"
    line(f"a sensor of `{name}` moved until its max VSR is shown", shown)


def measure_viser(python: str, count: int, folder: Path) -> None:
    """Print viser's frames a second for as many points, in the same browser."""
    from selenium.webdriver import ActionChains

    np.save(folder / "xyz.npy", street(count).xyz)
    server = subprocess.Popen([python, "-c", VISER, "8791", folder / "xyz.npy"])
    try:
        time.sleep(6)
        with browser(1280, 800) as driver:
            driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": COUNT_CLOUDS})
            driver.get("http://127.0.0.1:8791/")
            time.sleep(8)
            canvas = driver.find_element("tag name", "canvas")
            drag = ActionChains(driver, duration=int(SECONDS * 1000)).move_to_element_with_offset(canvas, -300, 0)
            drag = drag.click_and_hold().move_to_element_with_offset(canvas, 100, 20).release()
            before, began = driver.execute_script("return window.clouds"), time.perf_counter()
            drag.perform()
            rate = (driver.execute_script("return window.clouds") - before) / (time.perf_counter() - began)
        line(f"viser, {count:,} points, turning by a drag", f"{rate:.1f} frames/s")
    finally:
        server.terminate()
        server.wait()


def at_rest(driver: object) -> None:
    """Wait until everything is drawn."""
    while not driver.execute_script(AT_REST):
        time.sleep(0.02)


def line(what: str, value: str) -> None:
    """A row of the table."""
    print(f"| {what} | {value} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, nargs="*", default=[300_000, 10_000_000])
    parser.add_argument("--viser", metavar="PYTHON", help="a Python that has viser, to compare with")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print("| measured | |\n|---|---|")
        for count in given.points:
            measure_points(count, folder)
        for study in STUDIES:
            measure_handles(study)
        if given.viser:
            measure_viser(given.viser, given.points[0] if given.points else 300_000, folder)


if __name__ == "__main__":
    main()
