"""Does LiDAR odometry track a drive that was simulated? KISS-ICP on its exported bag, against the drive's ground truth.

Usage: .venv/bin/python tools/validate_odometry.py [NAME …]      (needs kiss-icp; takes some minutes)

Each drive is exported as a capture and converted to a ROS 2 bag, as one would by hand, and every scan of the bag is
given to KISS-ICP (Vizzo and others, 2023) with the settings that it has for 100 m. The table and a picture go to
docs/validation.md.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from page import ROOT, table, write_section

import lidarcfg
from lidarcfg.cli import cli
from lidarcfg.geometry import Array, pose
from lidarcfg.report import new_figure, save_figure
from lidarcfg.rig import load_rig
from lidarcfg.simulate.tasks import START_NS
from lidarcfg.world.motion import Trajectory, load_path

AXES_IN, BELOW_IN, LABELS_IN, LEAST = (
    8.4,
    2.4,
    0.6,
    0.1,
)  # of the picture: axes, those of errors, and what is beside them
RANGE_M = 100.0  # of KISS-ICP; its voxels are a hundredth
SUBURB = ROOT / "data/scenes/suburb.yaml", ROOT / "data/trajectories/suburb.tum"
ALONE = "name: {0}\nsensors:\n  - {{name: {0}, model: {0}, position_m: [0.3, 0, 1.9]}}\n"


@dataclass(frozen=True)
class Drive:
    """What is exported, and which sensor's scans odometry gets."""

    title: str
    sensor: str  # the mount's name; alone on the roof unless a rig is named
    seconds: float = 60.0
    rig: Path | None = None
    scene: Path = SUBURB[0]
    trajectory: Path | None = SUBURB[1]  # None: straight on at 10 m/s
    at: str = "0,0,0"


DRIVES = {
    "vlp-16": Drive("suburb, a VLP-16 on the roof", "vlp-16"),
    "os1-64": Drive("suburb, an OS1-64 on the roof", "os1-64"),
    "roof": Drive("suburb, the left sensor of data/rigs/roof.yaml, tilted", "left", rig=ROOT / "data/rigs/roof.yaml"),
    "street": Drive(
        "flat street, a VLP-16 straight on at 10 m/s",
        "vlp-16",
        5.5,
        None,
        ROOT / "data/scenes/street.yaml",
        None,
        "-27,0,0",
    ),
}


@dataclass(frozen=True)
class Track:
    """Where a sensor was at the end of each of N scans, and where odometry has it; relative to the first scan."""

    truth: Array  # (N, 4, 4)
    found: Array  # (N, 4, 4)

    @property
    def along_m(self) -> Array:
        """(N,) how far it has come."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.truth[:, :3, 3], axis=0), axis=1))])

    @property
    def error_m(self) -> Array:
        """(N,) how far apart the two are, with nothing aligned but the first scan."""
        return np.asarray(np.linalg.norm(self.truth[:, :3, 3] - self.found[:, :3, 3], axis=1))

    @property
    def turned_deg(self) -> float:
        """The angle between the two at the end."""
        R = self.truth[-1, :3, :3].T @ self.found[-1, :3, :3]
        return float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))


def saved(drive: Drive, file: Path) -> Track:
    """The track of a drive, from a file that was left there; else computed, and written there."""
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=file.parent) as folder:
            track = run(drive, Path(folder))
        np.savez(file, truth=track.truth, found=track.found)
    with np.load(file) as arrays:
        return Track(arrays["truth"], arrays["found"])


def run(drive: Drive, folder: Path) -> Track:
    """Export, convert, and track a drive; capture and bag are in a folder."""
    rig, trajectory = drive.rig or folder / "rig.yaml", drive.trajectory or folder / "straight.yaml"
    if not drive.rig:
        rig.write_text(ALONE.format(drive.sensor))
    if not drive.trajectory:
        trajectory.write_text("velocity_m_s: [10, 0, 0]\n")
    capture, bag = folder / "drive.pcap", folder / "drive"
    where = ["--scene", drive.scene, "--trajectory", trajectory, f"--at={drive.at}", "--duration", drive.seconds]
    _command("export", rig, *where, "-o", capture)
    _command("convert", capture, "--rig", rig, "-o", bag)
    mount = next(mount for mount in load_rig(rig).mounts if mount.name == drive.sensor)
    x, y, yaw = map(float, drive.at.split(","))
    path = Trajectory(pose((x, y, 0.0), (0.0, 0.0, np.radians(yaw))), load_path(trajectory), START_NS)
    ends_ns, found = odometry(bag, drive.sensor)
    truth = np.array([path.pose(int(end_ns)) @ mount.T_vehicle_sensor for end_ns in ends_ns])
    return Track(np.linalg.inv(truth[0]) @ truth, np.linalg.inv(found[0]) @ found)


def _command(*words: object) -> None:
    """Run a command."""
    cli.main([*map(str, words), "--quiet"], standalone_mode=False)


def odometry(bag: Path, sensor: str) -> tuple[NDArray[np.int64], Array]:
    """When the scans of a sensor in a bag end, and where KISS-ICP has it then, (N, 4, 4)."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.config.config import DataConfig, MappingConfig
    from kiss_icp.kiss_icp import KissICP

    settings = KISSConfig(data=DataConfig(max_range=RANGE_M), mapping=MappingConfig(voxel_size=RANGE_M / 100))
    estimate, ends_ns, poses = KissICP(settings), [], []
    for end_ns, points, times in scans(bag, sensor):
        estimate.register_frame(points, times)
        ends_ns.append(end_ns)
        poses.append(estimate.last_pose.copy())
    return np.array(ends_ns), np.array(poses)


