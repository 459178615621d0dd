"""URDF: a link for the vehicle, and one with a fixed joint per sensor, whose visual is named after the model."""

import re
from collections.abc import Callable
from xml.etree import ElementTree

from lidarcfg.io.frames import BASE_LINK, ros_names
from lidarcfg.sensors.rig import Rig

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
