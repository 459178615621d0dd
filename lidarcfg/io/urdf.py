"""URDF, read and written: a link for the vehicle, and one with a fixed joint and a visual per sensor."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from lidarcfg.config.models import Vec3
from lidarcfg.errors import ConversionError
from lidarcfg.inputs import read_regular
from lidarcfg.io.rig_importers.frame_tree import FrameTree, Joint, Pose, listed
from lidarcfg.io.rig_importers.sensor_kit import SensorKit, kit_of_tree
from lidarcfg.io.ros_names import BASE_LINK, ros_names
from lidarcfg.sensors.rig import Rig
from lidarcfg.sensors.sensor import catalogue

CYLINDER = {"radius": "0.052", "length": "0.072"}  # a VLP-16's, by its manual; other models are drawn at the same size
NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # XML 1.0, section 2.2
SUFFIXES = (".urdf", ".xacro", ".xml")
FILE_MAX = 64_000_000  # bytes
XACRO = re.compile(rb"<\s*xacro:|\$\{|\$\(")
MOVING = ("revolute", "continuous", "prismatic", "floating", "planar")
RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")  # sensors of Gazebo, classic and new
ZEROS = (0.0, 0.0, 0.0)
ONES = (1.0, 1.0, 1.0)


def urdf(rig: Rig, on_warning: Callable[[str], None]) -> str:
    """The rig as URDF. Its rpy are rotations about the fixed axes x, y, z in this order, our Rz Ry Rx."""
    robot = ElementTree.Element("robot", name=NOT_XML.sub("_", rig.name))
    ElementTree.SubElement(robot, "link", name=BASE_LINK)
    names = ros_names(rig, on_warning)
    for mount in rig.mounts:
        name = names[mount.name]
        link = ElementTree.SubElement(robot, "link", name=name)
        visual = ElementTree.SubElement(link, "visual", name=NOT_XML.sub("_", mount.sensor.name))
        geometry = ElementTree.SubElement(visual, "geometry")
        ElementTree.SubElement(geometry, "cylinder", CYLINDER)
        joint = ElementTree.SubElement(robot, "joint", name=f"{name}_joint", type="fixed")
        ElementTree.SubElement(joint, "parent", link=BASE_LINK)
        ElementTree.SubElement(joint, "child", link=name)
        ElementTree.SubElement(joint, "origin", xyz=_numbers(mount.position_m), rpy=_numbers(mount.rpy_rad))
    ElementTree.indent(robot)
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, "unicode")}\n'


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)


def read_urdf(path: Path, models: Mapping[str, str]) -> SensorKit:
    """The kit of a URDF. Raises ConversionError, OSError."""
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
    links = [_name(path, link, "link") for link in robot.iterfind("link")]
    for name in links:
        if links.count(name) > 1:
            raise ConversionError(f"{path}: has more than one link {name!r}")
    moving: dict[str, str] = {}
    joints = _joints(path, robot, links, moving)
    roots = tuple(name for name in links if name not in joints)
    if len(roots) > 1:
        raise ConversionError(f"{path}: has {len(roots)} roots: {listed(roots)}; a URDF has one, above all links")
    tree = FrameTree(str(path), joints)
    hints = {_name(path, link, "link"): (*_visuals(link), *_meshes(link)) for link in robot.iterfind("link")}
    lidars = {name for name, texts in hints.items() if catalogue().keys() & set(texts)}
    for gazebo in robot.iterfind("gazebo"):
        link = gazebo.get("reference", "")
        for sensor in gazebo.iterfind("sensor"):
            if sensor.get("type") in RAYS:
                lidars.add(link)
                hints[link] = (*hints.get(link, ()), sensor.get("name", ""))
    kit = kit_of_tree(str(path), robot.get("name", path.stem), tree, models, hints, frozenset(lidars))
    return _with_notes(kit, path, robot, tree, moving)


def _expanded(path: Path) -> str:
    return f"{path.name.split('.')[0]}.urdf" if path.suffix == ".xacro" else f"{path.stem}-expanded.urdf"


def _joints(path: Path, robot: ElementTree.Element, links: list[str], moving: dict[str, str]) -> dict[str, Joint]:
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
        origin = joint.find("origin")
        pose = Pose(_vector(where, origin, "xyz", ZEROS), _vector(where, origin, "rpy", ZEROS))
        joints[child] = Joint(ends["parent"], pose)
    return joints


def _name(path: Path, element: ElementTree.Element, kind: str) -> str:
    name = element.get("name")
    if not name:
        raise ConversionError(f"{path}: a {kind} has no name")
    return name


def _vector(where: str, element: ElementTree.Element | None, key: str, default: Vec3) -> Vec3:
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


def _visuals(link: ElementTree.Element) -> tuple[str, ...]:
    """The names of a link's visuals, which are models' where we wrote the file."""
    return tuple(visual.get("name", "") for visual in link.iterfind("visual"))


def _meshes(link: ElementTree.Element) -> tuple[str, ...]:
    """The names of a link's mesh files."""
    return tuple(re.split(r"[\\/]", mesh.get("filename", ""))[-1] for mesh in link.iterfind(".//mesh"))


def _with_notes(
    kit: SensorKit, path: Path, robot: ElementTree.Element, tree: FrameTree, moving: dict[str, str]
) -> SensorKit:
    """The kit, and what was assumed of joints and meshes."""
    notes = list(kit.notes)
    used = {name for frame in kit.frames for name in (frame.name, *tree.above(frame.name))}
    if joints := [name for link, name in moving.items() if link in used]:
        notes.append(f"{', '.join(joints)}: a joint that moves, taken at zero")
    meshes = list(robot.iterfind(".//mesh"))
    scaled = [mesh for mesh in meshes if _vector(f"{path}: mesh", mesh, "scale", ONES) != ONES]
    if meshes:
        some = f", {len(scaled)} of them scaled" if scaled else ""
        what = f"its meshes ({len(meshes)}{some}) are not taken; a rig names the vehicle's under vehicle"
        notes.append(what)
    return replace(kit, notes=tuple(notes))
