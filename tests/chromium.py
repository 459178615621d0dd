"""Debian's Chromium without a screen; SwiftShader draws, on the processor."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars"),
)
LACKING = "; ".join(
    f"no {name} (Debian: apt-get install {package})"
    for name, package in (("chromium", "chromium"), ("chromedriver", "chromium-driver"))
    if not shutil.which(name)
)


@contextmanager
def browser(width: int = 1280, height: int = 800, *more: str) -> Iterator[Any]:
    """A selenium driver with a profile of its own and `more` flags, which keeps the console's and the network's log."""
    from selenium import webdriver

    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = shutil.which("chromium")
        for flag in (*FLAGS, *more, f"--window-size={width},{height}", f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        options.add_experimental_option("prefs", {"download.default_directory": profile})
        driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
        driver.downloads = Path(profile)
        driver.set_script_timeout(120)
        driver.set_page_load_timeout(120)
        try:
            yield driver
        finally:
            driver.quit()


def asked_for(driver: Any) -> list[str]:
    """What the page has loaded since it was last asked, but for what it held itself."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    urls = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [url for url in urls if not url.startswith(("data:", "blob:", "chrome:"))]


def complaints(driver: Any) -> list[str]:
    """Warnings and errors of the console, without SwiftShader's remarks on its own speed."""
    told = [entry["message"] for entry in driver.get_log("browser") if entry["level"] in ("WARNING", "SEVERE")]
    return [text for text in told if "GL Driver Message (OpenGL, Performance" not in text]
