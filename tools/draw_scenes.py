"""Pictures of scenes for tools/draw.py: rays of the tracer, shaded by how surfaces lie to the light."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from lidarcfg.geometry import Array
from lidarcfg.world.scene import Scene
from lidarcfg.world.tracer import Tracer

LIGHT = np.array([0.45, -0.65, 0.6]) / np.linalg.norm([0.45, -0.65, 0.6])
SKY = (221, 230, 240)
COLOURS = 96  # of a palette: flat shades need no more
SOFT = 2  # rays a pixel along each side
COLOUR_OF = {  # by what an object's name has, the first that fits
    "glass": (120, 140, 165),
    "tiles": (158, 84, 66),
    "brick": (176, 120, 98),
    "plaster": (228, 218, 196),
    "wood": (130, 96, 66),
    "metal": (150, 155, 160),
    "kerb": (150, 150, 150),
    "pavement": (178, 176, 172),
    "hedge": (74, 120, 60),
    "tree": (86, 130, 62),
    "land": (126, 140, 96),
    "lamp": (90, 95, 100),
    "bin": (70, 90, 80),
    "parked": (80, 110, 160),
    "car": (80, 110, 160),
    "trailer": (212, 205, 190),
    "truck": (196, 84, 62),
    "forklift": (226, 160, 40),
    "pallet": (176, 140, 96),
    "container": (92, 128, 118),
    "worker": (236, 140, 40),
    "walker": (150, 60, 110),
    "cyclist": (60, 70, 130),
    "hall": (186, 192, 198),
    "canopy": (150, 155, 160),
    "door": (120, 132, 142),
    "office": (228, 218, 196),
    "gatehouse": (228, 218, 196),
    "mast": (90, 95, 100),
    "body": (122, 150, 196),
    "ground": (222, 222, 218),
    "lidar": (40, 42, 48),
    "driveway": (165, 70, 60),
}
OTHER = (190, 190, 190)
ROAD = (112, 114, 118)
ROAD_M = 3.6


class Camera(NamedTuple):
    """From where, to where, and how wide."""

    eye_m: tuple[float, float, float]
    target_m: tuple[float, float, float]
    fov_deg: float
    pixels: tuple[int, int]


def picture(scene: Scene, camera: Camera, road_m: Array) -> Image.Image:
    """What a camera sees, in the colour of each object, by how its surfaces lie to the light; with shadows.

    `road_m` (N, 2) is the middle of a road, which has no object of its own.
    """
    eye = np.array(camera.eye_m)
    way = _rays(camera)
    tracer = Tracer(scene, eye)
    hits = tracer.cast(np.broadcast_to(eye, way.shape), way)
    seen = np.flatnonzero(np.isfinite(hits.range_m))
    places = eye + way[seen] * hits.range_m[seen, None]
    normal = hits.normal[seen] / np.linalg.norm(hits.normal[seen], axis=1, keepdims=True)
    normal *= np.where((normal * way[seen]).sum(axis=1) > 0, -1, 1)[:, None]
    lit = np.clip(normal @ LIGHT, 0, 1) * ~tracer.blocked(places + 0.01 * normal, places + 200 * LIGHT)
    colours = np.array([_colour(name) for name in scene.names], np.float64)[hits.object[seen]]
    asphalt = np.array([name == "land" for name in scene.names])[hits.object[seen]]
    asphalt[asphalt] = _distance(places[asphalt, :2], road_m) < ROAD_M
    colours[asphalt] = ROAD
    haze = np.clip(hits.range_m[seen, None] / 350, 0, 0.8)
    image = np.tile(np.array(SKY, np.float64), (len(way), 1))
    image[seen] = (1 - haze) * colours * (0.45 + 0.6 * lit)[:, None] + haze * image[seen]
    width, height = camera.pixels
    fine = image.reshape(height, SOFT, width, SOFT, 3).mean(axis=(1, 3))
    return Image.fromarray(np.clip(fine, 0, 255).astype(np.uint8))


def _rays(camera: Camera) -> Array:
    """Unit vectors (pixels, 3), row by row, SOFT × SOFT a pixel."""
    width, height = (SOFT * side for side in camera.pixels)
    ahead, right, up = _axes(camera)
    wide = np.tan(np.radians(camera.fov_deg) / 2)
    x = (np.arange(width) + 0.5 - width / 2) * 2 * wide / width
    y = (height / 2 - np.arange(height) - 0.5) * 2 * wide / width
    way = ahead + x[:, None] * right + y[:, None, None] * up
    return np.asarray((way / np.linalg.norm(way, axis=-1, keepdims=True)).reshape(-1, 3))


def seen_at(camera: Camera, points_m: Array) -> Array:
    """(N, 2): the pixels at which a camera sees points (N, 3)."""
    ahead, right, up = _axes(camera)
    x, y, far = ((np.asarray(points_m) - camera.eye_m) @ np.stack([right, up, ahead], axis=1)).T
    width, height = camera.pixels
    scale = width / 2 / np.tan(np.radians(camera.fov_deg) / 2) / far
    return np.stack([width / 2 + x * scale, height / 2 - y * scale], axis=1)


def _axes(camera: Camera) -> tuple[Array, Array, Array]:
    """Unit vectors: ahead, to the right, up."""
    ahead = np.subtract(camera.target_m, camera.eye_m).astype(np.float64)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    return ahead, right, np.cross(right, ahead)


def _colour(name: str) -> tuple[int, int, int]:
    return next((colour for part, colour in COLOUR_OF.items() if part in name), OTHER)


def _distance(points_m: Array, road_m: Array) -> Array:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(road_m).query(points_m)[0])


def save(image: Image.Image, path: Path) -> None:
    """Write a PNG of few colours, which is small."""
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size:,} bytes")
