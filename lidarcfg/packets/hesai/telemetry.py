"""Angle correction and firing time files, as Hesai's SDK reads them. The packets carry neither."""

import re
from collections.abc import Mapping

from pydantic import ValidationError

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import PacketSource
from lidarcfg.packets.hesai.model import HesaiUnit, LoopFiring, resolutions
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Beams

SUFFIX = "-angles.csv"
FIRING_TIMES = "-firetimes.csv"
ENERGY_SAVING = 3  # an operational state of the Pandar128
NAMED = re.compile(r"-\d+\.\d+\.\d+\.\d+-\d+-(angles|firetimes)\.csv$")  # whose they are, by address and port
ROW = re.compile(r"\s*(\d+)\s*,\s*([-+.\deE]+)\s*,\s*([-+.\deE]+)\s*,?\s*")
OF_FIRING_TIMES = re.compile(r"fire ?time|firing|operation(al)? (state|mode)", re.IGNORECASE)  # words of their heads
NO_ANGLE = re.compile(r"\s*\d+\s*,.*?([-+]?\b(?:nan|inf|infinity))\b.*", re.IGNORECASE)


def correction_lines(unit: HesaiUnit) -> list[str]:
    """The model's angles in the format of Hesai's own files."""
    beams = unit.sensor.beams
    rows = zip(beams.elevation_deg, beams.azimuth_offset_deg or (0.0,) * unit.count, strict=True)
    return [
        "Channel,Elevation,Azimuth",
        *(f"{k},{elevation!r},{offset!r}" for k, (elevation, offset) in enumerate(rows, 1)),
    ]


def correction_file(unit: HesaiUnit, mount: Mount) -> Mapping[str, bytes]:
    """The mount's angles, by the suffix of the file's name."""
    lines = correction_lines(unit)
    return {f"-{mount.host}-{mount.data_port}{SUFFIX}": "\n".join([*lines, ""]).encode()}


def firing_times_file(unit: HesaiUnit, mount: Mount) -> Mapping[str, bytes]:
    """The firing times of a sensor of protocol 1.4, by the suffix of the file's name; of other sensors none."""
    if unit.facts.packet.protocol != "1.4":
        return {}
    return {f"-{mount.host}-{mount.data_port}{FIRING_TIMES}": "\n".join([*firing_times_lines(unit), ""]).encode()}


def firing_times_lines(unit: HesaiUnit) -> list[str]:
    """The model's firing times as Hesai's own files have them.

    Those of protocol 6.1 count from the packet's stamp, the others from a block's start. A QT128's have a pair of
    columns for each loop, in the order of firing; a JT128's one time for each channel, an OT128's one for each state,
    in microseconds; a Pandar128's far and near ones, in nanoseconds. A channel that rests has "-", or 0.
    """
    firing = unit.facts.firing
    if unit.facts.packet.protocol == "6.1":
        times_us = ((firing.stamp_ns + (offset or 0)) / 1000 for offset in firing.loops[0])
        return ["Channel,fire time(us)", *(f"{channel},{time:g}" for channel, time in enumerate(times_us, 1))]
    if unit.facts.packet.protocol == "3.2":
        return _in_order(firing)
    firings = {one.operational_state: one.facts.firing for one in reversed(resolutions(unit))}
    if firing.near:
        firings[ENERGY_SAVING] = firing  # in which it fires as in the standard one: Hesai's file
        return _near_and_far(firings)
    if len(unit.fires) > 1 or len(firings) > 1:
        return _by_state(firings)
    return ["channel,firetime/us", *(f"{k},{_us(ns)}" for k, ns in enumerate(firing.loops[0], 1))]


def _in_order(firing: LoopFiring) -> list[str]:
    count = len(firing.loops)
    loops = []
    for loop in firing.loops:
        fired = sorted((ns, channel) for channel, ns in enumerate(loop, 1) if ns is not None)
        loops.append([(str(channel), _us(ns)) for ns, channel in fired])
    return [
        "EEFF,1,1,",
        f"Horizontal Resolution Mode,1,LoopNum,{count}",
        ",".join(f"Loop{k},Firetime{k}" for k in range(1, count + 1)),
        *(",".join(word for pair in row for word in pair) for row in zip(*loops, strict=True)),
    ]


def _us(offset_ns: int | None) -> str:
    return "-" if offset_ns is None else f"{offset_ns / 1000:g}"


