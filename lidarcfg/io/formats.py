"""The formats: which kinds of input convert to which, and the conversion."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lidarcfg.clouds.cloud import PointCloud, load_cloud, save_clouds
from lidarcfg.config.kinds import YAML_SUFFIXES
from lidarcfg.config.models import Vec3
from lidarcfg.errors import ConfigError, ConversionError
from lidarcfg.files import replacing, replacing_folder
from lidarcfg.io.bag_reader import SUFFIXES, is_bag
from lidarcfg.sensors.rig import load_rig, save_rig
from lidarcfg.world.robot import SUFFIXES as URDF_SUFFIXES

if TYPE_CHECKING:
    from lidarcfg.io.drive_dataset import DriveDataset

Kind = Literal["rig", "kit", "bag", "cloud", "capture", "drive"]
OnWarning = Callable[[str], None]

INPUTS: dict[Kind, tuple[str, ...]] = {
    "rig": YAML_SUFFIXES,
    "kit": (*URDF_SUFFIXES, *YAML_SUFFIXES, ".txt"),
    "bag": SUFFIXES,
    "cloud": (".ply", ".pcd", ".npz", ".las", ".laz", ".bin"),
    "capture": (".pcap", ".pcapng"),
}


@dataclass(frozen=True)
class Format:
    """A format that one kind of input converts to."""

    name: str  # as --to has it
    kind: Kind  # of the input
    suffix: str  # of the output; none: a folder
    lacks: str = ""  # what the input has and this format cannot hold


SELF_FILTERS = ("crop-box", "azimuth-windows")  # of a vehicle's body
RIG = "rig"  # what kits and bags convert to
RIG_SUFFIXES = (".yaml", ".yml")
POSES_ALONE = "beams, network, speed or return mode"
DATASETS = {  # folders of drives, and what they cannot hold
    "kitti-odometry": "ring, time of each point or return type",
    "kitti-object": "ring, time of each point, objects of points or return type",
    "nuscenes": "time of each point, objects of points or return type",
}
FORMATS = (
    Format("urdf", "rig", ".urdf", POSES_ALONE),
    Format("launch", "rig", ".py", POSES_ALONE),
    Format("carla", "rig", ".json", "firing order, network or return mode"),
    Format("nuscenes", "rig", "", POSES_ALONE),
    Format("crop-box", "rig", ".yaml"),
    Format("azimuth-windows", "rig", ".json"),
    Format("rig", "kit", ".yaml"),
    Format("rig", "bag", ".yaml"),
    Format("pcap", "bag", ".pcap"),
    Format("ply", "cloud", ".ply"),
    Format("pcd", "cloud", ".pcd"),
    Format("npz", "cloud", ".npz"),
    Format("las", "cloud", ".las"),
    Format("laz", "cloud", ".laz"),
    Format("kitti", "cloud", ".bin", "ring, time, sensor or return type"),
    Format("rosbag2", "capture", "", "return type"),
    Format("rosbag2-mcap", "capture", "", "return type"),
    Format("mcap", "capture", ".mcap", "return type"),
    Format("rosbag1", "capture", ".bag", "return type"),
    *(Format(name, "capture", "", lost) for name, lost in DATASETS.items()),
    Format("ply", "drive", ".ply"),
    Format("npz", "drive", ".npz"),
    Format("pcd", "drive", ".pcd", "boxes of objects"),
    Format("mcap", "drive", ".mcap"),
    Format("rosbag2", "drive", ""),
    Format("rosbag2-mcap", "drive", ""),
    Format("rosbag1", "drive", ".bag"),
    *(Format(name, "drive", "", lost) for name, lost in DATASETS.items()),
)
CLOUDS = ("ply", "npz", "pcd")
FOLDERS = {  # what stands in those of a drive
    "kitti-odometry": ("sequences", "poses"),
    "kitti-object": ("training",),
    "nuscenes": ("v1.0-lidarcfg", "maps", "samples"),
}
STORAGES = {"rosbag1": "ros1", "rosbag2": "sqlite3", "rosbag2-mcap": "mcap"}


def choose_format(source: Path, output: Path, name: str | None) -> Format:
    """The format called `name`, or the first with OUTPUT's suffix. Raises ConversionError."""
    return format_of(_kind_of(source, output, name), output, name)


