"""Lists of triangles: each holds what its rays may meet first, and what a list settles is what a cast would say."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.capture.pcap import write_pcap
from lidarcfg.geometry import pose
from lidarcfg.realism import Realism
from lidarcfg.rig import Rig
from lidarcfg.simulate import reach as reach_module
from lidarcfg.simulate.export import START_NS, export, in_time_order
from lidarcfg.simulate.reach import CELL_M, LARGE, Reach, Still
from lidarcfg.units import SECOND_NS
from lidarcfg.world.kernels import NOTHING, Nearest, Rays
from lidarcfg.world.motion import Arc, Motion, Trajectory, prepared
from lidarcfg.world.raycast import Listed, Raycaster
from lidarcfg.world.sights import FEW, MANY, Sights, longest_m, settled, sighted
from lidarcfg.world.triangles import measured
from tests.capture_fixtures import STREET, load_scene, mount, scene, tilted_rig
from tests.naive import placement as naive

STANDS = Motion(velocity_m_s=(0.0, 0.0, 0.0))


def soup(rng, count):
    """Triangles all about, large and small, some out of range, needles, walls one behind another, one without area."""
    middle = rng.normal(size=(count, 1, 3)) * rng.choice([3, 15, 60], (count, 1, 1))
    corners = middle + rng.normal(size=(count, 3, 3)) * rng.choice([0.1, 3, 15], (count, 1, 1))
    corners[0] = [[9, -300, -300], [9, 300, -300], [9, 0, 300]]
    corners[1] = corners[0] + [2, 0, 0]
    corners[2] = corners[3] * [1, 1, 1e-4]
    corners[4, 2] = corners[4, 0]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_met_first_is_in_the_list(seed):
    """By plain loops, for rays that are drawn at their sector's ends and within, as far off as they may be."""
    rng = np.random.default_rng(seed)
    vertices, triangles = soup(rng, 24)
    large = np.sort(rng.permutation(24)[:20])
    T = pose(rng.normal(size=3), rng.uniform(-3, 3, 3))
    R, t, range_m, off_m, wide = T[:3, :3].copy(), T[:3, 3].copy(), 50.0, *((0.3, 0.02) if seed % 2 else (0.01, 1e-4))
    elevation, offset, sectors = np.radians([-90, -50, -3, 0.5, 20, 88.9]), rng.uniform(-0.5, 0.5, 6), 90
    fan = np.stack([np.sin(elevation), np.cos(elevation), offset])
    many = rng.random((6, sectors)) < 0.1
    sights = sighted(vertices, triangles, large, R, t, range_m, off_m, wide, fan, many)
    assert (sights.which.T[many] == MANY).all()
    corners, hidden = vertices[triangles].tolist(), 0
    for laser in range(6):
        for sector in range(sectors):
            row = sights.which[sector, laser]
            if row == MANY:
                continue
            listed = [int(large[c]) for c in sights.lists[row] if c >= 0]
            assert listed == sorted(set(listed))
            for share in (0, rng.random(), 1):
                azimuth = (sector + share) * 2 * math.pi / sectors + offset[laser]
                e, push = elevation[laser], rng.normal(size=3)
                way = np.array([math.cos(e) * math.cos(azimuth), -math.cos(e) * math.sin(azimuth), math.sin(e)])
                way = way + push / np.linalg.norm(push) * math.sin(wide) * rng.choice([0, 0.99])
                way, start = R @ (way / np.linalg.norm(way)), rng.normal(size=3)
                start = t + start / np.linalg.norm(start) * off_m * rng.random()
                met = [(naive.entered(corners[c], start.tolist(), way.tolist()), int(c)) for c in large]
                met = sorted((far[0], c) for far, c in met if far and far[0] <= range_m)
                assert not met or met[0][1] in listed
                hidden += len(met[1:]) > 0 and met[-1][1] not in listed
    assert hidden > 0
    assert (sights.which != MANY).mean() > 0.5
    assert (sights.lists >= 0).sum(axis=1).max() > 2
    assert len(sighted(vertices, triangles, large, R, t, range_m, off_m, wide, fan, many | True).lists) == 1


def every(vertices, triangles, large):
    """Sights whose only list has all triangles."""
    fan, none = np.array([[0.0], [1.0], [0.0]]), np.zeros((1, 1), np.bool_)
    return sighted(vertices, triangles, large, np.eye(3), np.zeros(3), 1e9, 1e3, 1.5, fan, none)