def _by_state(firings: Mapping[int, LoopFiring]) -> list[str]:
    states = [(mode, state) for mode, firing in firings.items() for state in range(len(firing.loops))]
    rows = zip(*(loop for firing in firings.values() for loop in firing.loops), strict=True)
    return [
        ",".join(["Operational State", *(str(mode) for mode, _ in states)]),
        ",".join(["Azimuth State", *(str(state) for _, state in states)]),
        *(",".join([str(k), *map(_us, row)]) for k, row in enumerate(rows, 1)),
    ]


def _near_and_far(firings: Mapping[int, LoopFiring]) -> list[str]:
    below_m = 0.0
    modes = list[str]()
    states = list[str]()
    columns = list[tuple[int | None, ...]]()
    for mode, firing in firings.items():
        assert firing.near
        below_m = firing.near.below_m
        for state, pair in enumerate(zip(firing.loops, firing.near.loops, strict=True)):
            modes += [str(mode)] * 2
            states += [str(state)] * 2
            columns += pair
    return [
        ",".join([f"{below_m:g}", *["distance>=A1", "distance<A1"] * (len(columns) // 2)]),
        ",".join(["operation mode", *modes]),
        ",".join(["angle state", *states]),
        *(",".join([str(k), *(str(ns or 0) for ns in row)]) for k, row in enumerate(zip(*columns, strict=True), 1)),
    ]


def find_firing_times(source: PacketSource) -> bytes:
    """The firing time file beside the capture that is named after the source, or else the only one after none."""
    files = source.sidecar_files(FIRING_TIMES)
    own = [name for name in files if name.endswith(f"-{source.host}-{source.port}{FIRING_TIMES}")]
    free = [name for name in files if not NAMED.search(name)]
    return files[(own or free)[0]] if own or len(free) == 1 else b""


def find_corrections(source: PacketSource, count: int) -> Beams | None:
    """The angles in the file beside the capture: the one named after the source, or else one named after no source.

    Raises PacketError for a file without the angles of this many channels, or if several files fit.
    """
    files = source.sidecar_files(SUFFIX)
    own = [name for name in files if name.endswith(f"-{source.host}-{source.port}{SUFFIX}")]
    free = [name for name in files if not NAMED.search(name)]
    tables = {name: parse_corrections(name, files[name]) for name in own or free}
    right = [name for name, beams in tables.items() if len(beams.elevation_deg) == count]
    if tables and not right:
        name, beams = next(iter(tables.items()))
        raise PacketError(f"{source.where}: {name} has {len(beams.elevation_deg)} channels; the packets have {count}")
    if len(right) > 1:
        what = f"may belong to {' or '.join(right)}; name one of them …-{source.host}-{source.port}{SUFFIX}"
        raise PacketError(f"{source.where} {what}")
    return tables[right[0]] if right else None


def suffix_of(content: bytes) -> str | None:
    """The suffix of a file of angles or of firing times, by its content; None if it is neither."""
    lines = content.decode("utf-8-sig", "replace").splitlines()
    if any(OF_FIRING_TIMES.search(line) for line in lines[:3]):
        return FIRING_TIMES
    return SUFFIX if any(ROW.fullmatch(line) or NO_ANGLE.fullmatch(line) for line in lines) else None


def parse_corrections(name: str, content: bytes) -> Beams:
    """The angles of channels 1, 2 and on. Raises PacketError, which says where."""
    angles: dict[int, tuple[float, float]] = {}
    for number, line in enumerate(content.decode("utf-8-sig", "replace").splitlines(), 1):
        if wrong := NO_ANGLE.fullmatch(line):
            raise PacketError(f"{name}:{number}: an angle is {wrong[1]}; allowed: degrees")
        row = ROW.fullmatch(line)
        if row is None:
            if angles and line.strip(" ,"):
                raise PacketError(f"{name}:{number}: {line[:40]!r} is not channel,elevation,azimuth")
            continue
        try:
            channel = int(row[1])
            elevation = float(row[2])
            azimuth = float(row[3])
        except ValueError:
            raise PacketError(f"{name}:{number}: {line[:40]!r} is not channel,elevation,azimuth") from None
        if channel in angles:
            raise PacketError(f"{name}:{number}: channel {channel} is given twice")
        angles[channel] = elevation, azimuth
    if sorted(angles) != list(range(1, len(angles) + 1)) or not angles:
        raise PacketError(f"{name}: its channels are not 1, 2 and on")
    columns = zip(*(angles[channel] for channel in sorted(angles)), strict=True)
    try:
        return Beams(source=name, **dict(zip(("elevation_deg", "azimuth_offset_deg"), columns, strict=True)))
    except ValidationError as error:
        first = error.errors()[0]
        raise PacketError(f"{name}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
