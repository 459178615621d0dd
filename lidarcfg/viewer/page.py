"""The page: the data that it shows, and the whole page as one file that needs neither server nor network."""

import base64
import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from lidarcfg import __version__
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array, transform
from lidarcfg.report.misses import COLOURS as MISSED
from lidarcfg.requirements.verify import Verifier
from lidarcfg.returns.scanners import scanners_of
from lidarcfg.sensors.rig import Mount, Rig
from lidarcfg.study.evaluation import WORST
from lidarcfg.study.study import Study
from lidarcfg.viewer import colours
from lidarcfg.viewer.bodies import base_area_m, faces, packed_mesh, packed_quads
from lidarcfg.viewer.camera import Camera
from lidarcfg.viewer.colours import COLOUR_BY, By, colour, sensor_colours, span
from lidarcfg.viewer.contents import Contents
from lidarcfg.viewer.evaluation import evaluations
from lidarcfg.viewer.evaluation import verdict as verdict_on
from lidarcfg.viewer.missed import MissCounter
from lidarcfg.viewer.mounting import has_its_sensors, mirrored_pairs, surface_mounts
from lidarcfg.viewer.still import GROUND_M, WORST_SHOWN
from lidarcfg.viewer.timeline import Timeline, parts, timeline, tracks

ASSETS = Path(__file__).parent / "web"
MODULES = {"three": "vendor/three.js"} | {
    f"lidarcfg/{name}": f"{name}.js"
    for name in (
        *("main", "data", "stage", "colours", "cloud", "points", "raster", "labels", "bodies", "sensors"),
        *("handles", "history", "rig", "measure", "time", "tracks", "guides", "panel", "keys"),
    )
}
BINS = 256  # of time: in each the points are in random order, so that a part of it is a fair sample
SURROUNDINGS_M = 40.0  # shown around the vehicle in a scene
MISSED_M = 4.0  # shown around the vehicle where the ground shows what is missed
NEAR_PERCENT = 40.0  # of the points, nearest to the sensors, that are shown: walls of a room stay behind the camera
MOST_PERCENT = 70.0  # of the points of a cloud without a rig
ALONE_M = 1.5  # shown around sensors without anything else
SIDES = np.array(list(np.ndindex(3, 3, 3))) - 1.0  # to look for outermost places
PIECE = 3 << 22  # bytes of an array in one script of a standalone file


@dataclass(frozen=True)
class Page:
    """What the page reads: JSON, and arrays of the points."""

    about: dict[str, Any]  # JSON
    arrays: dict[str, NDArray[Any]]  # of the points, little-endian


