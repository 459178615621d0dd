"""The keys of a scene's file: its objects and their categories, the ground, the weather."""

from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field, model_validator

from lidarcfg.config.models import (
    COORDINATE_MAX_M,
    FileName,
    Metres,
    Model,
    Name,
    Position,
    Positive,
    Vec3,
    validation_error,
)
from lidarcfg.sensors.sensor import Byte
from lidarcfg.world.geodesy import GeoOrigin
from lidarcfg.world.mesh_source import MeshSource
from lidarcfg.world.motion import Motion

Category = Literal[
    "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian", "other_vehicle", "other_object",
    "ground", "road", "parking", "sidewalk", "building", "fence", "vegetation", "trunk", "terrain", "pole",
    "traffic_sign",
]  # fmt: skip
OUTLIER = 1  # SemanticKITTI's label of rain and fog
GROUND = "ground"
KINDS = ("boxes", "spheres", "cylinders", "planes", "meshes")  # of objects, of a scene and of a vehicle
FILES = ("meshes", "height_fields", "models", "surfels")  # of a scene, whose triangles are made from files
Size = Annotated[float, Field(gt=0, le=COORDINATE_MAX_M)]


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


class Ground(Model):
    """An infinite horizontal plane."""

    z_m: Metres = 0.0
    category: Category = "ground"  # what data sets call it: world/scene_file.py
    reflectivity: Byte  # as the sensor is calibrated: 0-100 diffuse in per cent, 101-255 retro-reflectors


class SceneObject(Model):
    """The keys that objects of all kinds have."""

    name: Name
    reflectivity: Byte
    category: Category | None = None
    motion: Motion | None = None  # from its place at time 0, in the world's axes; it rotates about its place


class Box(SceneObject):
    """A box, rotated about the vertical."""

    center_m: Position
    size_m: tuple[Size, Size, Size]  # along its own x, y, z
    yaw_deg: float = 0.0


class Sphere(SceneObject):
    """A sphere."""

    center_m: Position
    radius_m: Size


class Cylinder(SceneObject):
    """A vertical, closed cylinder."""

    base_m: Position  # centre of the lower end
    radius_m: Size
    height_m: Size


class Plane(SceneObject):
    """A rectangle in its own xy plane, seen from both sides."""

    center_m: Position
    size_m: tuple[Size, Size]
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)


class MeshFile(SceneObject):
    """A triangle mesh, in a file that Open3D reads or in the scene's own."""

    file: MeshSource  # a name is relative to the scene's file
    position_m: Position
    rpy_deg: Vec3 = (0.0, 0.0, 0.0)
    scale: Positive = 1.0


class HeightField(SceneObject):
    """Ground of a grid of heights: columns run along x, rows against y, as a map whose top is y."""

    file: FileName | None = None  # .png in grey or .npy, relative to the scene's file
    heights_m: Annotated[tuple[tuple[Metres, ...], ...], Field(min_length=2)] | None = None  # rows, in place of a file
    cell_m: Size
    position_m: Position  # of the last row's first height, at a height of 0
    scale: Positive = 1.0  # metres per unit of the file

    @model_validator(mode="after")
    def _check(self) -> "HeightField":
        if (self.file is None) == (self.heights_m is None):
            raise validation_error(
                "conflicts with file; give only one of them" if self.file else "missing; or give a file", "heights_m"
            )
        if self.heights_m and self.scale != 1.0:
            raise validation_error("belongs to a file; heights_m are metres", "scale")
        rows = self.heights_m or ()
        for i, row in enumerate(rows):
            if len(row) != max(len(rows[0]), 2):
                allowed = f"{len(rows[0])}, as in the first row" if i else "at least 2"
                raise validation_error(f"has {len(row)} heights; allowed: {allowed}", "heights_m", i)
        return self


class GltfModel(MeshFile):
    """A glTF file each of whose nodes becomes an object NAME/NODE; its y up becomes z up."""

    file: FileName
    nodes: tuple[str, ...] | None = None  # only these
    materials: dict[str, Byte] = Field(default_factory=dict)  # by name; all others have the model's reflectivity


class Surfels(MeshFile):
    """A disc at each point of a file, across its normal, which is in the file or estimated from neighbours."""

    file: FileName
    radius_m: Size


class Weather(Model):
    """Uniform fog and rain; simulate/echoes.py models their effect on a beam."""

    fog_visibility_m: Annotated[float, Field(ge=1)] | None = None  # meteorological
    rain_mm_h: Positive | None = None


class SceneFile(Model):
    """The keys of a scene file."""

    kind: ClassVar[str] = "scene"
    name: Name = "scene"
    ground: Ground | None = None
    boxes: tuple[Box, ...] = ()
    spheres: tuple[Sphere, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()
    planes: tuple[Plane, ...] = ()
    meshes: tuple[MeshFile, ...] = ()
    height_fields: tuple[HeightField, ...] = ()
    models: tuple[GltfModel, ...] = ()
    surfels: tuple[Surfels, ...] = ()
    geo_origin: GeoOrigin = GeoOrigin()
    weather: Weather = Weather()

    @model_validator(mode="after")
    def _check(self) -> "SceneFile":
        check_names(self)
        return self


def check_names(file: Model) -> None:
    """A model's validator: objects of all kinds have different names, and none has the ground's."""
    names = {GROUND}
    for kind in dict.fromkeys((*KINDS, *FILES)):
        for i, item in enumerate(getattr(file, kind, ())):
            if item.name in names:
                raise validation_error(
                    f"{item.name!r} is an object already; each name may be given once", kind, i, "name"
                )
            names.add(item.name)
