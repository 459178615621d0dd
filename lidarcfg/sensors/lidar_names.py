"""What frames and links of LiDARs are called, and which models they are by that."""

import re

from lidarcfg.sensors.sensor import catalogue

ALIASES = {  # what people call models of the catalogue besides their names, without case and punctuation
    "alphaprime": "vls-128",
    "hdl32": "hdl-32e",
    "vlp32": "vlp-32c",
    "xt16": "pandar-xt16",
    "xt32": "pandar-xt32",
    "xt32m": "xt32m2x",
}
BEAMS_ONLY = "fan-"  # models of the catalogue that nobody sells
LIDARS = re.compile(
    r"lidar|laser|velodyne|ouster|hesai|pandar|robosense|helios|bpearl|livox|puck|(^|[_/])(os|os[012]|vlp|vls|hdl)([_/\d]|$)"
)
SUPPORTS = re.compile(r"mount|bracket|mast|pole|tower|stand|holder|plate|rack|cage|guard|spacer|adapter|riser")
OTHERS = re.compile(r"cam|imu|gnss|gps|(^|[_/])ins([_/]|$)|radar|sonar|ultrasonic|depth|optical|stereo|realsense|zed")


def guessed_model(*texts: str) -> str | None:
    """The catalogue's model named in the first text that names one; the longest name in it counts."""
    known = {plain(name): name for name in catalogue() if not name.startswith(BEAMS_ONLY)} | ALIASES
    for text in texts:
        found = [name for name in known if name in plain(text)]
        if found:
            return known[max(found, key=len)]
    return None


def plain(text: str) -> str:
    """A text in lower case, without blanks and punctuation."""
    return re.sub(r"[^a-z0-9]", "", text.lower())


def is_other(name: str) -> bool:
    """Whether a frame is called as a sensor that is no LiDAR."""
    return bool(OTHERS.search(name.lower()))


def is_lidar(name: str) -> bool:
    """Whether a frame is called as a LiDAR."""
    return bool(LIDARS.search(name.lower())) or guessed_model(name) is not None


def is_support(name: str) -> bool:
    """Whether a frame is called as what holds or guards a sensor."""
    return bool(SUPPORTS.search(name.lower()))