def scans(bag: Path, sensor: str) -> Iterator[tuple[int, Array, Array]]:
    """The scans of a sensor in a bag as KISS-ICP's own reader reads them: when they end, points and their times."""
    from kiss_icp.tools.point_cloud2 import read_point_cloud
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as reader:
        topic = next(one for one in reader.connections if one.topic == f"/{sensor.replace('-', '_')}/points")
        for connection, end_ns, raw in reader.messages([topic]):
            points, times = read_point_cloud(reader.deserialize(raw, connection.msgtype))
            yield end_ns, points, times


def row(drive: Drive, track: Track) -> list[str]:
    """What a table says of a track."""
    from kiss_icp.metrics import absolute_trajectory_error, sequence_error

    way, end = float(track.along_m[-1]), float(track.error_m[-1])
    drift, spin = sequence_error(track.truth, track.found)  # KITTI's: over stretches of 100, 200 … 800 m
    _, moved = absolute_trajectory_error(track.truth, track.found)
    kitti = [f"{drift:.2f} %", f"{spin * 100:.2f}°"] if way > 100 else ["–", "–"]
    return [
        drive.title,
        f"{len(track.truth)}",
        f"{way:.0f} m",
        f"{end:.2f} m ({end / way:.2%})",
        f"{track.error_m.max():.2f} m",
        f"{track.turned_deg:.2f}°",
        *kitti,
        f"{moved:.2f} m",
    ]


HEADER = (
    *("drive", "scans", "way", "error at its end", "largest error", "turned at its end"),
    *("KITTI drift", "KITTI rotation in 100 m", "error, best aligned"),
)


def draw(tracks: dict[str, Track], path: Path) -> None:
    """The tracks from above, and their errors along the way."""
    longest = max(tracks.values(), key=lambda track: float(track.along_m[-1]))
    across_m, up_m = 1.1 * np.ptp(longest.truth[:, :2, 3], axis=0)  # matplotlib leaves a twentieth at each side
    heights = AXES_IN * max(up_m / across_m, LEAST), BELOW_IN
    figure = new_figure(AXES_IN + LABELS_IN, sum(heights) + 2 * LABELS_IN)
    above, below = figure.subplots(2, 1, height_ratios=heights)
    above.plot(*longest.truth[:, :2, 3].T, color="0.75", linewidth=5, label="ground truth")
    for name, track in tracks.items():
        if track.along_m[-1] > longest.along_m[-1] / 2 and DRIVES[name].rig is None:
            above.plot(*track.found[:, :2, 3].T, linewidth=1.2, label=f"KISS-ICP, {name}")
        below.plot(track.along_m, track.error_m, label=DRIVES[name].title)
    above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    above.legend()
    way = np.linspace(0, longest.along_m[-1], 2)
    below.plot(way, 0.01 * way, "k:", linewidth=1, label="1 % of the way")
    below.set(xlabel="way [m]", ylabel="error [m]", ylim=(0, 2 * float(way[1]) / 100))
    below.legend(fontsize=8)
    save_figure(figure, path)


def main() -> None:
    """Runs the drives, and writes the table and the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(DRIVES), metavar="NAME", help=", ".join(DRIVES))
    parser.add_argument("--results", type=Path, default=ROOT / "out/odometry", help="drives found here are not run")
    parser.add_argument("--page", type=Path, default=ROOT / "docs/validation.md", help="with the section's markers")
    parser.add_argument("--plot", type=Path, default=ROOT / "docs/validation/odometry.png")
    given = parser.parse_args()
    if odd := [name for name in given.names if name not in DRIVES]:
        parser.error(f"no drive is called {odd[0]!r}; allowed: {', '.join(DRIVES)}")
    tracks = {name: saved(DRIVES[name], given.results / f"{name}.npz") for name in given.names}
    when = f"{time.strftime('%Y-%m-%d')}, lidarcfg {lidarcfg.__version__}."
    lines = table(HEADER, [row(DRIVES[name], track) for name, track in tracks.items()])
    write_section("odometry", [when, "", *lines], given.page)
    draw(tracks, given.plot)


if __name__ == "__main__":
    main()
