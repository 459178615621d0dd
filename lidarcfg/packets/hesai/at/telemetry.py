"""The files of angles and firing times beside captures, as Hesai's SDK reads them. The packets carry neither."""

import re
import struct
from collections.abc import Mapping
from hashlib import sha256

from lidarcfg.errors import ConfigError, PacketError
from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.hesai.at.model import HesaiAtUnit
from lidarcfg.packets.hesai.layout import START
from lidarcfg.sensors.mirror import MirrorAngles, parse_mirror_angles
from lidarcfg.sensors.rig import Mount

SUFFIX = "-angles.dat"
FIRING_TIMES = "-firetimes.csv"
TIMES = struct.Struct("<2s2B2xBH")  # an ATX's binary form: start, version, lasers, nanoseconds of a unit
NAMED = re.compile(r"-\d+\.\d+\.\d+\.\d+-\d+-angles\.dat$")  # whose they are, by address and port


def angle_file(unit: HesaiAtUnit, mount: Mount) -> Mapping[str, bytes]:
    """The mount's angles, by the suffix of the file's name."""
    return {f"-{mount.host}-{mount.data_port}{SUFFIX}": unit.angles.content}


def firing_times_file(unit: HesaiAtUnit, mount: Mount) -> Mapping[str, bytes]:
    """The firing times of a sensor whose mirror moves while it fires, of even and odd frames, by the file's suffix."""
    if not unit.mirror.turns_while_firing:
        return {}
    rows = (f"{channel},{even},{odd}" for channel, (even, odd) in enumerate(unit.offset_ns.T.tolist(), 1))
    lines = ["Channel,Even_fire time(ns),Odd_fire time(ns)", *rows, ""]
    return {f"-{mount.host}-{mount.data_port}{FIRING_TIMES}": "\n".join(lines).encode()}


def firing_times(unit: HesaiAtUnit) -> bytes:
    """The same in the binary form in which drivers get it; empty if the sensor has none."""
    if not unit.mirror.turns_while_firing:
        return b""
    content = TIMES.pack(START, 0, 1, unit.count, 1) + unit.offset_ns.astype("<u2").tobytes()
    return content + sha256(content).digest()


def find_angles(source: PacketSource, lasers: int) -> MirrorAngles | None:
    """The angles in the file beside the capture: the one named after the source, or else one named after no source.

    Raises PacketError for a file without the angles of this many lasers, or if several files fit.
    """
    files = source.sidecar_files(SUFFIX)
    own = [name for name in files if name.endswith(f"-{source.host}-{source.port}{SUFFIX}")]
    free = [name for name in files if not NAMED.search(name)]
    found = {name: _parsed(name, files[name]) for name in own or free}
    right = [name for name, angles in found.items() if angles.lasers == lasers]
    if found and not right:
        name, angles = next(iter(found.items()))
        raise PacketError(f"{source.where}: {name} has {angles.lasers} lasers; the packets have {lasers}")
    if len(right) > 1:
        what = f"may belong to {' or '.join(right)}; name one of them …-{source.host}-{source.port}{SUFFIX}"
        raise PacketError(f"{source.where} {what}")
    return found[right[0]] if right else None


def _parsed(name: str, content: bytes) -> MirrorAngles:
    try:
        return parse_mirror_angles(name, content)
    except ConfigError as error:
        raise PacketError(str(error)) from None
