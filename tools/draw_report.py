"""Draw docs/report.png: two parts of the report that the first command of docs/report.md writes, in a browser.

Usage: .venv/bin/python tools/draw_report.py
"""

import sys
import tempfile
from io import BytesIO
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from lidarcfg.cli import cli
from tests.chromium import browser

WIDTH, HEIGHT = 700, 1300
PARTS = "document.body", "document.querySelector('#blind')"  # what stands at the top of each


def main() -> None:
    """Place the sedan's sensors, and photograph the report."""
    with tempfile.TemporaryDirectory() as folder, browser(WIDTH, HEIGHT) as driver:
        line = ["optimize", str(ROOT / "data/studies/sedan.yaml"), "-o", folder, "--evaluations", "4000", "--quiet"]
        cli.main(line, prog_name="lidarcfg", standalone_mode=False)
        driver.get((Path(folder) / "report.html").as_uri())
        parts = []
        for part in PARTS:
            driver.execute_script(f"{part}.scrollIntoView()")
            parts.append(Image.open(BytesIO(driver.get_screenshot_as_png())).convert("RGB"))
    picture = Image.new("RGB", (sum(part.width for part in parts), parts[0].height))
    for i, part in enumerate(parts):
        picture.paste(part, (i * part.width, 0))
    path = ROOT / "docs/report.png"
    picture.quantize(64, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"docs/report.png: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
