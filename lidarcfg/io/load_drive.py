"""Exported captures as drives: scans from the packets, with their ground truth."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from lidarcfg.capture.objects import GroundTruth
from lidarcfg.capture.scans import scans
from lidarcfg.clouds.cloud import PointCloud
from lidarcfg.errors import CloudError, PacketError
from lidarcfg.io.drive_dataset import DriveDataset
from lidarcfg.simulate.tasks import Drive, object_names

OnWarning = Callable[[str], None]


def load_drive(
    capture: Path, drive: Drive, truth: Path | None, model: str | None, on_warning: OnWarning
) -> DriveDataset:
    """The capture of a drive, with the objects of its points by the export's ground truth.

    Raises CloudError for ground truth of another scene; reading scans raises CloudError for that of another capture,
    and PacketError if there is no return.
    """
    known = GroundTruth.read(truth, drive.rig) if truth else None
    if known and known.names != object_names(drive.scene, drive.vehicle):
        raise CloudError(
            f"{known.path}: its objects are not those of {drive.scene.file.name!r}; it is of another export"
        )
    made = DriveDataset(drive, (), packets=True)
    if made.objects and not known:
        on_warning(f"{capture}: no --truth says which objects were hit; boxes are of all, at the stamp of each scan")

    def found() -> Iterator[PointCloud]:
        seen: set[str] = set()
        for scan in scans(capture, on_warning, drive.rig, model, driver=True):
            seen.update(scan.sensor_names)
            yield replace(scan, object=known.objects(scan), object_names=known.names) if known else scan
        if not seen:
            raise PacketError(f"{capture}: has no returns to convert")
        if absent := [mount.name for mount in drive.rig.mounts if mount.name not in seen]:
            on_warning(f"{capture}: has no returns from {', '.join(absent)}")

    return replace(made, scans=found())