def format_of(kind: Kind, output: Path, name: str | None) -> Format:
    """The format for an input of a known kind. Raises ConversionError."""
    formats = [form for form in FORMATS if form.kind == kind]
    if name:
        for form in formats:
            if form.name == name:
                if form.suffix and _suffix(output) != form.suffix:
                    raise ConversionError(f"{output}: does not end in {form.suffix}, as {name} does")
                return form
        allowed = ", ".join(form.name for form in formats)
        raise ConversionError(f"{_failed(kind)} {name}; allowed: {allowed}{_hint(kind)}")
    for form in formats:
        if form.suffix == _suffix(output) and form.name not in SELF_FILTERS:
            return form
    allowed = ", ".join(form.suffix for form in formats if form.suffix and form.name not in SELF_FILTERS)
    folder = ", or a folder, which has no suffix" if any(not form.suffix for form in formats) else ""
    if kind == "drive":
        allowed = f".pcap, {allowed}"
    what = f"{_failed(kind)} {output.name!r}; allowed: {allowed}{folder}; or say which with --to{_hint(kind)}"
    raise ConversionError(what)


def _suffix(output: Path) -> str:
    suffix = output.suffix.lower()
    return RIG_SUFFIXES[0] if suffix in RIG_SUFFIXES else suffix


def _failed(kind: Kind) -> str:
    return "an export is not written as" if kind == "drive" else f"a {kind} does not convert to"


def _hint(kind: Kind) -> str:
    return "; lidarcfg decode turns it into a cloud" if kind == "capture" else ""


def _kind_of(source: Path, output: Path, name: str | None) -> Kind:
    if is_bag(source):
        return "bag"
    if source.suffix.lower() in URDF_SUFFIXES or source.is_dir() or name == RIG:
        return "kit"
    if output.suffix.lower() in RIG_SUFFIXES and source.suffix.lower() in INPUTS["kit"] and name is None:
        return "kit"
    for kind, suffixes in INPUTS.items():
        if source.suffix.lower() in suffixes:
            return kind
    allowed = "; ".join(f"{kind}: {' '.join(suffixes)}" for kind, suffixes in INPUTS.items())
    raise ConversionError(f"{source}: not a rig, a kit, a bag, a cloud or a capture by its suffix; {allowed}")


def convert(
    source: Path, output: Path, form: Format, rig: Path | None, model: str | None, on_warning: OnWarning
) -> str:
    """Write `source` as `output` in the format, whole or not at all, and return what it holds.

    `rig` and `model` are for captures: the sensors' poses, and their model whatever their packets say. `on_warning`
    gets what the format cannot hold. Raises LidarcfgError.
    """
    if form.lacks:
        on_warning(f"{output}: {form.name} has no {form.lacks}")
    if form.kind == "rig":
        return _convert_rig(source, output, form.name, on_warning)
    if form.kind == "bag":
        from lidarcfg.io.packet_bag import save_packets

        return f"{save_packets(output, source, load_rig(rig) if rig else None, on_warning):,} packets"
    if form.kind == "cloud":
        return _convert_cloud(source, output, form.name, on_warning)
    from lidarcfg.io.bag import save_bag, save_mcap

    mounted = load_rig(rig) if rig else None
    if form.name == "mcap":
        count = save_mcap(output, source, mounted, model, on_warning)
    else:
        count = save_bag(output, source, STORAGES[form.name], mounted, model, on_warning)
    return f"{count:,} messages"


@dataclass(frozen=True)
class Amount:
    """How much was written, such as 1,234 points; `what` is the plural."""

    count: int
    what: str

    def __str__(self) -> str:
        what = self.what.removesuffix("s") if self.count == 1 else self.what
        return f"{self.count:,} {what}"


def save_self_filter(source: Path, output: Path, name: str, vehicle: Path | None, on_warning: OnWarning) -> str:
    """Write what cuts the body of a rig's vehicle, or of another, away; whole or not at all. Raises LidarcfgError."""
    from lidarcfg.io.self_filter import azimuth_windows, crop_box
    from lidarcfg.world.vehicle import resolve_vehicle

    rig = load_rig(source)
    bodies = resolve_vehicle(rig, vehicle)
    if bodies is None:
        raise ConversionError(f"{source}: has no vehicle, whose body {name} cuts away; --vehicle gives one")
    text = crop_box(bodies) if name == "crop-box" else azimuth_windows(rig, bodies, on_warning)
    with replacing(output) as file:
        file.write(text)
    return "1 box" if name == "crop-box" else str(Amount(len(rig.mounts), "sensors"))


