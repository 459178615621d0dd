"""The page in a browser: opened, at rest, its picture and its controls."""

import http.client
import threading
import time
from contextlib import contextmanager
from io import BytesIO

import matplotlib.image
import numpy as np
import pytest

from lidarcfg.viewer.page import page_of
from lidarcfg.viewer.server import Server
from tests.chromium import LACKING, asked_for, complaints

NIGHT = np.array([16, 20, 28])
in_browser = pytest.mark.skipif(bool(LACKING), reason=LACKING)


@contextmanager
def serving(contents, **options):
    """The address of a page's page, which is served meanwhile."""
    with Server(contents, page_of(contents, served=True, **options)) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server.url
        finally:
            server.shutdown()
            thread.join()


def settled(driver):
    """Wait until the page has drawn everything and has no request open."""
    quiet = (
        "const v = window.lidarcfg; return Boolean(v && v.stage.settledAt === v.stage.frames && !v.stage.waiting "
        "&& ![v.evaluator, v.rates, v.verifier, v.missing, v.handles?.slider].some((one) => one?.busy || one?.timer))"
    )
    end = time.monotonic() + 60
    while not driver.execute_script(quiet):
        failed = driver.execute_script("return document.getElementById('loading')?.textContent ?? ''")
        assert failed in ("", "Loading …"), failed
        assert time.monotonic() < end, f"the page does not come to rest: {complaints(driver)}"
        time.sleep(0.05)


def opened(driver, url):
    asked_for(driver), complaints(driver)  # drop what was before this page
    driver.get(url)
    settled(driver)
    return driver


def picture(driver):
    """(h, w, 3) what the canvas shows, without the controls."""
    settled(driver)
    image = matplotlib.image.imread(BytesIO(driver.get_screenshot_as_png()))[..., :3] * 255
    return image[:, : driver.execute_script("return document.querySelector('main').clientWidth")]


def different(one, other):
    """How many pixels differ clearly."""
    return int((abs(one - other).max(axis=-1) > 24).sum())


def click(driver, selector):
    driver.execute_script("document.querySelector(arguments[0]).click()", selector)


def put(driver, selector, value, event="input"):
    code = "const e = document.querySelector(arguments[0]); e.value = arguments[1]; e.dispatchEvent(new Event(arguments[2]))"
    driver.execute_script(code, selector, value, event)


def on_screen(driver, place):
    """Where a place in the scene is on the canvas, from its middle, as selenium counts."""
    code = (
        "const s = lidarcfg.stage; const v = s.orbit.target.clone().set(...arguments[0]).project(s.camera);"
        "return [v.x * s.size.x / 2, -v.y * s.size.y / 2]"
    )
    x, y = driver.execute_script(code, list(place))
    return round(x), round(y)


def drag(driver, at, axis, by_m):
    """Drag the handle along an axis (0, 1, 2) of the selected sensor, which is at a place, so far."""
    from selenium.webdriver import ActionChains

    settled(driver)
    code = (  # the handles are as large on the screen from anywhere
        "const h = lidarcfg.handles.controls; let x; h.getHelper().traverse((o) => { if (o.name === 'Z' && o.isMesh && !x) x = o });"
        "return x.getWorldScale(h.worldPosition.clone()).x"
    )
    size = driver.execute_script(code)
    along = np.eye(3)[axis]
    canvas = driver.find_element("id", "canvas")
    tip, end = (np.array(on_screen(driver, at + far * along)) for far in (0.45 * size, 0.45 * size + by_m))
    action = ActionChains(driver, duration=100).move_to_element_with_offset(canvas, *tip.tolist()).click_and_hold()
    for part in (0.25, 0.5, 0.75, 1):
        action = action.move_to_element_with_offset(canvas, *np.rint(tip + part * (end - tip)).astype(int).tolist())
    action.release().perform()
    settled(driver)


def told(driver, what):
    """Wait until the page's status line says it."""
    end = time.monotonic() + 30
    while what not in (text := driver.find_element("id", "status").text):
        assert time.monotonic() < end, text
        time.sleep(0.02)


def shown_vsr(driver):
    settled(driver)
    return float(driver.execute_script("return document.getElementById('vsr').dataset.value"))


def poses_of(rig):
    """(mounts, 6) of a rig."""
    return np.array([(*mount.position_m, *mount.rpy_rad) for mount in rig.mounts])


def asked(url, method, path, body=None, **headers):
    host = url.removeprefix("http://").rstrip("/")
    connection = http.client.HTTPConnection(host, timeout=20)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, text
