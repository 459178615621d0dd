"""The page: its data for a stage, and the whole page as one file that needs neither server nor network."""

import base64
import json
import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg import __version__
from lidarcfg.errors import CloudError
from lidarcfg.files import replacing
from lidarcfg.geometry import Array, transform
from lidarcfg.placement.evaluation import WORST
from lidarcfg.placement.study import Study
from lidarcfg.rig import Mount, Rig
from lidarcfg.view import colours
from lidarcfg.view.bodies import (
    bases_m,
    faces,
    has_its_sensors,
    hides,
    other_max_vsr_m,
    score,
    seats_m,
    violations,
)
from lidarcfg.view.camera import Camera
from lidarcfg.view.colours import COLOUR_BY, By, colour
from lidarcfg.view.shades import span
from lidarcfg.view.stage import Stage
from lidarcfg.view.still import GROUND_M

ASSETS = Path(__file__).parent / "web"
MODULES = {"three": "vendor/three.js"} | {
    f"lidarcfg/{name}": f"{name}.js"
    for name in (
        *("main", "data", "stage", "colours", "cloud", "points", "raster"),
        *("labels", "bodies", "sensors", "handles", "measure", "panel"),
    )
}
BINS = 256  # of time: in each the points are in random order, so that a part of it is a fair sample
FRAME_NS = 100_000_000  # one revolution at 600 rpm
PIECE = 3 << 22  # bytes of an array in one script of a standalone file


@dataclass(frozen=True)
class Page:
    """A stage as the page reads it."""

    about: dict[str, Any]  # JSON
    arrays: dict[str, NDArray[Any]]  # of the points, little-endian


def page_of(stage: Stage, by: By = "sensor", camera: Camera | None = None, worst: int = 3) -> Page:
    """All that the page shows. Raises CloudError if there is nothing to show, or the colour is unknown."""
    if not (len(stage.cloud.xyz) or stage.rigs or stage.study or stage.scenes):
        raise CloudError("the cloud is empty; there is nothing to show")
    if by == "object" and stage.objects is None:
        raise CloudError("objects are known only from ground truth; give the .npz of export --truth, too")
    points, arrays = _points(stage) if len(stage.cloud.xyz) else (None, {})
    center, radius_m = _extent(stage)
    transparent = None
    if stage.study and hides(stage.study):
        transparent = evaluation(stage.study, stage.rigs[0], WORST, transparent=True)
    about = {
        "version": __version__,
        "by": by,
        "worst": worst,
        "camera": camera
        and {"eye_m": camera.eye_m.tolist(), "target_m": camera.target_m.tolist(), "field_deg": camera.field_deg},
        "center_m": center.tolist(),
        "radius_m": radius_m,
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
            "seat": colours.SEAT,
            "base": colours.BASE,
        },
        "sensors": [{"name": name, "colour": code} for name, code in stage.colours.items()],
        "points": points,
        "rigs": [{"name": rig.name, "mounts": [_mount(m) for m in rig.mounts]} for rig in stage.rigs],
        "study": stage.study and _study(stage.study, stage.rigs[0]),
        "evaluation": stage.study and evaluation(stage.study, stage.rigs[0], WORST),
        "transparent": transparent,
        "vehicle": stage.study and stage.study.vehicle and {"mesh": _mesh(*stage.study.vehicle.scene.mesh())},
        "scenes": [_scene(stage, i) for i in range(len(stage.scenes))],
    }
    return Page(about, arrays)


def evaluation(study: Study, rig: Rig, worst: int, transparent: bool = False) -> dict[str, Any]:
    """What the page shows of a rig in a study, where nothing hides anything if it is `transparent`."""
    found = score(study, rig, worst, transparent)
    return {
        "transparent": transparent,
        "other_max_vsr_m": other_max_vsr_m(study, rig, transparent) if hides(study) else None,
        "blind": found.blind
        and {
            "volume_m3": found.blind.volume_m3,
            "fraction": found.blind.fraction,
            "mesh": _quads(found.blind.faces_m),
        },
        "max_vsr_m": found.max_vsr_m,
        "subspaces": found.subspaces,
        "violations": violations(study, rig),
        "worst": [
            {
                "vsr_m": body.vsr_m,
                "volume_m3": body.volume_m3,
                "centroid_m": body.centroid_m.tolist(),
                "mesh": _quads(body.faces_m),
            }
            for body in found.worst
        ],
    }