def import_rig(
    source: Path,
    output: Path,
    models: Mapping[str, str],
    origins_m: Mapping[str, Vec3],
    scene: str | None,
    on_warning: OnWarning,
) -> str:
    """Write the rig of a kit, whole or not at all, and return what it holds.

    `models` and `origins_m` are of the kit's frames, as `rig_of_kit` has them; `scene` is which of nuScenes'.
    `on_warning` gets what was guessed and what was left out. Raises LidarcfgError.
    """
    from lidarcfg.io.rig_importers.importer import read_kit
    from lidarcfg.io.rig_importers.sensor_kit import rig_of_kit
    from lidarcfg.world.vehicle import check_outside, rig_vehicle

    rig = rig_of_kit(read_kit(source, models, scene), models, on_warning, origins_m)
    body = rig_vehicle(rig)
    if body:
        try:
            check_outside(body, rig.mounts)
        except ConfigError as error:
            on_warning(f"{source}: {error}")
    save_rig(rig, output)
    return f"{Amount(len(rig.mounts), 'sensors')}{' and a body' if body else ''}"


def save_dataset(output: Path, form: Format, dataset: "DriveDataset", deskew: bool, on_warning: OnWarning) -> Amount:
    """Write a drive in a format, whole or not at all, and return what it holds. Raises LidarcfgError."""
    if form.lacks:
        on_warning(f"{output}: {form.name} has no {form.lacks}")
    if form.name in CLOUDS:
        from lidarcfg.io.drive_dataset import save_points

        return Amount(save_points(output, dataset, deskew), "points")
    if form.name in FOLDERS:
        from lidarcfg.world.boxes import lack_of_categories

        if said := lack_of_categories(dataset.drive.scene):
            on_warning(said)
        return Amount(_save_folder(output, form.name, dataset), "scans")
    from lidarcfg.io.bag import dataset_messages, write_bag, write_mcap

    made = dataset_messages(dataset, output, on_warning)
    if form.name == "mcap":
        return Amount(write_mcap(output, made), "messages")
    return Amount(write_bag(output, STORAGES[form.name], made), "messages")


def _save_folder(output: Path, name: str, dataset: "DriveDataset") -> int:
    from lidarcfg.io.kitti import save_objects, save_odometry
    from lidarcfg.io.nuscenes import save_tables

    save = {"kitti-odometry": save_odometry, "kitti-object": save_objects, "nuscenes": save_tables}[name]
    with replacing_folder(output, *FOLDERS[name]) as folder:
        folder.mkdir()
        return save(folder, dataset)


def _convert_rig(source: Path, output: Path, name: str, on_warning: OnWarning) -> str:
    from lidarcfg.io.carla import carla
    from lidarcfg.io.launch import launch
    from lidarcfg.io.nuscenes import nuscenes
    from lidarcfg.io.urdf import urdf

    rig = load_rig(source)
    if name == "nuscenes":
        tables = nuscenes(rig)
        with replacing_folder(output, *tables) as folder:
            folder.mkdir()
            for table, text in tables.items():
                (folder / table).write_text(text, encoding="utf-8")
    else:
        text = {"urdf": urdf, "launch": launch, "carla": carla}[name](rig, on_warning)
        with replacing(output) as file:
            file.write(text)
    return str(Amount(len(rig.mounts), "sensors"))


def _convert_cloud(source: Path, output: Path, name: str, on_warning: OnWarning) -> str:
    cloud = _load_cloud(source, on_warning)
    if cloud.object is not None and name in ("las", "laz", "kitti"):
        on_warning(f"{output}: {name} has no objects of points")
    if name in ("las", "laz"):
        from lidarcfg.clouds.las import save_las

        save_las(output, cloud)
    elif name == "kitti":
        from lidarcfg.io.kitti import save_kitti

        save_kitti(output, cloud, on_warning)
    else:
        save_clouds(output, [cloud])
    return f"{len(cloud.xyz):,} points"


def _load_cloud(source: Path, on_warning: OnWarning) -> PointCloud:
    suffix = source.suffix.lower()
    if suffix in (".las", ".laz"):
        from lidarcfg.clouds.las import load_las

        return load_las(source, on_warning)
    if suffix == ".bin":
        from lidarcfg.io.kitti import load_kitti

        return load_kitti(source, on_warning)
    return load_cloud(source, on_warning, allow_empty=True)
