"""A ROS 2 launch file that publishes the sensors' poses as static transforms."""

from collections.abc import Callable

from lidarcfg.geometry import quaternion_xyzw
from lidarcfg.io.ros_names import BASE_LINK, ros_names
from lidarcfg.sensors.rig import Rig

FILE = '''\
"""Poses of a rig's sensors: x forward, y left, z up; metres; quaternions x y z w."""

from launch import LaunchDescription
from launch_ros.actions import Node

# Rig: {rig}


def generate_launch_description():
    return LaunchDescription(
        [
{transforms}        ]
    )


def static_transform(name, x, y, z, qx, qy, qz, qw):
    pose = {"--x": x, "--y": y, "--z": z, "--qx": qx, "--qy": qy, "--qz": qz, "--qw": qw}
    return Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        name=f"{name}_transform",
        arguments=[
            *(word for option, value in pose.items() for word in (option, repr(value))),
            *("--frame-id", "{base}", "--child-frame-id", name),
        ],
    )
'''


def launch(rig: Rig, on_warning: Callable[[str], None]) -> str:
    """The launch file: one static_transform_publisher per sensor, from base_link to it."""
    names = ros_names(rig, on_warning)
    transforms = ""
    for mount in rig.mounts:
        numbers = (*mount.position_m, *quaternion_xyzw(mount.T_vehicle_sensor))
        words = ", ".join(repr(float(number)) for number in numbers)
        transforms += f'            static_transform("{names[mount.name]}", {words}),\n'
    return FILE.replace("{base}", BASE_LINK).replace("{transforms}", transforms).replace("{rig}", ascii(rig.name))
