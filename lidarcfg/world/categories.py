"""The categories of objects, and their names in data sets."""

from typing import Literal, NamedTuple

Category = Literal[
    "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "other_vehicle", "other_object",
    "ground", "road", "parking", "sidewalk", "building", "fence", "vegetation", "trunk", "terrain", "pole",
    "traffic_sign",
]  # fmt: skip


class DatasetNames(NamedTuple):
    """The names of a category in data sets."""

    label: int  # SemanticKITTI's (semantic-kitti.yaml)
    moving: int  # the same of a dynamic object
    kitti: str = ""  # the type of a KITTI object label; none: it has no box
    nuscenes: str = ""  # nuScenes' category; ours where that has none


DATASET_NAMES: dict[str | None, DatasetNames] = {
    None: DatasetNames(0, 0, "Misc", "unknown"),
    "car": DatasetNames(10, 252, "Car", "vehicle.car"),
    "truck": DatasetNames(18, 258, "Truck", "vehicle.truck"),
    "bus": DatasetNames(13, 257, "Misc", "vehicle.bus.rigid"),
    "trailer": DatasetNames(20, 259, "Misc", "vehicle.trailer"),
    "motorcycle": DatasetNames(15, 255, "Cyclist", "vehicle.motorcycle"),
    "bicycle": DatasetNames(11, 253, "Cyclist", "vehicle.bicycle"),
    "pedestrian": DatasetNames(30, 254, "Pedestrian", "human.pedestrian.adult"),
    "other_vehicle": DatasetNames(20, 259, "Misc", "vehicle.construction"),
    "other_object": DatasetNames(99, 99, "Misc", "movable_object.debris"),
    "ground": DatasetNames(49, 49),
    "road": DatasetNames(40, 40),
    "parking": DatasetNames(44, 44),
    "sidewalk": DatasetNames(48, 48),
    "building": DatasetNames(50, 50),
    "fence": DatasetNames(51, 51),
    "vegetation": DatasetNames(70, 70),
    "trunk": DatasetNames(71, 71),
    "terrain": DatasetNames(72, 72),
    "pole": DatasetNames(80, 80),
    "traffic_sign": DatasetNames(81, 81),
}
OUTLIER = 1  # SemanticKITTI's label of rain and fog
