"""OmniLidar: the sensor of Isaac Sim 5 and 6, as USD text.

Attributes as the Omniverse Lidar Extension's page and ovrtx's pages on the generic core model have them. Isaac Sim 5
reads `reportRateBaseHz`, 6 `patternFiringRateHz`, ovrtx `rotPatternFiringResDeg` with `frameRate`: all are written.
"""

import math
import re
from collections.abc import Iterable, Iterator

from lidarcfg.geometry import Array
from lidarcfg.io.beam_table import BeamTable, rate_hz

CORE = "omni:sensor:Core:"
STATE = CORE + "emitterState:s001:"
ECHO_GAP_M = 0.4  # the simulator's minDistBetweenEchosM, below which it sees nothing near


def omni_lidar(table: BeamTable) -> str:
    """A stage whose only prim is the sensor, without a pose. Azimuths are counterclockwise, seen from above."""
    name = re.sub(r"\W", "_", table.sensor.name)
    name = name if name[:1].isalpha() else f"_{name}"
    lines = "\n".join(f"    {line}" for line in _attributes(table))
    return f"""#usda 1.0
(
    defaultPrim = "{name}"
    metersPerUnit = 1
    upAxis = "Z"
)

def OmniLidar "{name}" (
    prepend apiSchemas = ["OmniSensorGenericLidarCoreAPI", "OmniSensorGenericLidarCoreEmitterStateAPI:s001"]
)
{{
{lines}
}}
"""


def _attributes(table: BeamTable) -> Iterator[str]:
    sensor, rays = table.sensor, table.cycle
    count = len(rays.channel)
    scan_hz = rate_hz(table)
    firing_hz = scan_hz * 360 / table.step_deg if table.step_deg else scan_hz
    yield f"double2 omni:sensor:frameRate = ({scan_hz:.9g}, 1)"
    yield f'token {CORE}scanType = "{"ROTARY" if table.step_deg else "SOLID_STATE"}"'
    yield f"uint {CORE}scanRateBaseHz = {round(scan_hz)}"
    yield f"uint {CORE}reportRateBaseHz = {round(firing_hz)}"
    yield f"uint {CORE}patternFiringRateHz = {round(firing_hz)}"
    if table.step_deg:
        yield f'token {CORE}rotationDirection = "CW"'
        yield f"float {CORE}rotPatternFiringResDeg = {table.step_deg:.9g}"
        if sensor.azimuth_fov_deg:
            low_deg, high_deg = sensor.azimuth_fov_deg
            start_deg = -high_deg % 360
            yield f"float {CORE}validStartAzimuthDeg = {start_deg:.9g}"
            yield f"float {CORE}validEndAzimuthDeg = {start_deg + ((high_deg - low_deg) % 360 or 360):.9g}"
    else:
        yield f"uint {CORE}numLines = 1"
        yield f"uint[] {CORE}numRaysPerLine = [{count}]"
    yield f"uint {CORE}numberOfEmitters = {count}"
    yield f"uint {CORE}numberOfChannels = {sensor.count}"
    yield f"uint {CORE}maxReturns = 1"
    if sensor.range:
        yield f"float {CORE}nearRangeM = {sensor.range.min_m:.9g}"
        yield f"float {CORE}farRangeM = {sensor.range.max_m:.9g}"
        if sensor.range.min_m < ECHO_GAP_M:
            yield f"float {CORE}minDistBetweenEchosM = {sensor.range.min_m:.9g}"
    if sensor.optics:
        across_mrad, up_mrad = sensor.optics.divergence_mrad
        yield f"float {CORE}divergenceHorDeg = {math.degrees(across_mrad / 1000):.9g}"
        yield f"float {CORE}divergenceVerDeg = {math.degrees(up_mrad / 1000):.9g}"
        if sensor.optics.wavelength_nm:
            yield f"float {CORE}waveLengthNm = {sensor.optics.wavelength_nm:.9g}"
    yield f"float[] {STATE}azimuthDeg = {_floats(-rays.azimuth_deg)}"
    yield f"float[] {STATE}elevationDeg = {_floats(rays.elevation_deg)}"
    yield f"uint[] {STATE}fireTimeNs = {_whole(rays.time_ns.tolist())}"
    yield f"uint[] {STATE}channelId = {_whole(rays.channel.tolist())}"
    if rays.start_m[:, 1].any():
        yield f"float[] {STATE}horOffsetM = {_floats(rays.start_m[:, 1])}"
    if rays.start_m[:, 2].any():
        yield f"float[] {STATE}vertOffsetM = {_floats(rays.start_m[:, 2])}"


def _floats(values: Array) -> str:
    return f"[{', '.join(f'{value + 0.0:.9g}' for value in values.tolist())}]"


def _whole(values: Iterable[int]) -> str:
    return f"[{', '.join(map(str, values))}]"
