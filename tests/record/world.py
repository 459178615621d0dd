"""Cases of the world: rays, motions, insides of bodies, pictures."""

from functools import cache
from pathlib import Path

import numpy as np

from tests.record import package
from tests.record.answers import INPUTS, Answers, case, named

SCENES = "block", "hills", "yard", "wet"


@cache
def scene(name: str):
    """One of the frozen scenes."""
    return package.load_scene(INPUTS / "scenes" / f"{name}.yaml")


def random(seed: int, *shape: int) -> np.ndarray:
    """Random numbers in [0, 1), the same everywhere."""
    return np.random.Generator(np.random.Philox(seed)).random(shape)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) of length 1; by square roots alone, which are exact."""
    return vectors / np.sqrt((vectors * vectors).sum(axis=1))[:, None]


def rays(count: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays from around a point: in fans, along axes, and anywhere."""
    start = at + (random(1, count, 3) - 0.5) * (20, 12, 1)
    start[: count // 2] = at
    way = random(2, count, 3) - (0.5, 0.5, 0.6)
    way[: count // 4] = np.stack(
        [np.linspace(-1, 1, count // 4), np.full(count // 4, 0.7), way[: count // 4, 2] / 4], axis=1
    )
    way[-30:] = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 5, axis=0)
    return start, unit(way)


for each in SCENES:

    @case(f"rays in {each}")
    def _rays(folder: Path, name: str = each) -> Answers:
        """First hits, also at many times and within a limit; and what is between pairs of points."""
        answers: dict[str, object] = {}
        at = np.array([0.3, -0.2, 1.9])
        for number, origin in enumerate((np.zeros(3), np.array([40.0, -25.0, 3.0]))):
            tracer = package.Tracer(scene(name), origin, package.START_NS)
            start, way = rays(6000, at)
            time_ns = package.START_NS + (random(3, len(way)) * 10**9).astype(np.int64)
            for kind, options in (("standing", {}), ("moving", {"time_ns": time_ns}), ("near", {"limit_m": 7.0})):
                time = {"time_ns": np.full(len(way), package.START_NS)} | options
                answers |= named(f"{number} {kind}", tracer.cast(start, way, **time)._asdict())
            answers[f"{number} blocked"] = tracer.blocked(start, start[::-1] + np.array([0.1, 0.2, 0.3]))
            answers[f"{number} blocked from one"] = tracer.blocked(at, start[::-1])
        return answers


@case("rays at edges and corners")
def _corners(folder: Path) -> Answers:
    """Rays exactly at vertices, edges and middles of triangles, and along them."""
    answers: dict[str, object] = {}
    for name in ("sedan", "pedestrian"):
        body = package.load_vehicle(INPUTS / "bodies" / f"{name}.ply").scene
        tracer = package.Tracer(body, np.zeros(3))
        corners = body.vertices_m[body.triangles[::5]]
        at = np.array([-4.0, 3.0, 1.3])
        targets = {"corners": corners[:, 0], "edges": corners[:, :2].mean(axis=1), "middles": corners.mean(axis=1)}
        for key, target in targets.items():
            start = np.broadcast_to(at, target.shape)
            answers |= named(f"{name} {key}", tracer.cast(start, unit(target - at))._asdict())
            answers[f"{name} {key} blocked"] = tracer.blocked(at, target)
        along = tracer.cast(corners[:, 0], unit(corners[:, 1] - corners[:, 0]))
        answers |= named(f"{name} along", along._asdict())
    return answers


@case("motions")
def _motions(folder: Path) -> Answers:
    """Poses of every kind of motion, and points measured under way."""
    answers: dict[str, object] = {}
    (folder / "line.yaml").write_text("velocity_m_s: [3, -1, 0.2]\n")
    (folder / "straight.yaml").write_text("arc: {speed_m_s: 7, yaw_rate_deg_s: 0, heading_deg: 33}\n")
    start = package.pose((4.0, -2.0, 0.3), (0.02, -0.03, 0.7))
    time_ns = package.START_NS + (random(4, 1500) * 10**9).astype(np.int64)
    points = 20 * random(5, len(time_ns), 3) - 10
    files = folder / "line.yaml", folder / "straight.yaml", INPUTS / "trajectory.yaml", INPUTS / "trajectory.tum"
    for path in files:
        moved = package.Trajectory(start, package.load_path(path), package.START_NS)
        R, t = moved.motion(time_ns)
        answers |= named(path.name, {"R": R, "t": t, "world": moved.world(points, time_ns)})
        answers[f"{path.name} pose"] = moved.pose(int(time_ns[7]))
        answers[f"{path.name} velocity"] = moved.velocity_m_s(time_ns)
    for number, motion in enumerate(scene("block").motions):
        if motion:
            R, t = package.build_path(motion).at((time_ns - package.START_NS) / 1e9)
            answers |= named(f"object {number}", {"R": R, "t": t})
    return answers


@case("insides of bodies")
def _insides(folder: Path) -> Answers:
    """Which points of a grid, and which at random places and heights of vertices, are inside of closed bodies."""
    answers: dict[str, object] = {}
    bodies = {"sedan": package.load_vehicle(INPUTS / "bodies" / "sedan.ply")}
    bodies["round"] = package.load_study(INPUTS / "studies" / "round.yaml").vehicle
    for name, one in bodies.items():
        axes = [np.linspace(low, high, 23) for low, high in ((-2.6, 2.6), (-1.1, 1.1), (0, 1.7))]
        for body in one.scene.names:
            answers[f"{name} {body} grid"] = one.inside(body, *axes)
        points = random(6, 4000, 3) * (5, 2.2, 1.8) - (2.5, 1.1, 0)
        vertices = one.scene.mesh()[0]
        points[:1000, 1:] = vertices[np.arange(1000) % len(vertices)][:, 1:]
        answers[f"{name} depth"] = one.depth_m(points)
        answers[f"{name} around"] = np.array([one.body_at(point) is not None for point in points[:300]])
    return answers


@case("pictures")
def _pictures(folder: Path) -> Answers:
    """Translucent triangles behind and in front of points, some of them cut by the near plane."""
    height = 90
    width = 160
    count = 120
    image = np.asarray(255 * random(7, height, width, 3), np.float32)
    depth_m = np.asarray(4 + 30 * random(8, height, width), np.float32)
    depth_m[::3] = np.inf
    corners = random(9, count, 3, 3) * (20, 12, 30) - (10, 6, 2)
    corners[:20] = corners[20:40] + 0.3 * random(10, 20, 3, 3)
    order = np.argsort(-corners[:, :, 2].mean(axis=1), kind="stable")
    colours = 255 * random(11, count, 3)
    alpha = random(12, count)
    blended = package.fill(image, depth_m, corners[order], colours, alpha, 130.0, 0.3)
    return {"image": image, "blended": int(blended)}
