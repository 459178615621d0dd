#!/usr/bin/env python3
"""Make the scan patterns of Livox's sensors, sensors/*.npz, from the tables in the wheel of mujoco-lidar 0.3.5.

    pip download --no-deps mujoco-lidar==0.3.5
    python tools/make_livox_patterns.py [WHEEL]

A table has azimuth, counter-clockwise, and elevation of each firing, in radians; the lasers fire in turn. What is kept:
the whole Mid-360, 4 s, and of the HAP, whose table is cut off after 1,048,575 rows, the whole frames that a packet's
order of lasers lasts through. Angles are rounded to 0.01 degrees, at most 0.005 off; the sensors' own are right to 0.1
and 0.15. A file holds, for each laser, what it turns from one firing to the next, which packs four times as well.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from page import argument

FOLDER = Path(__file__).parent.parent / "sensors"
WHEEL = Path("mujoco_lidar-0.3.5-py3-none-any.whl")
FRAME_S = 0.1
HUNDREDTHS = 36000  # of a degree, all around


@dataclass(frozen=True)
class Model:
    """A sensor whose pattern is in the wheel."""

    table: str
    lasers: int  # livox_ros_driver2, src/comm/comm.h: kLineNumberMid360, kLineNumberHAP
    rate_hz: int  # of firings: the maker's points a second


MODELS = {"mid-360": Model("mid360", 4, 200_000), "hap": Model("HAP", 6, 452_000)}


def kept(table: np.ndarray, model: Model) -> np.ndarray:
    """The rows of whole frames, as many as end with the last laser."""
    frame = round(model.rate_hz * FRAME_S)
    frames = len(table) // frame
    while frames * frame % model.lasers:
        frames -= 1
    return table[: frames * frame]


def steps(angle_rad: np.ndarray, lasers: int) -> np.ndarray:
    """(lasers, firings of each) hundredths of a degree from one firing to the next; the first from 0."""
    hundredths = np.rint(np.degrees(angle_rad.astype(np.float64)) * 100).astype(np.int64).reshape(-1, lasers).T
    half = HUNDREDTHS // 2
    turned = (np.diff(hundredths, axis=1, prepend=0) + half) % HUNDREDTHS - half
    return np.ascontiguousarray(turned, np.int16)


def make(wheel: Path, folder: Path) -> None:
    """Write the patterns and the licence of the tables."""
    with zipfile.ZipFile(wheel) as archive:
        for name, model in MODELS.items():
            table = np.load(io.BytesIO(archive.read(f"mujoco_lidar/scan_mode/{model.table}.npy")))
            azimuth, elevation = kept(table, model).T
            path = folder / f"{name}.npz"
            np.savez_compressed(
                path,
                rate_hz=np.array(model.rate_hz),
                azimuth_steps=steps(-azimuth, model.lasers),  # clockwise
                elevation_steps=steps(elevation, model.lasers),
            )
            print(f"{path}: {len(azimuth):,} firings, {path.stat().st_size:,} bytes")
        licence = next(one for one in archive.namelist() if one.endswith("/LICENSE"))
        about = (
            "mid-360.npz and hap.npz are made by tools/make_livox_patterns.py from scan_mode/mid360.npy and\n"
            "scan_mode/HAP.npy of mujoco-lidar 0.3.5, https://pypi.org/project/mujoco-lidar/0.3.5/. Its licence:\n"
        )
        (folder / "livox-patterns.txt").write_text(f"{about}\n{archive.read(licence).decode()}", "utf-8")


if __name__ == "__main__":
    make(argument(__doc__, Path, WHEEL), FOLDER)