def page_of(
    contents: Contents, by: By = "sensor", camera: Camera | None = None, worst: int | None = None, served: bool = False
) -> Page:
    """All that the page shows; if it is served it asks for detection rates and the verdict itself.

    So many of the `worst` subspaces are shown first; by default none where there are points, or where the ground shows
    what is missed.
    Raises CloudError if there is nothing to show, or the colour is unknown.
    """
    if not (len(contents.cloud.xyz) or contents.rigs or contents.study or contents.scenes):
        raise CloudError("the cloud is empty; there is nothing to show")
    if by == "object" and contents.objects is None:
        raise CloudError("objects are known only from ground truth; give the .npz of export --truth, too")
    shown_worst = _shown_worst(contents) if worst is None else worst
    line = timeline(contents)
    points, arrays = _points(contents, line) if line and len(contents.cloud.xyz) else (None, {})
    if line:
        arrays["tracks"] = np.ascontiguousarray(tracks(contents, line), "<f8")
    shown = evaluations(contents.study, contents.rigs[0], WORST, not served) if contents.study else [None, None]
    verdict = None if served else _verdict(contents, shown[0])
    misses = None if served else _misses(contents)
    about = {
        "version": __version__,
        "by": by,
        "worst": shown_worst or WORST_SHOWN,
        "shows_worst": shown_worst > 0,
        "camera": camera
        and {"eye_m": camera.eye_m.tolist(), "target_m": camera.target_m.tolist(), "field_deg": camera.field_deg},
        "opening": _opening(contents, shown[0], shown_worst).tolist(),
        "colours": {
            "background": colours.NIGHT,
            "scale": list(colours.SCALE),
            "bright": list(colours.BRIGHT),
            "retro": colours.RETRO,
            "unknown": colours.UNKNOWN,
            "worst": colours.WORST,
            "excluded": colours.EXCLUDED,
            "blind": colours.BLIND,
            "vehicle": colours.VEHICLE,
            "base_area": colours.BASE_AREA,
            "base": colours.BASE,
            "zone": colours.ZONE,
            "missed": list(MISSED),
        },
        "sensors": [{"name": name, "colour": code} for name, code in sensor_colours(contents).items()],
        "points": points,
        "timeline": line and _timeline(line, contents),
        "rigs": [{"name": rig.name, "mounts": [_mount(m) for m in rig.mounts]} for rig in contents.rigs],
        "study": contents.study and _study(contents.study, contents.rigs[0]),
        "mirrored": mirrored_pairs(contents.study, contents.rigs[0]) if contents.study else [],
        "on_surface": surface_mounts(contents.study, contents.rigs[0]) if contents.study else [],
        "verdict": verdict,
        "misses": misses,
        "evaluation": shown[0],
        "transparent": shown[1],
        "vehicle": contents.vehicle and {"mesh": packed_mesh(*contents.vehicle.scene.mesh())},
        "ground_m": _ground_m(contents),
        "scenes": _scenes(contents),
    }
    return Page(about, arrays)


def _verdict(contents: Contents, shown: dict[str, Any] | None) -> dict[str, Any] | None:
    """The verdict on the first rig, if the study has requirements; what is wrong goes into the evaluation."""
    study = contents.study
    if study is None or study.requirements is None or shown is None:
        return None
    try:
        return verdict_on(Verifier(study.requirements), contents.rigs[0])
    except ConfigError as error:  # of sensors whose firing or price is not known
        shown["violations"].append(str(error))
        return None


def _misses(contents: Contents) -> dict[str, Any] | None:
    """What the first rig misses; None without a vehicle, or where sensors lack facts."""
    study = contents.study
    if study is None or study.misses is None or not _counts_misses(study, contents.rigs[0]):
        return None
    return MissCounter(study.misses).count(contents.rigs[0])


def html(page: Page | None) -> str:
    """The page: as a server sends it, or with everything inside it."""
    modules = {name: f"./page/{file}" for name, file in MODULES.items()}
    data: list[str] = []
    if page:
        modules = {name: _data_url((ASSETS / file).read_bytes()) for name, file in MODULES.items()}
        about = json.dumps(page.about, allow_nan=False).replace("<", "\\u003c")
        data.append(f'<script id="about" type="application/json">{about}</script>')
        for name, array in page.arrays.items():
            raw = array.tobytes()
            for first in range(0, len(raw), PIECE):
                piece = base64.b64encode(raw[first : first + PIECE]).decode()  # compressing it would gain a fifth
                data.append(f'<script data-array="{name}" type="text/plain">{piece}</script>')
    text = (ASSETS / "index.html").read_text("utf-8")
    for key, value in (
        ("style", (ASSETS / "style.css").read_text("utf-8")),
        ("modules", json.dumps({"imports": modules}, indent=1)),
        ("data", "\n".join(data)),
    ):
        text = text.replace(f"{{{{{key}}}}}", value)
    return text


def save_html(page: Page, path: str | Path) -> None:
    """Write the page as one file, whole or not at all."""
    with replacing(path) as file:
        file.write(html(page))


def _data_url(code: bytes) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(code).decode()}"


