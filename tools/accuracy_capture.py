"""Decoded points beside the truth: firing times and angles by the manual's numbers, ranges by closed forms."""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from accuracy_rays import exact_ranges
from page import ROOT, table

from lidarcfg.capture.decode import decode_pcap
from lidarcfg.capture.pcap import write_pcap
from lidarcfg.cloud import PointCloud, concatenate
from lidarcfg.geometry import Array, directions, inverse, pose, transform
from lidarcfg.packets.velodyne.model import unit
from lidarcfg.report import COLOURS, new_figure, save_figure
from lidarcfg.rig import Rig, load_rig
from lidarcfg.simulate.export import export, in_time_order
from lidarcfg.simulate.tasks import START_NS
from lidarcfg.world.scene import Scene, load_scene

STREET = ROOT / "data/scenes/street.yaml"
FAR_M = (1e7, -1e7)
OTHER_SURFACE_M = 0.02  # further off, a ray has hit something else: it passed an edge within rounding
SEQUENCES, LASERS, BLOCK = 24, 16, 2  # of a VLP-16 packet; sequences in a block
BOUNDS = {"range, flat objects (mm)": 1.0, "range, round objects (mm)": 1.0, "azimuth (°)": 0.005, "time (µs)": 1.0}


@dataclass(frozen=True)
class Errors:
    """Of one capture's decoded points, against what each firing should have given."""

    by_quantity: dict[str, Array]
    last_block_deg: float  # the worst azimuth in the last block, after which there is no packet to interpolate to
    others: int  # hit another surface
    missing: int
    extra: int


def moved(path: Path, east_m: float, north_m: float) -> Scene:
    """A scene's file with everything in it moved."""
    file = yaml.safe_load(path.read_text())
    for kind in ("boxes", "spheres", "cylinders", "planes", "meshes"):
        for item in file[kind]:
            (key,) = item.keys() & {"center_m", "base_m", "position_m"}
            item[key] = [item[key][0] + east_m, item[key][1] + north_m, item[key][2]]
            if "file" in item:
                item["file"] = str(path.parent / item["file"])
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "scene.yaml").write_text(yaml.safe_dump(file))
        return load_scene(Path(folder) / "scene.yaml")