def moved(rig: Rig, poses: Array) -> Rig:
    """The rig with other poses (mounts, 6) of x, y, z, roll, pitch, yaw in metres and radians."""
    mounts = [
        replace(mount, position_m=(x, y, z), rpy_rad=(roll, pitch, yaw))
        for mount, (x, y, z, roll, pitch, yaw) in zip(rig.mounts, poses.tolist(), strict=True)
    ]
    return replace(rig, mounts=tuple(mounts))


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


def save_html(page: Page, path: Path) -> None:
    """Write the page as one file, whole or not at all."""
    with replacing(path) as file:
        file.write(html(page))


def _data_url(code: bytes) -> str:
    return f"data:text/javascript;base64,{base64.b64encode(code).decode()}"


def _points(stage: Stage) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    cloud = stage.cloud
    start_ns, end_ns = int(cloud.time_ns.min()), int(cloud.time_ns.max())
    unit_ns = max(1000, math.ceil((end_ns - start_ns + 1) / 2**32))
    time = ((cloud.time_ns - start_ns) // unit_ns).astype(np.uint32)
    bins = (time * (BINS / (int(time.max()) + 1))).astype(np.uint8)
    order = np.random.default_rng(1).permutation(len(time))
    order = order[np.argsort(bins[order], kind="stable")]
    origin = np.round(np.median(cloud.xyz[:: max(len(time) // 10_000, 1)], axis=0))
    fact = np.empty((len(time), 4), np.uint8)
    fact[:, 0], fact[:, 1] = cloud.intensity, cloud.ring
    fact[:, 2], fact[:, 3] = cloud.sensor & 255, cloud.sensor >> 8
    arrays: dict[str, NDArray[Any]] = {
        "position": (cloud.xyz - origin).astype("<f4")[order],
        "time": time.astype("<u4", copy=False)[order],
        "fact": fact[order],
    }
    if stage.objects:
        arrays["thing"] = stage.objects.index.astype("<u2", copy=False)[order]
    frame_ns = round(6e10 / min(m.rpm for m in stage.rigs[0].mounts)) if stage.rigs else FRAME_NS
    frame = max(round(frame_ns / unit_ns), 1)
    counts = np.bincount(cloud.sensor, minlength=len(cloud.sensor_names))
    about = {
        "count": len(time),
        "origin_m": origin.tolist(),
        "bins": [0, *np.cumsum(np.bincount(bins, minlength=BINS)).tolist()],
        "start": _utc(start_ns),
        "unit_s": unit_ns / 1e9,
        "end": int(time.max()),
        "frame": frame,
        "frames": np.unique(time // np.uint32(frame)).tolist(),
        "sensors": [
            {"name": name, "count": int(count)} for name, count in zip(cloud.sensor_names, counts, strict=True)
        ],
        "objects": _objects(stage),
        "spans": {by: span(stage, by) for by in COLOUR_BY if by not in ("sensor", "object")},
    }
    return about, arrays


def _objects(stage: Stage) -> list[dict[str, Any]] | None:
    if not stage.objects:
        return None
    counts = np.bincount(stage.objects.index, minlength=len(stage.objects.names)).tolist()
    shown = [*(colour(i) for i in range(len(counts) - 1)), colours.UNKNOWN]
    return [
        {"name": name, "count": count, "colour": code}
        for name, count, code in zip(stage.objects.names, counts, shown, strict=True)
    ]


def _utc(time_ns: int) -> str:
    seconds, rest_ns = divmod(time_ns, 10**9)
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest_ns // 1000:06d} UTC"
    except (ValueError, OverflowError, OSError):  # years beyond the calendar
        return f"{seconds} s since 1970"


def _extent(stage: Stage) -> tuple[Array, float]:
    """(3,) what to look at first, and the radius of what is around it, in metres."""
    centres, radii = [], []
    if stage.study:
        low, high = stage.study.region.min_m, stage.study.region.max_m
        centres.append((low + high) / 2)
        radii.append(float(np.linalg.norm(high - low)) / 2)
    if stage.rigs:
        centres.insert(0, np.mean([mount.position_m for rig in stage.rigs for mount in rig.mounts], axis=0))
        radii.append(5.0)
    if len(stage.cloud.xyz):
        some = stage.cloud.xyz[:: max(len(stage.cloud.xyz) // 10_000, 1)]
        centres.append(np.median(some, axis=0))
        away = np.linalg.norm(some - centres[0], axis=1)
        radii.append(min(max(float(np.percentile(away, 70)), 2.0), 60.0))
    if not centres:
        centres.append(np.zeros(3))
        radii.append(40.0)
    return centres[0], max(radii)


def _mount(mount: Mount) -> dict[str, Any]:
    return {
        "name": mount.name,
        "model": mount.sensor.name,
        "position_m": list(mount.position_m),
        "rpy_rad": list(mount.rpy_rad),
        "elevation_deg": sorted(mount.sensor.beams.elevation_deg),
        "azimuth_fov_deg": mount.azimuth_fov_deg and list(mount.azimuth_fov_deg),
        "range_m": mount.sensor.range and mount.sensor.range.max_m,
    }


def _study(study: Study, rig: Rig) -> dict[str, Any]:
    ours, bases = has_its_sensors(study, rig), bases_m(study, rig)
    return {
        "name": study.name,
        "min_m": study.region.min_m.tolist(),
        "max_m": study.region.max_m.tolist(),
        "cuboid_m": study.region.cuboid_m.tolist(),
        "cuboids": int(study.region.included.sum()),
        "excluded": _quads(faces(study.region, ~study.region.included)),
        "bounds": [
            {"min_m": low[:3].tolist(), "max_m": high[:3].tolist()}
            for low, high, mirror in zip(study.lower, study.upper, study.mirror, strict=True)
            if np.isnan(mirror)
        ]
        if ours
        else [],
        "seats": _quads(seats_m(study)) if ours else None,
        "bases": _mesh(bases.reshape(-1, 3), np.arange(3 * len(bases)).reshape(-1, 3)) if len(bases) else None,
    }


def _scene(stage: Stage, index: int) -> dict[str, Any]:
    scene = stage.scenes[index]
    vertices, triangles = scene.mesh()
    vertices = transform(stage.T_vehicle_world, vertices)
    ground = None
    if scene.file.ground:
        x, y, z = transform(stage.T_vehicle_world, [[*stage.T_world_vehicle[:2, 3], scene.file.ground.z_m]])[0].tolist()
        ground = {"center_m": [x, y, z], "half_m": GROUND_M}
    return {
        "name": scene.file.name,
        "objects": len(scene.names),
        "mesh": _mesh(vertices, triangles) if len(triangles) else None,
        "ground": ground,
    }


def _quads(quads: Array) -> dict[str, Any] | None:
    """The mesh of quads (F, 4, 3), or none."""
    if not len(quads):
        return None
    first = 4 * np.arange(len(quads))[:, None, None]
    return _mesh(quads.reshape(-1, 3), (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3))


def _mesh(vertices: Array, triangles: NDArray[np.int64]) -> dict[str, Any]:
    """Vertices (V, 3) relative to an origin of their own, so that float32 suffices anywhere."""
    origin = vertices[0]
    return {
        "origin_m": origin.tolist(),
        "vertices": base64.b64encode((vertices - origin).astype("<f4").tobytes()).decode(),
        "triangles": base64.b64encode(triangles.astype("<u4").tobytes()).decode(),
    }