def _points(contents: Contents, line: Timeline) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    cloud = contents.cloud
    time = ((cloud.time_ns - line.start_ns) // line.unit_ns).astype(np.uint32)
    bins = (time * (BINS / (line.end + 1))).astype(np.uint8)
    order = np.random.default_rng(1).permutation(len(time))
    order = order[np.argsort(bins[order], kind="stable")]
    origin = np.round(np.median(cloud.xyz[:: max(len(time) // 10_000, 1)], axis=0))
    fact = np.empty((len(time), 4), np.uint8)
    fact[:, 0] = cloud.intensity
    fact[:, 1] = cloud.ring
    fact[:, 2] = cloud.sensor & 255
    fact[:, 3] = cloud.sensor >> 8
    arrays: dict[str, NDArray[Any]] = {
        "position": (cloud.xyz - origin).astype("<f4")[order],
        "time": time.astype("<u4", copy=False)[order],
        "fact": fact[order],
    }
    if contents.objects:
        arrays["thing"] = contents.objects.index.astype("<u2", copy=False)[order]
    counts = np.bincount(cloud.sensor, minlength=len(cloud.sensor_names))
    about = {
        "count": len(time),
        "origin_m": origin.tolist(),
        "bins": [0, *np.cumsum(np.bincount(bins, minlength=BINS)).tolist()],
        "unit_s": line.unit_ns / 1e9,
        "end": line.end,
        "sensors": [
            {"name": name, "count": int(count)} for name, count in zip(cloud.sensor_names, counts, strict=True)
        ],
        "objects": _objects(contents),
        "spans": {by: span(contents, by) for by in COLOUR_BY if by not in ("sensor", "object")},
    }
    return about, arrays


def _timeline(line: Timeline, contents: Contents) -> dict[str, Any]:
    return {
        "start": _utc(line.start_ns),
        "unit_s": line.unit_ns / 1e9,
        "end": line.end,
        "frame": line.frame,
        "frames": line.frames.tolist(),
        "drives": not contents.trajectory.path.is_static,
    }


def _objects(contents: Contents) -> list[dict[str, Any]] | None:
    if not contents.objects:
        return None
    counts = np.bincount(contents.objects.index, minlength=len(contents.objects.names)).tolist()
    shown = [*(colour(i) for i in range(len(counts) - 1)), colours.UNKNOWN]
    return [
        {"name": name, "count": count, "colour": code}
        for name, count, code in zip(contents.objects.names, counts, shown, strict=True)
    ]


def _utc(time_ns: int) -> str:
    seconds, rest_ns = divmod(time_ns, 10**9)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest_ns // 1000:06d} UTC"
    except (ValueError, OverflowError, OSError):  # years beyond the calendar
        return f"{seconds} s since 1970"


def _opening(contents: Contents, found: dict[str, Any] | None, worst: int) -> Array:
    """(n, 3) outermost places of what the page shows whole when it opens: the vehicle, its sensors and the worst
    subspaces, or what is missed near by; without a study also most of the points, or the scene around."""
    corners = [np.array([mount.position_m for rig in contents.rigs for mount in rig.mounts]).reshape(-1, 3)]
    if contents.vehicle:
        corners.append(contents.vehicle.scene.mesh()[0])
    if contents.study and found:
        corners += [_corners(body["mesh"]) for body in found["worst"][:worst]]
        if not worst and contents.study.body:
            around = shapely.get_coordinates(contents.study.body.shape.buffer(MISSED_M))
            corners.append(np.column_stack([around, np.full(len(around), _ground_m(contents))]))
    elif len(contents.cloud.xyz):
        some = contents.cloud.xyz[:: max(len(contents.cloud.xyz) // 10_000, 1)]
        middle = corners[0].mean(axis=0) if len(corners[0]) else np.median(some, axis=0)
        away = np.linalg.norm(some - middle, axis=1)
        share = NEAR_PERCENT if contents.rigs else MOST_PERCENT
        corners.append(some[away <= np.clip(np.percentile(away, share), 2.0, 60.0)])
    elif contents.scenes or not len(corners[0]):
        corners.append(SIDES * (SURROUNDINGS_M, SURROUNDINGS_M, 0))
    else:
        corners += [at + ALONE_M * SIDES for at in corners[0]]
    return np.concatenate([some[np.argmax(some @ SIDES.T, axis=0)] for some in corners if len(some)])


def _corners(mesh: dict[str, Any]) -> Array:
    """(V, 3) the vertices of a packed mesh."""
    vertices = np.frombuffer(base64.b64decode(mesh["vertices"]), "<f4").reshape(-1, 3)
    return np.asarray(vertices + np.array(mesh["origin_m"]), np.float64)


def _ground_m(contents: Contents) -> float:
    """The height of the grid and of the range rings: the region's floor, or the ground's, or 0."""
    if contents.study:
        return float(contents.study.region.min_m[2])
    heights = [_ground_center_m(contents, scene.file.ground.z_m)[2] for scene in contents.scenes if scene.file.ground]
    return heights[0] if heights else 0.0


def _mount(mount: Mount) -> dict[str, Any]:
    return {
        "name": mount.name,
        "model": mount.sensor.name,
        "position_m": list(mount.position_m),
        "rpy_rad": list(mount.rpy_rad),
        "elevation_deg": sorted(mount.sensor.beams.elevation_deg or mount.sensor.elevation_span_deg),
        "azimuth_fov_deg": mount.azimuth_fov_deg and list(mount.azimuth_fov_deg),
        "range_m": mount.sensor.range and mount.sensor.range.max_m,
    }


def _counts_misses(study: Study, rig: Rig) -> bool:
    """Whether there is a vehicle around which misses are counted, and the sensors' files say how they fire."""
    try:
        return study.misses is not None and bool(scanners_of(rig.mounts))
    except ConfigError:
        return False


def _shown_worst(contents: Contents) -> int:
    """How many of the worst subspaces the page opens with: none where they would hide points, or what is missed."""
    study = contents.study
    covered = len(contents.cloud.xyz) or (study and _counts_misses(study, contents.rigs[0]))
    return 0 if covered else WORST_SHOWN


def _study(study: Study, rig: Rig) -> dict[str, Any]:
    ours = has_its_sensors(study, rig)
    return {
        "name": study.name,
        "min_m": study.region.min_m.tolist(),
        "max_m": study.region.max_m.tolist(),
        "cuboid_m": study.region.cuboid_m.tolist(),
        "cuboids": int(study.region.included.sum()),
        "excluded": None if study.vehicle else packed_quads(faces(study.region, ~study.region.included)),
        "bounds": [
            {"min_m": low[:3].tolist(), "max_m": high[:3].tolist()}
            for low, high, mirror in zip(study.space.lower, study.space.upper, study.space.mirror, strict=True)
            if np.isnan(mirror)
        ]
        if ours
        else [],
        "base_area": packed_quads(base_area_m(study)) if ours else None,
        "zones": [
            {"name": zone.name, "weight": zone.weight, "min_m": zone.box_m[0].tolist(), "max_m": zone.box_m[1].tolist()}
            for zone in study.zones
        ],
        "misses": _counts_misses(study, rig),
        "detects": len(study.detection) > 0,
        "requirements": [item.name for item in study.requirements.items] if study.requirements else [],
    }


def _scenes(contents: Contents) -> list[dict[str, Any]]:
    """The scenes: what is static in the page's frame, and dynamic objects in their own, each with its track."""
    found = []
    T = contents.T_vehicle_world
    track = 0  # the first track is the vehicle's
    for scene in contents.scenes:
        static = None
        dynamic = []
        for part in parts(scene):
            if part.path:
                track += 1
                dynamic.append({"mesh": packed_mesh(*part.mesh), "track": track})
            else:
                static = packed_mesh(transform(T, part.mesh[0]), part.mesh[1])
        ground = scene.file.ground
        found.append(
            {
                "name": scene.file.name,
                "objects": len(scene.names),
                "mesh": static,
                "dynamic": dynamic,
                "ground": ground and {"center_m": _ground_center_m(contents, ground.z_m), "half_m": GROUND_M},
            }
        )
    return found


def _ground_center_m(contents: Contents, z_m: float) -> list[float]:
    """The place of a scene's ground under the vehicle."""
    below = transform(contents.T_vehicle_world, [[*contents.T_world_vehicle[:2, 3], z_m]])[0]
    return [float(value) for value in below]
