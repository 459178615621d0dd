"""Bodies of 12 to 50,000 triangles with sensors in odd places, and how what they see differs from the plain loop's."""

from typing import NamedTuple

import numpy as np

from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import compare_labels, count_set
from lidarcfg.vsr.visibility import Visibility
from lidarcfg.world.meshes import box_mesh, join_meshes, lathe
from lidarcfg.world.scene_file import Box
from tests.naive import visibility as naive
from tests.ray_cases import mesh_scene

EDGE_M = 1e-9  # a segment that passes nearer to an edge may go either way
GOBLET = np.array(  # radius and height, round a bowl and back down inside it
    [[0, 0], [0.9, 0.02], [0.8, 0.1], [0.15, 0.3], [0.12, 0.9], [0.7, 1.2], [1.0, 1.9], [0.93, 1.88], [0.6, 1.25], [0, 1.1]]
)  # fmt: skip
TABLE = [((0, 0, 1.5), (3, 1.6, 0.12))] + [((x, y, 0.72), (0.1, 0.1, 1.44)) for x in (-1.4, 1.4) for y in (-0.7, 0.7)]
SHARE = {12: 0.5, 60: 0.3, 500: 0.12, 5_000: 0.07, 50_000: 0.01}  # of the pairs, by triangles of the body


class Seen(NamedTuple):
    """How many pairs were compared, how many differ, and how many of those pass within EDGE_M of no edge."""

    pairs: int
    differ: int
    wrong: int


def body(count):
    """A mesh of about so many triangles, and places inside its concavities, under its edges and beside it."""
    if count == 12:
        return box_mesh(Box(name="box", reflectivity=0, center_m=(0, 0, 1), size_m=(4, 2, 1.5))), [
            (2.0, 0.3, 1.1), (2.0, 1.0, 1.75), (2.0, 1.0, 1.0), (0, 0, 1.0), (0, 0, 1.75), (2.0001, 0.3, 1.1),
        ]  # fmt: skip
    if count == 60:
        parts = [box_mesh(Box(name="part", reflectivity=0, center_m=at, size_m=size)) for at, size in TABLE]
        return join_meshes(parts), [
            (1.5, 0.2, 1.44), (1.5, 0.8, 1.44), (1.499, 0.2, 1.43), (0, 0, 1.44), (1.5, 0.2, 1.3), (0, 0.4, 0.7),
        ]  # fmt: skip
    facets = max(count // 80, 8)
    profile = (
        GOBLET if count < 1000 else np.stack([np.interp(np.linspace(0, 9, 41), np.arange(10), c) for c in GOBLET.T], 1)
    )
    facets = count // (2 * (len(profile) - 1))
    return lathe(profile, facets, (0.0, 0.0, 0.3)), [
        (0.1, 0.05, 1.6), (0.5, 0.3, 1.9), (0.4, 0, 1.0), (0.95, 0, 2.1), (0, 0, 2.19), (0.3, -0.2, 3.0),
    ]  # fmt: skip


def on_surface(mesh, rng, count):
    """Places on triangles drawn at random, and vertices."""
    vertices, triangles = mesh
    weights = rng.dirichlet((1, 1, 1), count)
    return [
        *(weights[:, :, None] * vertices[triangles[rng.integers(len(triangles), size=count)]]).sum(axis=1),
        *vertices[:2],
    ]


def seen_cuboids(region, lidars, sight):
    """(lidars, nx, ny, nz) which cuboids each LiDAR sees; none that is excluded."""
    words = compare_labels(region, lidars, sight).seen
    return np.array([count_set(region, row[None]).astype(bool).reshape(region.shape) for row in words])


def compared(count, pairs, rng):
    """About so many pairs of cuboids and LiDARs beside a body of `count` triangles, against the plain loop."""
    mesh, places = body(count)
    corners = mesh[0][mesh[1]]
    done = differ = wrong = 0
    while done < pairs:
        shape = np.array((64, 25, 25) if pairs - done > 40_000 else (20, 10, 10))
        if pairs < 2_000:
            shape = np.array((13, 8, 5))
        size = rng.uniform((3, 2, 1.5), (25, 12, 5))
        low = rng.uniform(-0.7, -0.3, 3) * size + (0, 0, 1)
        region = Region(low, low + size, rng.random(shape) < 0.9)
        origins = [*places, *on_surface(mesh, rng, 3), *rng.uniform(low, low + size, (2, 3))]
        origin = np.asarray(origins[rng.integers(len(origins))], float)
        visibility = Visibility.of([mesh_scene(*mesh)], region)
        lidars = [lidar(origin, rng.uniform(-1, 1, 3), np.array([0.0]))]
        (seen,) = seen_cuboids(region, lidars, visibility.sight(lidars))
        targets = np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1)[region.included]
        hidden = np.empty(len(targets), np.bool_)
        naive.hidden(corners, origin, targets, hidden)
        other = np.flatnonzero(hidden == seen[region.included])
        done = done + len(targets)
        differ = differ + len(other)
        wrong += sum(naive.nearest_edge_m(corners, origin, targets[n]) > EDGE_M for n in other)
        assert not seen[~region.included].any()
    return Seen(done, differ, wrong)