BODIES = {
    "a room": "boxes: [{name: b, center_m: [1, 2, 0.5], size_m: [9, 7, 5], yaw_deg: 20, reflectivity: 9}]",
    "box on box": "boxes: [{name: a, center_m: [9, 0, 0], size_m: [3, 3, 1], reflectivity: 9}, "
    "{name: b, center_m: [9, 0, 1], size_m: [3, 3, 1], reflectivity: 20}]",
    "a kerb": "boxes: [{name: k, center_m: [0, 5, -1.9], size_m: [85, 4, 0.12], reflectivity: 9}]",
    "thin": "boxes: [{name: t, center_m: [6, 1, 0], size_m: [0.02, 8, 3], yaw_deg: 2, reflectivity: 9}]",
}


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("place_m", [(0, 0, 0), (480.3, -499, 20)])
def test_a_list_settles_what_a_cast_says(tmp_path, name, place_m):
    """Bit for bit, for rays aimed anywhere, at edges and at corners, and beside these by hairs and more."""
    rng = np.random.default_rng(1)
    stage = scene(tmp_path, BODIES[name] + "\nground: {z_m: -2, reflectivity: 12}")
    stage = replace(stage, vertices_m=stage.vertices_m + place_m)
    still, settled_of = Still(Raycaster(stage, np.zeros(3))), []
    chosen = rng.permutation(len(still.triangles))[:FEW]  # a list holds no more
    stage = replace(stage, triangles=stage.triangles[chosen], triangle_object=stage.triangle_object[chosen])
    caster = Raycaster(stage, np.zeros(3))
    sights = every(stage.vertices_m - place_m, caster.still_triangles, np.arange(len(chosen)))
    sights = sights._replace(apex_m=np.array(place_m, float))
    corners = stage.vertices_m[caster.still_triangles]
    for beside_m in (0, 1e-5, 2e-4, 1e-3, 3e-3, 0.3):
        weights = np.concatenate([rng.dirichlet(np.ones(3), 3000), np.eye(3)[rng.integers(3, size=1000)]])
        edge = rng.dirichlet(np.ones(2), 2000)
        weights = np.concatenate([weights, np.stack([edge[:, 0], 0 * edge[:, 0], edge[:, 1]], axis=1)])
        aim = np.einsum("nk,nkd->nd", weights, corners[rng.integers(len(corners), size=len(weights))])
        start = place_m + rng.uniform(-0.3, 0.3, (len(aim), 3))
        way = aim + rng.normal(size=aim.shape) * beside_m - start
        way /= np.linalg.norm(way, axis=1)[:, None]
        listed = Listed(np.zeros(len(way), np.int32), sights)
        cast, told = (caster.cast(start, way, normals=True, listed=these) for these in (None, listed))
        for one, other in zip(cast[:4], told[:4], strict=True):
            assert np.array_equal(one, other)
        assert cast.settled == 0
        settled_of.append(told.settled / len(way))
    assert settled_of[-1] > (0.1 if name == "a kerb" else 0.4)


def test_settled_by_hand():
    """A wall at 9 m and one at 9.04 m, a needle, one behind the ray, one seen too flat; the rest is left to a cast."""
    wall = np.array([[9.0, -4, -4], [9, 4, -4], [9, 0, 4]])
    needle = np.array([[5.0, -5, 0], [5, 5, 0], [5, 5, 1e-3]])
    corners = np.concatenate(
        [wall, wall + np.array([0.04, 0, 0]), needle, -wall, [[3.0, 9, -1], [300, 9.5, -1], [3, 9, 9]]]
    )
    triangles, ahead = np.arange(15).reshape(-1, 3), np.array([1.0, 0, 0])
    facets, _ = measured(corners, triangles, np.arange(5, dtype=np.int32))
    cases = [
        ([0, 3], ahead, True, 9.0),  # the one behind does not matter
        ([0, 1], ahead, False, np.inf),  # 4 cm apart
        ([0], [0.6, 0.8, 0], True, np.inf),  # well beside it
        ([0], [9 / math.hypot(9, 4, 4 + 1e-3), 4 / math.hypot(9, 4, 4 + 1e-3), -4.001 / math.hypot(9, 4, 4.001)], False, np.inf),
        ([2], [1, 0, 5e-4 / 5], False, np.inf),  # within 2 mm of its edges
        ([4], np.array([100.0, 9.2, 0.1]) / math.hypot(100, 9.2, 0.1), False, np.inf),
    ]  # fmt: skip
    for listed, way, clear, range_m in cases:
        sights = every(corners, triangles, np.array(listed))
        nearest = Nearest(np.full(1, np.inf), np.full(1, NOTHING, np.int32), np.zeros((1, 3), np.float32))
        rays = Rays(np.zeros((1, 3)), np.array([way], float), np.zeros(1, np.int64))
        left = settled(rays, np.zeros(1, np.int64), np.zeros(1, np.int32), sights, np.zeros(3), facets, nearest)
        assert (len(left) == 0) == clear
        assert nearest.range_m[0] == range_m
        assert nearest.object[0] == (listed[0] if range_m < np.inf else NOTHING)


