"""Names in ROS: those that it allows, and those of the vehicle's and the world's frames."""

import re
from collections.abc import Callable

from lidarcfg.errors import ConversionError
from lidarcfg.sensors.rig import Rig
from lidarcfg.world.frame_tree import BASE_LINK as BASE_LINK

MAP = "map"  # REP-105's name for the world frame


def ros_name(name: str) -> str:
    """The name with what ROS 2 allows in topics and frames: letters, digits and _, a letter first."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return plain if plain[0].isalpha() else f"lidar_{plain}"


def ros_names(rig: Rig, on_warning: Callable[[str], None]) -> dict[str, str]:
    """The ROS names of the rig's sensors. Raises ConversionError if two are the same."""
    taken = {BASE_LINK: "the vehicle", MAP: "the world"}
    names = {}
    for mount in rig.mounts:
        name = ros_name(mount.name)
        if name in taken:
            raise ConversionError(f"{mount.name!r} would be {name} in ROS, which is {taken[name]}; rename the sensor")
        if name != mount.name:
            on_warning(f"{mount.name!r} is called {name} in ROS")
        taken[name] = repr(mount.name)
        names[mount.name] = name
    return names
