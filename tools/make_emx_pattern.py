#!/usr/bin/env python3
"""Make the scan pattern of RoboSense's EMX, sensors/emx.npz, from its manual's figures.

    python tools/make_emx_pattern.py

Manual V1.0.9 (RoboSense-Robotics/product-manual, docs/EMX_CN.md at 49086c4): 10 frames a second of 1,520 columns, 0.08
degrees apart, of 192 pixels each from -12.08 degrees on; a clockwise surface of the mirror and an anti-clockwise one.
Spacing of pixels: rs_driver 1.5.19, decoder_RSEMX.hpp, 0.105 degrees. Guesses: columns are centred ahead and evenly
spaced in time, all pixels of one are measured at once, and frames of the two surfaces take turns. Azimuths are in the
packets' unit, 1/512 degree.
"""

from pathlib import Path

import numpy as np

FILE = Path(__file__).parent.parent / "sensors/emx.npz"
FRAME_NS = 100_000_000
COLUMNS = 1520
STEP_DEG = 0.08
UNITS = 512  # of azimuth, in a degree
ROWS = 192


def make(file: Path) -> None:
    """Write two frames: clockwise, then back."""
    column = np.arange(COLUMNS)
    azimuth_deg = np.rint((column - (COLUMNS - 1) / 2) * STEP_DEG * UNITS) / UNITS
    time_ns = np.rint(column * (FRAME_NS / COLUMNS)).astype(np.int64)
    row = np.arange(ROWS)
    np.savez_compressed(
        file,
        time_ns=np.repeat(np.concatenate([time_ns, FRAME_NS + time_ns]), ROWS),
        azimuth_deg=np.repeat(np.concatenate([azimuth_deg, azimuth_deg[::-1]]), ROWS),
        elevation_deg=np.tile((row * 21 - 2416) / 200, 2 * COLUMNS),
        channel=np.tile(row.astype(np.uint8), 2 * COLUMNS),
    )


if __name__ == "__main__":
    make(FILE)