def capture(rig: Rig, scene: Scene, T_world_vehicle: Array, duration_ns: int) -> tuple[PointCloud, float, float]:
    """The decoded points in the vehicle frame, and the seconds that writing and reading took."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pcap"
        started = time.perf_counter()
        write_pcap(path, in_time_order(export(rig, scene, T_world_vehicle, duration_ns)))
        written = time.perf_counter()
        cloud = concatenate(list(decode_pcap(path, print, rig=rig)))
        return cloud, written - started, time.perf_counter() - written


def measure(rig: Rig, near: Scene, scene: Scene, east_north_m: tuple[float, float], duration_ns: int) -> Errors:
    """A rig of one VLP-16 in `scene`, which is `near` moved to (east, north)."""
    (mount,) = rig.mounts
    sensor = mount.sensor
    facts = unit(sensor).firing
    cloud, _, _ = capture(rig, scene, pose((*east_north_m, 0.0), (0.0, 0.0, 0.0)), duration_ns)
    packets = duration_ns // (SEQUENCES * facts.sequence_ns)
    fired_ns = np.arange(packets * SEQUENCES)[:, None] * facts.sequence_ns + np.array(facts.offset_ns)
    azimuth = (fired_ns * mount.rpm / 60e9 % 1.0) * 2 * np.pi
    rays = directions(azimuth, sensor.elevation_rad).reshape(-1, 3)
    starts = np.tile(np.column_stack([np.zeros((LASERS, 2)), sensor.vertical_offset_m]), (len(fired_ns), 1))
    T = mount.T_vehicle_sensor
    ranges, is_round = exact_ranges(near, transform(T, starts), rays @ T[:3, :3].T)

    laser = np.argsort(sensor.ring)[cloud.ring]
    into_ns = cloud.time_ns - START_NS - np.array(facts.offset_ns)[laser]
    firing = np.rint(into_ns / facts.sequence_ns).astype(np.int64) * LASERS + laser
    xyz = transform(inverse(T), cloud.xyz)
    beam = xyz - starts[firing]
    range_m = np.linalg.norm(beam, axis=1)
    bearing_deg = np.degrees(np.arctan2(-beam[:, 1], beam[:, 0]) - azimuth.ravel()[firing] + np.pi) % 360 - 180
    range_mm = 1000 * abs(range_m - ranges[firing])
    other = ~(range_mm < 1000 * OTHER_SURFACE_M)
    last = firing >= (len(fired_ns) - BLOCK) * LASERS
    off_mm = 1000 * np.linalg.norm(
        xyz - (starts + np.where(np.isfinite(ranges), ranges, 0)[:, None] * rays)[firing], axis=1
    )
    assert sensor.range
    least_m, most_m = sensor.range.reported_m
    due = (ranges >= least_m) & (ranges <= most_m)
    decoded = np.zeros(len(ranges), bool)
    decoded[firing] = True
    return Errors(
        {
            "range, flat objects (mm)": range_mm[~other & ~is_round[firing]],
            "range, round objects (mm)": range_mm[~other & is_round[firing]],
            "azimuth (°)": abs(bearing_deg[~last]),
            "time (µs)": abs(cloud.time_ns - START_NS - fired_ns.ravel()[firing]) / 1000,
            "xyz (mm)": off_mm[~other & ~last],
        },
        float(abs(bearing_deg[last]).max()),
        int(other.sum()),
        int((due & ~decoded).sum()),
        int((decoded & ~due).sum()),
    )


def run(quick: bool, plots: Path) -> list[str]:
    """The section's lines; draws capture.png."""
    duration_ns = 20_000_000 if quick else 400_000_000
    roof = load_rig(ROOT / "data/rigs/roof.yaml")
    near, far = load_scene(STREET), moved(STREET, *FAR_M)
    one = replace(roof, mounts=roof.mounts[:1])
    cases = {
        f"{rpm:.0f} rpm{', 1e7 m from the origin' if at[0] else ''}": measure(
            replace(one, mounts=(replace(one.mounts[0], rpm=rpm),)), near, scene, at, duration_ns
        )
        for rpm, at, scene in (
            (300.0, (0.0, 0.0), near),
            (600.0, (0.0, 0.0), near),
            (1200.0, (0.0, 0.0), near),
            (600.0, FAR_M, far),
        )
    }
    rows = []
    for quantity in cases["600 rpm"].by_quantity:
        for case, errors in cases.items():
            values = errors.by_quantity[quantity]
            median, most = np.quantile(values, (0.5, 0.999))
            bound = f"{BOUNDS[quantity]:g}" if BOUNDS.get(quantity) else "–"
            rows.append((quantity, case, f"{median:.4g}", f"{most:.4g}", f"{values.max():.4g}", bound))
    figure = new_figure(9, 6)
    for axes, quantity in zip(
        figure.subplots(2, 2).flat, ("range, flat objects (mm)", "azimuth (°)", "time (µs)", "xyz (mm)"), strict=True
    ):
        for (case, errors), colour in zip(cases.items(), COLOURS, strict=False):
            values = np.sort(errors.by_quantity[quantity])
            axes.plot(values, np.linspace(100, 100 / len(values), len(values)), color=colour, label=case)
        if BOUNDS.get(quantity):
            axes.axvline(BOUNDS[quantity], color="0.4", ls=":", label="bound")
        axes.set(xlabel=f"error of {quantity}", ylabel="returns further off (%)", yscale="log")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    save_figure(figure, plots / "capture.png")
    counts = [
        (case, f"{len(e.by_quantity['time (µs)']):,}", e.others, e.missing, e.extra, f"{e.last_block_deg:.4f}")
        for case, e in cases.items()
    ]
    speed_ns = 100_000_000 if quick else 4_000_000_000
    cloud, writing, reading = capture(roof, near, np.eye(4), speed_ns)
    packets = 2 * (speed_ns // 1_327_104)
    return [
        *table(("error of", "case", "median", "99.9 %", "worst", "bound"), rows),
        "",
        *table(
            ("case", "returns", "of another surface", "missing", "extra", "worst azimuth in the last block (°)"), counts
        ),
        "",
        f"Two VLP-16 in the street for {speed_ns / 1e9:g} s, {len(cloud.xyz):,} points: written at "
        f"{packets / writing:,.0f} packets/s ({speed_ns / 1e9 / writing:.1f} times as fast as they come), read at "
        f"{packets / reading:,.0f} packets/s ({speed_ns / 1e9 / reading:.1f} times).",
    ]
