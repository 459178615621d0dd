"""Aiming, tracing of firings and merging of echoes in the core, on small cases."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from lidarcfg.core import simulate, world
from tests.core.records import replaced

NOW_NS = 1_700_000_000 * 10**9
NO_SHAPES = np.empty((0, 9)), np.empty(0, np.uint8), np.empty(0, np.int32), np.empty(0, np.int32)
BALL = [10.0, 0, 1, 2, 0, 0, 0, 0, 0]  # centre, radius


def sphere(shape=BALL):
    """A hierarchy over a sphere, which is object 1."""
    return world.Bvh(np.array([shape]), np.ones(1, np.uint8), np.zeros(1, np.int32), np.ones(1, np.int32))


def scene(fixed, velocity_m_s=None):
    """A world of a ground and a sphere, which moves if it is given a velocity."""
    if velocity_m_s is None:
        return world.World(0.0, fixed, [], np.empty((0, 3)), np.empty(0), [])
    path = world.path_of_velocity(velocity_m_s)
    speed_m_s = np.array([np.linalg.norm(velocity_m_s)])
    return world.World(0.0, world.Bvh(*NO_SHAPES), [fixed], np.zeros((1, 3)), speed_m_s, [path])


def lasers(elevation_deg, width=1):
    """Lasers in the middle of the sensor, whose beams have one ray or nine."""
    elevation = np.radians(np.array(elevation_deg, np.float64))
    zero = np.zeros(len(elevation))
    spread = np.linspace(-0.01, 0.01, width) if width > 1 else np.zeros(1)
    return simulate.Lasers(
        np.cos(elevation), np.sin(elevation), zero + 1, zero, zero, zero, zero, spread, spread[::-1].copy()
    )


def mounting(height_m=1.0, velocity_m_s=(0.0, 0.0, 0.0)):
    """A vehicle at the origin, whose sensor looks along x where its encoder is at 0, and then to the right."""
    T = np.eye(4)
    T[2, 3] = height_m
    return simulate.Mounting(np.eye(4), world.path_of_velocity(velocity_m_s), NOW_NS, T)


def firings(encoder_deg, laser=0, after_ns=0):
    encoder = np.radians(np.array(encoder_deg, np.float64))
    columns = np.broadcast_arrays(NOW_NS + np.int64(after_ns), np.uint8(laser), encoder)
    kinds = np.int64, np.uint8, float
    ready = (np.ascontiguousarray(one, kind) for one, kind in zip(columns, kinds, strict=True))
    return simulate.Firings(*ready, np.empty(0), np.empty((0, 3)))


def empty(count, width=1):
    kinds = np.float64, np.uint8, np.int32, np.float64
    return simulate.Hits(*(np.zeros((count, width), kind) for kind in kinds))


def room(count, columns):
    kinds = np.float64, np.uint8, np.int32
    return simulate.Candidates(*(np.zeros((count, columns), kind) for kind in kinds))


def arguments(fired, width=1, stage=None, bodies=None, **changed):
    """What `trace_firings` is called with, and then what is written."""
    stage = stage or scene(sphere())
    bodies = bodies or world.Bvh(*NO_SHAPES)
    slots = 2 + len(stage) + len(bodies)
    given = {
        "world": stage,
        "bodies": bodies,
        "surfaces": simulate.Surfaces(
            np.minimum(np.arange(-1, slots - 1, dtype=np.int32), 2), np.array([0, 30, 50, 70], np.uint8)
        ),
        "lasers": lasers([0.0, -30.0], width),
        "mounting": mounting(),
        "firings": fired,
        "zero_ns": NOW_NS,
        "limit_m": 100.0,
        "hits": empty(len(fired.time_ns), width),
    }
    return given | changed


def traced(*words, **changed):
    given = arguments(*words, **changed)
    simulate.trace_firings(**given)
    return given["hits"]


def test_beams_hit_the_sphere_the_ground_or_nothing():
    found = traced(firings([0, 0, 90], [0, 1, 0]))
    assert found.range_m.ravel() == pytest.approx([8, 2, np.inf])
    assert found.object.ravel().tolist() == [1, 0, -1]
    assert found.reflectivity.ravel().tolist() == [50, 30, 0]
    assert found.cosine.ravel() == pytest.approx([1, 0.5, 1])


def test_beams_with_elevations_of_their_own():
    """As those of lasers of these elevations, whichever laser fires."""
    rng = np.random.default_rng(2)
    head_deg = rng.uniform(0, 360, 400)
    laser = rng.integers(0, 2, 400)
    found = traced(firings(head_deg, laser))
    own = firings(head_deg, rng.integers(0, 2, 400))
    own = replaced(own, elevation_rad=np.arcsin(lasers([0, -30]).sin_elevation)[laser])
    np.testing.assert_allclose(traced(own).range_m, found.range_m, rtol=1e-9)
    assert 0 < np.isfinite(found.range_m).sum() < 400


def test_beams_with_starts_of_their_own():
    """A beam ahead that starts 0.5 m ahead of the sensor is 0.5 m shorter, down from 0.3 m higher 0.6 m longer."""
    fired = firings([0, 0], [0, 1])
    found = traced(replaced(fired, start_m=np.array([[0.5, 0, 0], [0.1, 0.2, 0.3]])))
    assert found.range_m.ravel() == pytest.approx([7.5, 2.6])


def test_no_firings():
    assert traced(firings([])).range_m.shape == (0, 1)


def test_what_moves_is_where_it_is_then():
    """The sphere drives away, or the vehicle drives towards it; half a second later it is 3 m farther, or nearer."""
    fired = firings([0, 0], 0, [0, 500_000_000])
    away = traced(fired, stage=scene(sphere(), (6.0, 0.0, 0.0)))
    assert away.range_m.ravel() == pytest.approx([8, 11])
    towards = traced(fired, mounting=mounting(velocity_m_s=(6.0, 0.0, 0.0)))
    assert towards.range_m.ravel() == pytest.approx([8, 5])


def test_a_body_hides_what_is_behind_it():
    found = traced(firings([0, 180]), bodies=sphere([3.0, 0, 1, 1, 0, 0, 0, 0, 0]))
    assert found.range_m.ravel() == pytest.approx([2, np.inf])
    assert found.object.ravel().tolist() == [2, -1]


@pytest.mark.parametrize("velocity_m_s", [None, (3.0, 2.0, 0.0)])
def test_rays_of_wide_beams_are_those_of_thin_ones(velocity_m_s):
    """In all directions, so that some beams have rays that face different ways; on several threads."""
    stage = scene(sphere(), velocity_m_s)
    rng = np.random.default_rng(1)
    fired = firings(rng.uniform(0, 360, 500), rng.integers(0, 2, 500), rng.integers(0, 10**9, 500))
    bodies = sphere([2.0, -1, 1, 0.5, 0, 0, 0, 0, 0])
    with ThreadPoolExecutor(3) as pool:
        runs = list(pool.map(lambda _: traced(fired, 9, stage=stage, bodies=bodies), range(3)))
    for k in range(9):
        both = lasers([0.0, -30.0], 9)
        thin = replaced(both, across=both.across[k : k + 1], above=both.above[k : k + 1])
        alone = traced(fired, stage=stage, bodies=bodies, lasers=thin)
        for whole in runs:
            for key in ("range_m", "reflectivity", "object", "cosine"):
                np.testing.assert_array_equal(getattr(whole, key)[:, k], getattr(alone, key)[:, 0])


def test_wild_times_and_angles():
    """Firings a century apart, and angles that are no numbers, harm nothing."""
    fired = firings([0, 0, 0], 0, [0, 10**18, -(10**18)])
    fired.encoder_rad[2] = np.nan
    found = traced(fired, stage=scene(sphere(), (0.0, 0.0, 0.0)))
    assert found.range_m.ravel()[:2] == pytest.approx([8, 8])


def test_times_from_the_first_to_the_last_there_is():
    stage = scene(sphere(), (0.0, 0.0, 0.0))
    fired = replaced(firings([0, 0, 0]), time_ns=np.array([-(2**63), 0, 2**63 - 1]))
    assert traced(fired, stage=stage).range_m.ravel() == pytest.approx([8, 8, 8])


FIRED = firings([90, 0])


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("firings", replaced(FIRED, laser=np.array([0, 2], np.uint8)), "firings.laser: one of the lasers"),
        ("firings", replaced(FIRED, laser=np.zeros(1, np.uint8)), "firings.laser: one for each time"),
        ("firings", replaced(FIRED, encoder_rad=np.zeros(3)), "firings.encoder_rad: one for each time"),
        ("firings", replaced(FIRED, elevation_rad=np.zeros(1)), "firings.elevation_rad: one for each time, or none"),
        ("lasers", lasers([0.0], 3), "lasers.across: one or nine"),
        ("lasers", replaced(lasers([0.0]), up_m=np.zeros(2)), "lasers.up_m: one for each laser"),
        (
            "surfaces",
            simulate.Surfaces(np.zeros(4, np.int32), np.zeros(2, np.uint8)),
            "surfaces.object: of nothing, the ground",
        ),
        (
            "surfaces",
            simulate.Surfaces(np.full(3, 1, np.int32), np.zeros(2, np.uint8)),
            "surfaces.object: those of surfaces.refl",
        ),
        ("hits", empty(3), "hits.range_m: one for each ray"),
        ("hits", replaced(empty(2), cosine=np.zeros((1, 1))), "hits.cosine: one for each ray, or none"),
    ],
)
def test_refusals_of_tracing(argument, value, message):
    with pytest.raises((TypeError, ValueError), match=message):
        traced(FIRED, **{argument: value})


@pytest.mark.parametrize(
    ("struct", "changed", "message"),
    [
        (FIRED, {"encoder_rad": np.zeros(2, np.float32)}, "encoder_rad: float32 of shape"),
        (empty(2), {"object": np.broadcast_to(np.int32(0), (2, 1))}, "object: int32 of shape"),
        (mounting(), {"T_vehicle_sensor": np.eye(3)}, r"T_vehicle_sensor: .* allowed: .*shape=\(4, 4\)"),
        (mounting(), {"path": sphere()}, "path: of type .*Bvh; allowed: .*Path"),
        (mounting(), {"zero_ns": 0.5}, "zero_ns: not an integer, but float"),
    ],
)
def test_structs_are_of_what_fits(struct, changed, message):
    with pytest.raises(TypeError, match=f"^{message}"):
        replaced(struct, **changed)


def merged(range_m, which=range(6), **changed):
    """The candidates of beams that hit object 1, whose rays weigh the same."""
    range_m = np.array(range_m, np.float64)
    shape = range_m.shape
    columns = len(which)
    rays = simulate.SubRays(
        range_m,
        np.full(shape, 50, np.uint8),
        np.ones(shape, np.int32),
        np.ones(shape),
        np.zeros(len(range_m), np.uint8),
    )
    given = {
        "rays": rays,
        "weights": np.full(shape[1], 1 / shape[1]),
        "range_max_m": 100.0,
        "step_rad": 0.0,
        "least": 0.0,
        "droplets": np.empty((0, 2)),
        "fade": np.empty((0, 0)),
        "which": np.array(which, np.uint8),
        "out": room(len(range_m), columns),
    }
    given |= changed
    simulate.merge_echoes(**given)
    return given["out"]


def test_echoes_merge_within_a_metre():
    found = merged([[9, 3, 3.5], [np.inf, 150, np.nan]])
    assert found.range_m[0] == pytest.approx([3.2118, 3.2118, 9, 3.2118, 9, 9], abs=1e-4)
    assert found.reflectivity[0].tolist() == [33, 33, 17, 33, 17, 17]
    assert np.isinf(found.range_m[1]).all()
    assert found.object.tolist() == [[1] * 6, [-1] * 6]
    assert merged([[9, 3, 3.5]], which=[2, 0]).range_m == pytest.approx(found.range_m[:1, [2, 0]])
    assert merged(np.empty((0, 3))).range_m.shape == (0, 6)


def test_rain_before_everything_else():
    droplets = np.array([[2.0, 0.5]])
    fade = np.ones((1, 2))
    found = merged([[9.0]], which=[3, 2], droplets=droplets, fade=fade)
    assert found.range_m.tolist() == [[2, 9]]
    assert found.object.tolist() == [[-1, 1]]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"weights": np.empty(0)}, "weights: at least one"),
        ({"weights": np.ones(2)}, "rays.range_m: a column for each weight"),
        ({"which": np.array([6], np.uint8)}, "which: below six"),
        ({"out": room(2, 6)}, "out.range_m: one for each firing and of which"),
        ({"droplets": np.ones((1, 2))}, "droplets: one for each firing"),
        ({"fade": np.ones((1, 1))}, "droplets: one for each firing"),
        ({"fade": np.ones((1, 1)), "droplets": np.ones((1, 2))}, "fade: one for each ray and one more"),
    ],
)
def test_refusals_of_merging(changed, message):
    with pytest.raises(ValueError, match=message):
        merged([[1.0]], **changed)
