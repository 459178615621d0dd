"""URDF, read and written: a link for the vehicle, and one with a fixed joint and a visual per sensor."""

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from lidarcfg.config.models import Section
from lidarcfg.errors import SceneError
from lidarcfg.io.rig_importers.sensor_kit import LEAVE_OUT, SensorKit, kit_of_tree
from lidarcfg.io.ros_names import BASE_LINK, ros_names
from lidarcfg.sensors.rig import Rig
from lidarcfg.world.robot import read_robot
from lidarcfg.world.robot_body import RobotBody, body_notes, robot_body, shaped_links

CYLINDER = {"radius": "0.052", "length": "0.072"}  # a VLP-16's, by its manual; other models are drawn at the same size
NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # XML 1.0, section 2.2


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
    """The kit of a URDF, with its body. Raises ConversionError, OSError."""
    robot = read_robot(path)
    kit = kit_of_tree(str(path), robot.name, robot.tree, models, robot.hints, robot.marked)
    notes = list(kit.notes)
    used = {name for frame in kit.frames for name in (frame.name, *robot.tree.above(frame.name))}
    if joints := [name for link, name in robot.moving.items() if link in used]:
        notes.append(f"{', '.join(joints)}: a joint that moves, taken at zero")
    lidars = dict.fromkeys((*robot.lidars, *(frame.name for frame in kit.frames)))
    without = tuple(name for name in lidars if models.get(name) != LEAVE_OUT)
    vehicle = None
    if set(shaped_links(robot)) - set(without):
        try:
            body = robot_body(path, without)
        except SceneError as error:
            notes.append(f"its body is not taken: {str(error).removeprefix(f'{path}: ')}")
        else:
            notes += body_notes(body)
            vehicle = Section({"meshes": (body_keys(path, body),)})
    return replace(kit, notes=tuple(notes), vehicle=vehicle)


def body_keys(path: Path, body: RobotBody) -> dict[str, object]:
    """The keys of a vehicle's mesh that is the body of the robot in a URDF."""
    return {"name": "body", "file": os.path.realpath(path), "without": body.without}
