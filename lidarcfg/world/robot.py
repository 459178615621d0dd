"""A robot's description in URDF: its links, the joints between them, and which links are LiDARs."""

import math
import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from lidarcfg.config.models import Vec3
from lidarcfg.errors import ConversionError
from lidarcfg.inputs import read_regular
from lidarcfg.sensors.lidar_names import guessed_model, is_lidar, is_other, is_support
from lidarcfg.sensors.sensor import catalogue
from lidarcfg.world.frame_tree import FrameTree, Joint, Pose, listed

Element = ElementTree.Element

SUFFIXES = (".urdf", ".xacro", ".xml")
FILE_MAX = 64_000_000  # bytes
XACRO = re.compile(rb"<\s*xacro:|\$\{|\$\(")
MOVING = ("revolute", "continuous", "prismatic", "floating", "planar")
RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")  # sensors of Gazebo, classic and new
ZEROS = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Robot:
    """What a URDF says."""

    path: Path
    name: str
    links: dict[str, Element]
    tree: FrameTree  # of the links that joints join
    moving: dict[str, str]  # joints that move, by the link below
    hints: dict[str, tuple[str, ...]]  # texts that may name a LiDAR's model, by link
    marked: frozenset[str]  # links that are LiDARs whatever they are called

    @property
    def base(self) -> str:
        """The link that is the vehicle frame. Raises ConversionError if there is none, or more than one may be it."""
        return self.tree.base() if self.tree.frames or len(self.links) != 1 else next(iter(self.links))

    @property
    def lidars(self) -> tuple[str, ...]:
        """The links that are LiDARs or their housings.

        A link called as what holds a LiDAR is not one of them, if that LiDAR is below it.
        """
        found = [name for name in self.links if name != self.base and self._may_be_lidar(name)]
        holds = {above for name in found for above in self.tree.above(name)}
        return tuple(name for name in found if name in self.marked or not (is_support(name) and name in holds))

    def _may_be_lidar(self, name: str) -> bool:
        if name in self.marked:
            return True
        return (is_lidar(name) and not is_other(name)) or guessed_model(*self.hints[name]) is not None

    def pose(self, link: str) -> Pose:
        """The pose of a link in the vehicle frame."""
        return self.tree.pose(link, self.base)


def read_robot(path: Path) -> Robot:
    """The robot of a URDF, or of what xacro made. Raises ConversionError, OSError."""
    raw = read_regular(path, FILE_MAX)
    if XACRO.search(raw):
        raise ConversionError(f"{path}: has xacro tags; expand them first: xacro {path} -o {_expanded(path)}")
    try:
        robot = ElementTree.fromstring(raw)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise ConversionError(f"{path}:{line}:{column + 1}: not XML: {str(error).split(':')[0]}") from None
    if robot.tag != "robot":
        raise ConversionError(f"{path}: its root is <{robot.tag[:40]}>, not <robot>; a URDF belongs here")
    counts = Counter(_name(path, link, "link") for link in robot.iterfind("link"))
    for name, count in counts.items():
        if count > 1:
            raise ConversionError(f"{path}: has more than one link {name!r}")
    links = {_name(path, link, "link"): link for link in robot.iterfind("link")}
    moving: dict[str, str] = {}
    joints = _joints(path, robot, links.keys(), moving)
    roots = tuple(name for name in links if name not in joints)
    if len(roots) > 1:
        raise ConversionError(f"{path}: has {len(roots)} roots: {listed(roots)}; a URDF has one, above all links")
    hints = {name: (*_visuals(link), *_meshes(link)) for name, link in links.items()}
    marked = {name for name, texts in hints.items() if catalogue().keys() & set(texts)}
    for gazebo in robot.iterfind("gazebo"):
        link = gazebo.get("reference", "")
        for sensor in gazebo.iterfind("sensor"):
            if sensor.get("type") in RAYS:
                marked.add(link)
                hints[link] = (*hints.get(link, ()), sensor.get("name", ""))
    tree = FrameTree(str(path), joints)
    return Robot(path, robot.get("name", path.stem), links, tree, moving, hints, frozenset(marked))


def _expanded(path: Path) -> str:
    return f"{path.name.split('.')[0]}.urdf" if path.suffix == ".xacro" else f"{path.stem}-expanded.urdf"


def _joints(path: Path, robot: Element, links: Collection[str], moving: dict[str, str]) -> dict[str, Joint]:
    """The joints by the link below them; `moving` gets those that move, by that link."""
    joints: dict[str, Joint] = {}
    for joint in robot.iterfind("joint"):
        name = _name(path, joint, "joint")
        where = f"{path}: joint {name!r}"
        ends = {}
        for end in ("parent", "child"):
            element = joint.find(end)
            ends[end] = "" if element is None else element.get("link", "")
            if ends[end] not in links:
                raise ConversionError(f"{where}: its {end} {ends[end]!r} is not a link of the file")
        child = ends["child"]
        if child in joints:
            raise ConversionError(
                f"{where}: {child!r} is below {joints[child].parent!r} already; a link has one parent"
            )
        kind = joint.get("type", "")
        if kind != "fixed" and kind not in MOVING:
            raise ConversionError(f"{where}: type {kind!r} is not allowed; allowed: fixed, {', '.join(MOVING)}")
        if kind != "fixed":
            moving[child] = name
        joints[child] = Joint(ends["parent"], origin(where, joint))
    return joints


def _name(path: Path, element: Element, kind: str) -> str:
    name = element.get("name")
    if not name:
        raise ConversionError(f"{path}: a {kind} has no name")
    return name


def origin(where: str, element: Element) -> Pose:
    """The pose that an element's origin gives. Raises ConversionError."""
    found = element.find("origin")
    return Pose(vector(where, found, "xyz", ZEROS), vector(where, found, "rpy", ZEROS))


def vector(where: str, element: Element | None, key: str, default: Vec3) -> Vec3:
    """Three numbers in an attribute, or the default without it. Raises ConversionError."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        x, y, z = (float(word) for word in text.split())
    except ValueError:
        raise ConversionError(f"{where}: {key} {text[:60]!r} is not three numbers") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ConversionError(f"{where}: {key} {text[:60]!r} is not finite")
    return x, y, z


def _visuals(link: Element) -> tuple[str, ...]:
    """The names of a link's visuals, which are models' where we wrote the file."""
    return tuple(visual.get("name", "") for visual in link.iterfind("visual"))


def _meshes(link: Element) -> tuple[str, ...]:
    """The names of a link's mesh files."""
    return tuple(re.split(r"[\\/]", mesh.get("filename", ""))[-1] for mesh in link.iterfind(".//mesh"))
