"""The categories of objects, and their names in data sets."""

from typing import Literal, NamedTuple

Category = Literal[
    "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "other_vehicle", "other_object",
    "ground", "road", "parking", "sidewalk", "building", "fence", "vegetation", "trunk", "terrain", "pole",
    "traffic_sign",
]  # fmt: skip


class Names(NamedTuple):
    """The names of a category in data sets."""

    label: int  # SemanticKITTI's (semantic-kitti.yaml)
    moving: int  # the same of a dynamic object
    kitti: str = ""  # the type of a KITTI object label; none: it has no box
    nuscenes: str = ""  # nuScenes' category; ours where that has none


NAMES: dict[str | None, Names] = {
    None: Names(0, 0, "Misc", "unknown"),
    "car": Names(10, 252, "Car", "vehicle.car"),
    "truck": Names(18, 258, "Truck", "vehicle.truck"),
    "bus": Names(13, 257, "Misc", "vehicle.bus.rigid"),
    "trailer": Names(20, 259, "Misc", "vehicle.trailer"),
    "motorcycle": Names(15, 255, "Cyclist", "vehicle.motorcycle"),
    "bicycle": Names(11, 253, "Cyclist", "vehicle.bicycle"),
    "pedestrian": Names(30, 254, "Pedestrian", "human.pedestrian.adult"),
    "other_vehicle": Names(20, 259, "Misc", "vehicle.construction"),
    "other_object": Names(99, 99, "Misc", "movable_object.debris"),
    "ground": Names(49, 49),
    "road": Names(40, 40),
    "parking": Names(44, 44),
    "sidewalk": Names(48, 48),
    "building": Names(50, 50),
    "fence": Names(51, 51),
    "vegetation": Names(70, 70),
    "trunk": Names(71, 71),
    "terrain": Names(72, 72),
    "pole": Names(80, 80),
    "traffic_sign": Names(81, 81),
}
OUTLIER = 1  # SemanticKITTI's label of rain and fog
