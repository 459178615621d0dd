#!/usr/bin/env python3
"""Make the tables of Seyond's sensors in sensors/: scan patterns, and where beams start.

    python tools/make_seyond_tables.py SDK

SDK is a copy of Seyond-Inc/inno-lidar-sdk (BSD, 3.103.4), whose nps_adjustment.h and robin_nps_adjustment.h say where
beams start; they are rounded as it rounds them. Scan patterns are not public. They are made here of what the SDK says,
docs/seyond.md has how. Angles are whole units of the packets, which 32-bit floats hold exactly in degrees.
"""

import re
from pathlib import Path

import numpy as np
from page import argument

FOLDER = Path(__file__).parent.parent / "sensors"
HALF_TURN = 32768  # units of angles
FRAME_NS = 100_000_000
FALCON_LINES = 36  # of a frame, each of four channels
FALCON_COLUMNS = 973  # of a line
FALCON_STEP = 112  # units from a line to the next: channels are 196 apart, so that all are 28 apart
FALCON_SPACING = 196  # units from a channel to the next
FALCON_LIVE = 120 / 144  # of a line's time: a polygon with five facets sweeps 144 degrees
ROBIN_FACETS = 4  # of the polygon, one after another in a frame
ROBIN_COLUMNS = 640
ROBIN_SETS = 6  # of eight receivers, one after another in a column
ROBIN_STEP = 17  # units that the polygon turns in a column; beams turn twice as far
ROBIN_LINE = 66  # units from a line to the next
NOTICE = """seyond-starts.npz is made by tools/make_seyond_tables.py from src/sdk_common/nps_adjustment.h and
robin_nps_adjustment.h of Seyond-Inc/inno-lidar-sdk 3.103.4. Its licence:

"""


def save(name: str, time_ns: np.ndarray, azimuth: np.ndarray, elevation: np.ndarray) -> None:
    """Write a pattern of blocks (B, channels) with times (B,) and angles in units."""
    np.savez_compressed(
        FOLDER / f"{name}.npz",
        time_ns=np.repeat(np.rint(time_ns), azimuth.shape[1]).astype(np.int32),
        azimuth_deg=(azimuth * (180 / HALF_TURN)).astype(np.float32).ravel(),
        elevation_deg=(elevation * (180 / HALF_TURN)).astype(np.float32).ravel(),
        channel=np.tile(np.arange(azimuth.shape[1], dtype=np.uint8), len(azimuth)),
    )


def falcon() -> None:
    """Lines from the left to the right, from the top down."""
    line, column = np.divmod(np.arange(FALCON_LINES * FALCON_COLUMNS), FALCON_COLUMNS)
    time_ns = (line + column / FALCON_COLUMNS * FALCON_LIVE) * (FRAME_NS / FALCON_LINES)
    azimuth = np.rint((column + 0.5) / FALCON_COLUMNS * (120 / 180 * HALF_TURN) - 60 / 180 * HALF_TURN)
    height = FALCON_STEP * (FALCON_LINES - 1) + FALCON_SPACING * 3
    elevation = height // 2 - FALCON_SPACING * 3 - FALCON_STEP * line
    channels = np.arange(4) * FALCON_SPACING
    save("falcon-k", time_ns, np.repeat(azimuth[:, None], 4, axis=1), elevation[:, None] + channels)


def robin() -> None:
    """Facets from the top down, each with lines that the sets fire in turn while the polygon turns."""
    facet, rest = np.divmod(np.arange(ROBIN_FACETS * ROBIN_COLUMNS * ROBIN_SETS), ROBIN_COLUMNS * ROBIN_SETS)
    column, which = np.divmod(rest, ROBIN_SETS)
    turned = ROBIN_STEP * (column + which / ROBIN_SETS)
    time_ns = (facet + turned / (HALF_TURN / 2)) * (FRAME_NS / ROBIN_FACETS)
    polygon = np.floor(turned) - ROBIN_STEP * ROBIN_COLUMNS // 2
    receiver = which[:, None] * 8 + np.arange(8)
    line = receiver % 12 * 4 + receiver // 12 + 48 * facet[:, None]
    elevation = ROBIN_LINE * 191 // 2 - ROBIN_LINE * line
    save("robin-w", time_ns, np.repeat(2 * polygon[:, None], 8, axis=1), elevation)


def numbers(path: Path, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """The table with this name in a header, in metres or millimetres."""
    text = re.sub(r"//.*", "", path.read_text())
    text = text[text.index(f" {name}[") :]
    text = text[text.index("=") : text.index(";")]
    return np.array(re.findall(r"-?\d+\.\d+", text), np.float64).reshape(shape)


def starts(sdk: Path) -> None:
    """Write where beams start, in whole steps of 2.5 mm and 1 mm."""
    common = sdk / "src" / "sdk_common"
    falcon_m = numbers(common / "nps_adjustment.h", "kInnoPs2Nps", (2, 4, 13, 45))
    robin_mm = numbers(common / "robin_nps_adjustment.h", "robinW_kInnoPs2Nps", (3, 192, 55))
    np.savez_compressed(
        FOLDER / "seyond-starts.npz",
        falcon=np.floor(falcon_m / 0.0025 + 0.5).astype(np.int8).transpose(2, 3, 1, 0),
        robin_w=np.floor(robin_mm * 0.001 / 0.001 + 0.5).astype(np.int8).transpose(1, 2, 0),
    )
    (FOLDER / "seyond-starts.txt").write_text(NOTICE + (sdk / "LICENSE").read_text())


if __name__ == "__main__":
    falcon()
    robin()
    starts(argument(__doc__, Path, Path("inno-lidar-sdk")))
