"""Angle correction files: each unit's own angles as CSV, which the packets do not carry."""

import re
from collections.abc import Mapping

from pydantic import ValidationError

from lidarcfg.errors import PacketError
from lidarcfg.packets.codec import Source
from lidarcfg.packets.hesai.model import Unit
from lidarcfg.sensors.rig import Mount
from lidarcfg.sensors.sensor import Beams

SUFFIX = "-angles.csv"
NAMED = re.compile(r"-\d+\.\d+\.\d+\.\d+-\d+-angles\.csv$")  # whose they are, by address and port
ROW = re.compile(r"\s*(\d+)\s*,\s*([-+.\deE]+)\s*,\s*([-+.\deE]+)\s*,?\s*")
NO_ANGLE = re.compile(r"\s*\d+\s*,.*?([-+]?\b(?:nan|inf|infinity))\b.*", re.IGNORECASE)


def correction_lines(unit: Unit) -> list[str]:
    """The model's angles in the format of Hesai's own files."""
    beams = unit.sensor.beams
    rows = zip(beams.elevation_deg, beams.azimuth_offset_deg or (0.0,) * unit.count, strict=True)
    return [
        "Channel,Elevation,Azimuth",
        *(f"{k},{elevation!r},{offset!r}" for k, (elevation, offset) in enumerate(rows, 1)),
    ]


def correction_file(unit: Unit, mount: Mount) -> Mapping[str, bytes]:
    """The mount's angles, by the suffix of the file's name."""
    lines = correction_lines(unit)
    return {f"-{mount.host}-{mount.data_port}{SUFFIX}": "\n".join([*lines, ""]).encode()}


def find_corrections(source: Source, count: int) -> Beams | None:
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