def both(tmp_path, monkeypatch, rig, stage, motion, beams, duration_ns=SECOND_NS // 5):
    """The captures and the truth with lists from so many beams on and without any skipping; counts of rays."""
    monkeypatch.setattr(reach_module, "BEAMS", beams)
    way, found, counts = Trajectory(np.eye(4), prepared(motion), START_NS), [], []
    for skip in (True, False):
        truth = []
        streams = export(rig, stage, way, duration_ns, chunk_ns=SECOND_NS // 20, on_truth=truth.append,
                         on_rays=counts.append if skip else lambda counts: None, skip=skip)  # fmt: skip
        write_pcap(tmp_path / "a.pcap", in_time_order(streams))
        found.append(((tmp_path / "a.pcap").read_bytes(), np.concatenate(truth).tobytes()))
    return found, np.sum(counts, axis=0)


@pytest.mark.parametrize("mode", ["strongest", "last", "dual"])
def test_the_same_bytes_of_beams_that_spread(tmp_path, monkeypatch, mode):
    """With divergence, noise and fog, in the street: what is sent and what is true of it."""
    real = Realism(divergence=True, range_noise_m=0.02, seed=3)
    sensors = tuple(replace(one, return_mode=mode, realism=real) for one in tilted_rig().mounts)
    stage = load_scene(STREET)
    (one, other), (rays, nothing, few) = both(tmp_path, monkeypatch, Rig("r", sensors), stage, STANDS, 0)
    assert one == other
    assert nothing > rays / 20
    assert few > rays / 3


@pytest.mark.parametrize(
    "motion",
    [STANDS, Motion(velocity_m_s=(0.3, 0, 0)), Motion(velocity_m_s=(20.0, 0, 0)), Motion(arc=Arc(speed_m_s=3, yaw_rate_deg_s=90))],
)  # fmt: skip
def test_the_same_bytes_on_the_way(tmp_path, monkeypatch, motion):
    """Through the street, with lists as soon as they can be."""
    (one, other), (rays, _, few) = both(tmp_path, monkeypatch, tilted_rig(), load_scene(STREET), motion, 0)
    assert one == other
    assert few > rays / 20


def far_plate(side_m):
    """A square whose nearest edge passes 6 m ahead, askew, so that float32 moves it by what its far corners are off."""
    turn, far_m = math.radians(33), 6 + side_m / 2
    at = f"[{far_m * math.cos(turn)}, {far_m * math.sin(turn)}, 0.37]"
    return f"planes: [{{name: p, center_m: {at}, size_m: [{side_m}, {side_m}], rpy_deg: [0, 0, 33], reflectivity: 9}}]"


@pytest.mark.parametrize("side_m", [100, 1e4, 1e5, 1e6])
def test_edges_of_what_reaches_far(tmp_path, side_m):
    """A list settles less near these, as they are where float32 has them; a cast says what it said."""
    rng = np.random.default_rng(3)
    caster = Raycaster(scene(tmp_path, far_plate(side_m)), np.zeros(3))
    sights = every(caster.scene.vertices_m, caster.still_triangles, np.arange(2))
    out = np.array([math.cos(math.radians(33)), math.sin(math.radians(33)), 0])
    along, beside_m = rng.uniform(-40, 40, 20_000), rng.choice([-1, 1], 20_000) * 10 ** rng.uniform(-3, 0, 20_000)
    aim = [0, 0, 0.37] + out * (6 + beside_m[:, None]) + np.array([-out[1], out[0], 0]) * along[:, None]
    start = np.array([0.1, 0.2, 2.1])
    way = (aim - start) / np.linalg.norm(aim - start, axis=1)[:, None]
    start = np.repeat(start[None], len(way), axis=0)
    cast, told = (
        caster.cast(start, way, listed=these) for these in (None, Listed(np.zeros(len(way), np.int32), sights))
    )
    assert np.array_equal(cast.range_m, told.range_m)
    assert (told.settled > len(way) / 2) == (side_m == 100)


def test_the_same_bytes_beside_what_reaches_far(tmp_path, monkeypatch):
    """Lists leave out what is beside their rays only if float32 does not move it there."""
    stage, sensors = scene(tmp_path, far_plate(1e6)), tuple(mount(k, (0.02 * k, 0, 2.0), (1, 2 + k, 0)) for k in (0, 1))
    (one, other), _ = both(tmp_path, monkeypatch, Rig("r", sensors), stage, STANDS, 0)
    assert one == other


def test_the_same_bytes_of_what_is_behind(tmp_path, monkeypatch):
    """A cast meets a slender strip that a beam left behind: by float32 it is ahead, and before the wall."""
    wall = "boxes: [{name: far, center_m: [3, 1, 1], size_m: [150, 150, 150], yaw_deg: 5, reflectivity: 50}]"
    strip = (
        "planes: [{name: strip, center_m: [3.217, 1.113, 1.037], size_m: [300, 0.02], reflectivity: 9, "
        "rpy_deg: [78.93851488032882, 2.12032263031125, 37.267903375846586]}]"
    )
    rpy_rad = -1.3243558659451848, -0.5167700164813327, 0.3670590323599446
    one = replace(mount(0, (2.39309365557182, 2.756799556602684, 10.289941865942)), rpy_rad=rpy_rad)
    stage = scene(tmp_path, strip + "\n" + wall)
    (one, other), _ = both(tmp_path, monkeypatch, Rig("r", (one,)), stage, STANDS, 0, SECOND_NS // 10)
    assert one == other


def test_the_same_bytes_across_a_border_of_local_origins(tmp_path, monkeypatch):
    """500 m off a sensor passes it within a chunk before its first beam that may meet anything."""
    wall = "boxes: [{name: w, center_m: [480.123, 3.3, 1.1], size_m: [5.7, 20, 8], yaw_deg: 20.3, reflectivity: 9}]"
    stage, motion = scene(tmp_path, wall), Motion(velocity_m_s=(1.0, 0.0, 0.0))
    rig = Rig("r", (mount(0, (499.97, 0.0, 2.0)),))
    (one, other), _ = both(tmp_path, monkeypatch, rig, stage, motion, 0, SECOND_NS // 20)
    assert one == other


def test_lists_are_made_when_they_are_worth_it(tmp_path, monkeypatch):
    """After some beams; never for a time for which they do not hold, nor where little would be listed."""
    room = scene(tmp_path, "boxes: [{name: b, center_m: [0, 0, 1], size_m: [300, 20, 8], reflectivity: 9}]")
    still = Still(Raycaster(room, np.zeros(3)))
    assert still.large.tolist() == list(range(12))
    assert len(still.small.radius_m) == 0

    def when(motion, stage=room, steps=40):
        caster = Raycaster(stage, np.zeros(3), START_NS)
        way = Trajectory(np.eye(4), prepared(motion), START_NS)
        reach, step = Reach(mount(), caster, Still(caster), way, 0.0), SECOND_NS // 1000
        found = [reach.known(START_NS + k * step, START_NS + (k + 1) * step) for k in range(steps)]
        return [k for k, known in enumerate(found) if known and known.sights]

    beams_a_step = 16 * 1e6 / 55296
    first = math.ceil(reach_module.BEAMS * 16 * 12 / beams_a_step)
    assert when(STANDS) == list(range(first, 40))
    assert when(Motion(velocity_m_s=(300.0, 0, 0))) == []  # tables hold for 3 ms
    seldom = when(Motion(velocity_m_s=(100.0, 0, 0)))  # for 10 ms, and then are passed over until it has got on
    assert all(k % (10 * (reach_module.PATIENCE + 1)) >= first for k in seldom)
    grid = "\n".join(
        f"- {{name: s{k}, center_m: [{5 + k}, {k % 3}, 0], radius_m: 3, reflectivity: 9}}" for k in range(9)
    )
    monkeypatch.setattr(reach_module, "BEAMS", 0)
    assert when(STANDS, scene(tmp_path, "spheres:\n" + grid)) == []
    monkeypatch.setattr(reach_module, "sighted", None)  # where nothing is large none are asked for
    assert (
        when(STANDS, scene(tmp_path, "spheres: [{name: s, center_m: [5, 0, 1], radius_m: 0.5, reflectivity: 9}]")) == []
    )


def test_the_largest_are_chosen(tmp_path, monkeypatch):
    monkeypatch.setattr(reach_module, "LARGE", 8)
    boxes = "".join(
        f"\n- {{name: b{k}, center_m: [{9 * k}, 0, 1], size_m: [{k}, 2, 0.5], reflectivity: 9}}" for k in (1, 2, 3)
    )
    caster = Raycaster(scene(tmp_path, "boxes:" + boxes), np.zeros(3))
    still = Still(caster)
    length_m = longest_m(still.vertices_m, still.triangles)
    corners = still.vertices_m[still.triangles]
    assert length_m.tolist() == [max(math.dist(c[i], c[i - 1]) for i in range(3)) for c in corners]
    assert len(still.large) == 8
    assert length_m[still.large].min() >= np.delete(length_m, still.large).max() > CELL_M
    assert len(still.small.radius_m) > 0
    assert LARGE > 8
    assert Sights._fields[0] == "apex_m"
