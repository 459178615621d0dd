"""Photograph reports and the page in a browser: docs/report.png, seen.png, verdict.png, requirements.png, view.png and
view-drive.png.

Usage: .venv/bin/python tools/draw_screens.py report|seen|verdict|requirements|view
"""

import re
import shlex
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from lidarcfg.capture.manifest import DriveInputs
from lidarcfg.cli.main import cli
from lidarcfg.viewer.contents import complete_inputs, load_contents
from lidarcfg.viewer.page import page_of
from lidarcfg.viewer.server import Server
from tests.chromium import browser
from tests.viewer.driver import click, opened, put, settled

PARTS = "document.body", "document.querySelector('#blind')"  # what is at the top of each part
FRAMES = 2, 14, 27
FROM = (
    "const s = lidarcfg.stage; const at = (...x) => s.orbit.target.clone().set(...x);"
    "s.place(at(-11, -9, 13), at(11, 2, 0))"
)


@contextmanager
def served(*files: str) -> Iterator[str]:
    """The address of the page of a capture, as it was noted, and other files."""
    paths, known = complete_inputs([Path(name) for name in files], DriveInputs(), print)
    contents = load_contents(paths, known.rig, None, known.motion(), print, vehicle=known.vehicle)
    with Server(contents, page_of(contents, by="height", served=True)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.url
        server.shutdown()


def report() -> None:
    """Place the sedan's sensors, and photograph two parts of the report."""
    with tempfile.TemporaryDirectory() as folder, browser(700, 1300) as driver:
        line = ["optimize", str(ROOT / "data/studies/sedan.yaml"), "-o", folder, "--evaluations", "4000", "--quiet"]
        cli.main(line, prog_name="lidarcfg", standalone_mode=False)
        driver.get((Path(folder) / "report.html").as_uri())
        parts = []
        for part in PARTS:
            driver.execute_script(f"{part}.scrollIntoView()")
            parts.append(np.asarray(Image.open(BytesIO(driver.get_screenshot_as_png())).convert("RGB")))
    save(Image.fromarray(np.concatenate(parts, axis=1)), "report.png", 64)


def seen() -> None:
    """Place the sedan's sensors, and photograph what the report begins with: misses by object, and from above."""
    with tempfile.TemporaryDirectory() as folder, browser(1000, 1000) as driver:
        line = ["optimize", str(ROOT / "data/studies/sedan.yaml"), "-o", folder, "--evaluations", "12000", "--quiet"]
        cli.main(line, prog_name="lidarcfg", standalone_mode=False)
        driver.get((Path(folder) / "report.html").as_uri())
        parts = []
        for part in ("table", "figure svg"):
            element = driver.find_element("css selector", f"section[aria-labelledby=seen] {part}")
            parts.append(Image.open(BytesIO(element.screenshot_as_png)).convert("RGB"))
    image = Image.new("RGB", (max(one.width for one in parts), sum(one.height for one in parts)), "white")
    image.paste(parts[0], (0, 0))
    image.paste(parts[1], (0, parts[0].height))
    save(image, "seen.png", 128)


def verdict() -> None:
    """Verify the rig of the documentation's page, and photograph the beginning of the report."""
    text = (ROOT / "docs/reading-a-report.md").read_text()
    with tempfile.TemporaryDirectory() as folder, chdir(folder), browser(1000, 2080) as driver:
        Path("data").symlink_to(ROOT / "data")
        for name in ("verdict", "three"):
            Path(f"{name}.yaml").write_text(re.findall(rf"```yaml\n(# {name}.yaml\n.*?)```", text, re.DOTALL)[0])
        line = ["verify", "verdict.yaml", "three.yaml", "-o", "out", "--quiet"]
        cli.main(line, prog_name="lidarcfg", standalone_mode=False)
        driver.get((Path(folder) / "out/verdict.html").as_uri())
        save(Image.open(BytesIO(driver.get_screenshot_as_png())).convert("RGB"), "verdict.png", 128)


def requirements() -> None:
    """Verify the rig of the bus, and photograph the map of the first requirement."""
    with tempfile.TemporaryDirectory() as folder, browser(1000, 1000) as driver:
        line = [
            "verify",
            str(ROOT / "data/studies/bus.yaml"),
            str(ROOT / "data/rigs/bus.yaml"),
            "-o",
            folder,
            "--quiet",
        ]
        cli.main(line, prog_name="lidarcfg", standalone_mode=False)
        driver.get((Path(folder) / "verdict.html").as_uri())
        picture = driver.find_element("css selector", "svg").screenshot_as_png
        save(Image.open(BytesIO(picture)).convert("RGB"), "requirements.png", 64)


def shot(driver: Any) -> Image.Image:
    """What the browser shows."""
    settled(driver)
    return Image.open(BytesIO(driver.get_screenshot_as_png())).convert("RGB")


def save(image: Image.Image, name: str, colours: int = 256) -> None:
    """Write a picture of few colours, which keeps it small."""
    image.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        ROOT / "docs" / name, optimize=True
    )
    print(f"docs/{name}: {(ROOT / 'docs' / name).stat().st_size / 1000:.0f} kB")


def view() -> None:
    """Export what the page of the documentation does, and photograph it."""
    text = (ROOT / "docs/view.md").read_text()
    with tempfile.TemporaryDirectory() as folder, chdir(folder), browser(1280, 1000) as driver:
        Path("out").mkdir()
        Path("curve.yaml").write_text(re.findall(r"```yaml\n(# curve.*?)```", text, re.DOTALL)[0])
        for line in re.findall(r"^lidarcfg (export .*)$", text, re.MULTILINE):
            cli.main(shlex.split(line), prog_name="lidarcfg", standalone_mode=False)
        with served("out/roof.pcap", "out/roof.npz", "data/studies/sedan.yaml") as url:
            opened(driver, url)
            click(driver, "#rings")
            put(driver, "#mount", 0, "change")
            save(shot(driver), "view.png")
        with served("out/curve.pcap") as url:
            opened(driver, url)
            driver.execute_script(FROM)
            pictures = []
            for frame in FRAMES:
                put(driver, "#time", frame)
                pictures.append(np.asarray(shot(driver))[120:720, 180:780])
            save(Image.fromarray(np.concatenate(pictures, axis=1)), "view-drive.png")


if __name__ == "__main__":
    {"report": report, "seen": seen, "verdict": verdict, "requirements": requirements, "view": view}[sys.argv[1]]()
