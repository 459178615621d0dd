"""Hierarchies, rays, motions and solids of the core, on small cases."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.core import world
from tests.core.records import fields_of

TRIANGLE, SPHERE, CYLINDER = range(3)
NOTHING = -2
GROUND = -1


def bvh(shapes, kind=TRIANGLE):
    """Of shapes (S, 9), numbered; object 10 n is number n's."""
    shapes = np.asarray(shapes, np.float64).reshape(-1, 9)
    number = np.arange(len(shapes), dtype=np.int32)
    return world.Bvh(shapes, np.broadcast_to(np.uint8(kind), len(shapes)).copy(), number, 10 * number)


def round_shape(*values):
    """A sphere's or a cylinder's row."""
    return [*values, *[0.0] * (9 - len(values))]


def first(tree, origins, way, limit_m=np.inf):
    """Ranges and slots (N,) of rays (N, 3)."""
    range_m = np.empty(len(way))
    slot = np.empty(len(way), np.int32)
    columns = (np.ascontiguousarray(np.transpose(rows), np.float64) for rows in (origins, way))
    world.first_hits(tree, *columns, limit_m, range_m, slot)
    return range_m, slot


def blocked(tree, origins, way):
    """(N,) whether segments (N, 3) are."""
    hit = np.empty(len(way), np.bool_)
    world.any_hits(tree, *(np.ascontiguousarray(np.transpose(rows), np.float64) for rows in (origins, way)), hit)
    return hit


def soup(rng, count, size=1.0):
    """Triangles (count, 9) around the origin."""
    return (rng.uniform(-5, 5, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * size).reshape(-1, 9)


def rays(rng, count):
    """Origins and unit vectors (count, 3), some of them along axes."""
    way = rng.normal(size=(count, 3))
    way[::5, rng.integers(3)] = 0.0
    way[::7] = rng.permutation(np.concatenate([np.eye(3), -np.eye(3)]))[0]
    return rng.uniform(-6, 6, (count, 3)), way / np.linalg.norm(way, axis=1)[:, None]


def by_all(shapes, origins, way):
    """(N,) the ranges by a loop over all triangles (Möller and Trumbore 1997)."""
    best = np.full(len(way), np.inf)
    for a, b, c in shapes.reshape(-1, 3, 3):
        across = np.cross(way, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            det = across @ (b - a)
            u = ((origins - a) * across).sum(axis=1) / det
            q = np.cross(origins - a, b - a)
            v = (q * way).sum(axis=1) / det
            far = q @ (c - a) / det
        best = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0) & (far < best), far, best)
    return best


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.sampled_from([0.05, 1.0]))
def test_triangles_are_hit_as_by_a_loop(seed, count, size):
    rng = np.random.default_rng(seed)
    shapes, (origins, way) = soup(rng, count, size), rays(rng, 200)
    tree = bvh(shapes)
    range_m, slot = first(tree, origins, way)
    expected = by_all(shapes, origins, way)
    assert (np.isfinite(range_m) != np.isfinite(expected)).sum() <= 1  # at an edge
    both = np.isfinite(range_m) & np.isfinite(expected)
    np.testing.assert_allclose(range_m[both], expected[both], rtol=1e-6)
    assert np.array_equal(slot >= 0, np.isfinite(range_m))
    assert np.array_equal(np.sort(tree.number), np.arange(count))
    assert np.array_equal(tree.shapes, shapes[tree.number])
    assert np.array_equal(tree.object, 10 * tree.number)
    length = 4.0
    assert np.array_equal(blocked(tree, origins, way * length), range_m < length * (1 - 1e-9))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_ray_hits_what_it_hits_alone(seed):
    rng = np.random.default_rng(seed)
    rounds = [round_shape(*rng.uniform(-5, 5, 3), *rng.uniform(0.1, 2, 2)) for _ in range(6)]
    tree = bvh(np.concatenate([soup(rng, 40), rounds]), [TRIANGLE] * 40 + [SPHERE] * 3 + [CYLINDER] * 3)
    origins, way = rays(rng, 100)
    range_m, slot = first(tree, origins, way)
    odd = origins.copy(), way.copy()
    odd[0][::9] = np.nan
    odd[1][1::9] = rng.choice([np.nan, np.inf, -np.inf, 0.0], (len(way[1::9]), 3))
    beside, its = first(tree, *odd)
    keep = (np.arange(100) % 9) > 1
    assert np.array_equal(beside[keep], range_m[keep])
    assert np.array_equal(its[keep], slot[keep])
    for n in range(0, 100, 11):
        assert [part[0] for part in first(tree, origins[n : n + 1], way[n : n + 1])] == [range_m[n], slot[n]]


def test_round_shapes_by_hand():
    tree = bvh([round_shape(10, 0, 0, 2), round_shape(0, 10, -1, 1, 3)], [SPHERE, CYLINDER])
    way = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0]]
    range_m, slot = first(tree, np.zeros((4, 3)), way)
    assert range_m.tolist() == [8.0, 9.0, np.inf, np.inf]
    assert tree.number[slot[:2]].tolist() == [0, 1]
    assert first(tree, [[0, 10, 5]], [[0, 0, -1]])[0] == [3.0]  # onto the top
    assert first(tree, [[10, 0, 0]], [[0, 0, -1]])[0] == [2.0]  # from inside
    assert blocked(tree, np.zeros((3, 3)), [[8, 0, 0], [8.1, 0, 0], [12, 0, 0]]).tolist() == [False, True, True]


def test_of_two_at_the_same_range_the_first_slot_is_hit():
    shapes = np.tile(soup(np.random.default_rng(1), 1), (9, 1))
    middle = shapes[0].reshape(3, 3).mean(axis=0)
    assert first(bvh(shapes), middle[None] + [0, 0, 1], [[0, 0, -1.0]])[1] == [0]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 5000])
def test_shapes_that_cannot_be_told_apart(count):
    """Nor can trees of them be too deep; nor do shapes that are no numbers matter to others."""
    tree = bvh(np.ones((count, 9)))
    assert len(tree) == len(tree.number) == count
    assert first(tree, [[0, 0, 0]], [[1, 0, 0]])[1] == [NOTHING]
    growing = np.cumprod(np.full(60, 3.0))[:, None] * soup(np.random.default_rng(2), 60)
    growing[::7] = np.nan
    growing[3] = np.inf
    assert np.isfinite(first(bvh(growing), np.zeros((500, 3)), rays(np.random.default_rng(3), 500)[1])[0]).any()
    assert first(bvh(growing), np.empty((0, 3)), np.empty((0, 3)))[0].size == 0


def quad(x, half=1.0):
    """A square across x as two triangles (2, 9)."""
    a, b, c, d = ([x, y, z] for y, z in ((-half, -half), (half, -half), (half, half), (-half, half)))
    return np.array([[*a, *b, *c], [*a, *c, *d]])


def cast(whole, origins, way, seconds, limit_m=np.inf):
    """What rays (N, 3) at times (N,) hit."""
    count = len(way)
    found = world.Found(np.empty(count), np.empty(count, np.int32), np.zeros((count, 3)), np.empty(count))
    columns = (np.ascontiguousarray(np.transpose(rows), np.float64) for rows in (origins, way))
    whole.cast(*columns, np.asarray(seconds, np.float64), limit_m, found)
    return found


def test_boxes_hold_all_shapes():
    assert world.boxes_of(bvh([])).shape == (6, 0)
    rng = np.random.default_rng(1)
    for count in (1, 2, 40, 500):
        shapes = rng.normal(size=(count, 9))
        low, high = np.split(world.boxes_of(bvh(shapes)).T, 2, axis=1)
        corners = shapes.reshape(count, 3, 3)
        inside = (low <= corners.min(axis=1)[:, None]) & (corners.max(axis=1)[:, None] <= high)
        assert low.shape == (16, 3)
        assert inside.all(axis=2).any(axis=1).all()


def test_a_struct_is_pickled_and_keeps_its_arrays():
    tree = bvh(quad(1.0))
    obstacles = world.Obstacles(tree=tree, boxes=world.boxes_of(tree), origin_m=np.array([1.0, 2, 3]), ground_m=-1.5)
    copy = pickle.loads(pickle.dumps(obstacles))
    assert obstacles.tree is tree
    assert copy.tree.shapes.tolist() == tree.shapes.tolist()
    assert copy.boxes.tolist() == obstacles.boxes.tolist()
    assert copy.origin_m.tolist() == [1, 2, 3]
    assert copy.ground_m == -1.5


def test_a_world_by_hand():
    """A wall at x = 10 and one that starts at x = 5 and drives away at 2 m/s, above the ground at z = -1."""
    away = world.path_of_velocity((2.0, 0.0, 0.0))
    spin = world.path_of_arc(0.0, np.pi, 0.0)
    places = np.array([[5.0, 0, 0], [0, 0, 20]])
    whole = world.World(
        -1.0, bvh(quad(10.0)), [bvh(quad(0.0)), bvh(quad(3.0))], places, np.array([2.0, 0]), [away, spin]
    )
    assert len(whole) == 6
    assert len(whole.fixed) == 2
    seconds = [0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 1.0]
    way = [[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]]
    origins = [[0.0, 0.1, 0.2]] * 5 + [[0.0, 0.1, 20.2]] * 2
    found = cast(whole, origins, way, seconds)
    np.testing.assert_allclose(found.range_m, [5, 7, 10, np.inf, 1.2, 3, 3])
    assert found.slot[[3, 4]].tolist() == [NOTHING, GROUND]
    np.testing.assert_allclose(
        abs(found.normal[[0, 1, 2, 4, 5, 6]]), [[1, 0, 0]] * 3 + [[0, 0, 1]] + [[1, 0, 0]] * 2, atol=1e-12
    )
    np.testing.assert_allclose(found.cosine, 1)
    objects, triangles = whole.resolve(found.slot)
    assert objects[[3, 4]].tolist() == [-1, 0]
    assert triangles[[3, 4]].tolist() == [-1, -1]
    assert set(triangles.tolist()) <= {-1, 0, 1}
    limited = cast(whole, origins, way, seconds, 4.0)
    assert np.array_equal(limited.range_m, np.where(found.range_m < 4, found.range_m, np.inf))
    for slot in (-3, 6):
        with pytest.raises(ValueError, match="slot: not of this world"):
            whole.resolve(np.array([slot], np.int32))
    other = whole.along(np.array([1.0, 0]), [world.path_of_velocity((-1.0, 0.0, 0.0)), spin])
    np.testing.assert_allclose(cast(other, origins, way, seconds).range_m, [5, 4, 2, np.inf, 1.2, 3, 3])
    assert np.array_equal(cast(whole, origins, way, seconds).range_m, found.range_m)
    for speeds_m_s, paths, message in (
        (np.ones(1), [away, spin], "speeds_m_s: one for each moving object"),
        (np.ones(2), [away], "paths: one for each moving object"),
    ):
        with pytest.raises(ValueError, match=message):
            whole.along(speeds_m_s, paths)


def test_motions_by_hand():
    R, t = world.path_of_arc(np.pi, np.pi / 2, 0.0).at(np.array([0.0, 1.0]))
    np.testing.assert_allclose(t, [[0, 0, 0], [2, 2, 0]], atol=1e-12)
    np.testing.assert_allclose(R[1], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    turn = np.array([[0, 0, np.pi / 2], [0, 0, 0]])
    path = world.path_of_poses(
        np.array([1.0, 3.0]), np.array([[0.0, 0, 0], [4, 0, 0]]), np.stack([np.eye(3), R[1]]), turn
    )
    R, t = path.at(np.array([2.0, 4.0, np.nan]))
    np.testing.assert_allclose(t[:2], [[2, 0, 0], [6, 0, 0]])
    np.testing.assert_allclose(R[0, 0, :2], [np.sqrt(0.5), -np.sqrt(0.5)])
    assert world.path_of_velocity((1.0, 2.0, 3.0)).at(np.empty(0))[0].shape == (0, 3, 3)


def test_a_box_is_entered_and_left():
    corners = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array(
        [face[k : k + 3 : 1] if k == 0 else [face[0], face[2], face[3]] for face in faces for k in (0, 1)]
    )
    points = np.array([[0.5, 0.3, 0.4], [1.5, 0.3, 0.4], [-0.5, 0.3, 0.4], [np.nan, 0.5, 0.5], [0.5, 0.5, np.nan]])
    odd = np.zeros(5, np.bool_)
    world.toggle_points(corners, triangles, points, odd)
    assert odd[:3].tolist() == [True, False, False]
    x = np.array([-1.0, 0.5, 2])
    lines = np.tile([0, 1, 0, 1], (12, 1))
    toggled = np.zeros((1, 1, 4), np.bool_)
    world.toggle_lines(corners, triangles, lines, x, np.array([0.3]), np.array([0.4]), toggled)
    assert np.logical_xor.accumulate(toggled[0, 0])[:3].tolist() == [False, True, False]
    with pytest.raises(ValueError, match="triangles: of vertices only"):
        world.toggle_points(corners, triangles + 1, points, odd)
    with pytest.raises(ValueError, match="lines: indices of z"):
        world.toggle_lines(
            corners, triangles, lines + np.array([0, 0, 0, 1]), x, np.array([0.3]), np.array([0.4]), toggled
        )
    with pytest.raises(ValueError, match="odd: of another size"):
        world.toggle_lines(corners, triangles, lines, x[:2], np.array([0.3]), np.array([0.4]), toggled)


def frozen(values):
    """Read-only."""
    values.flags.writeable = False
    return values


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"origins": np.zeros((3, 4), np.float32)}, "origins: float32"),
        ({"origins": np.zeros((4, 3)).T}, "origins: float64"),
        ({"origins": np.zeros((2, 4))}, r"origins: .* allowed: .*shape=\(3, \*\)"),
        ({"directions": np.zeros((3, 5))}, "directions: one for each origin"),
        ({"seconds": np.zeros(3)}, "seconds: one for each ray"),
        ({"range_m": frozen(np.zeros(4))}, "range_m: float64"),
        ({"slot": np.zeros(5, np.int32)}, "slot: one for each ray"),
        ({"slot": np.zeros(4, np.int64)}, "slot: int64"),
        ({"normal": np.zeros((3, 3))}, "normal: one for each ray, or none"),
        ({"normal": np.zeros((4, 2))}, r"normal: .* allowed: .*shape=\(\*, 3\)"),
        ({"cosine": np.zeros(1)}, "cosine: one for each ray, or none"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    whole = world.World(0.0, bvh(quad(1.0)), [], np.empty((0, 3)), np.empty(0), [])
    rows = {"origins": np.zeros((3, 4)), "directions": np.ones((3, 4)), "seconds": np.zeros(4)}
    columns = world.Found(np.zeros(4), np.zeros(4, np.int32), np.empty((0, 3)), np.empty(0))
    whole.cast(**rows, limit_m=1.0, found=columns)
    rows |= {key: value for key, value in change.items() if key in rows}
    changed = fields_of(columns) | {key: value for key, value in change.items() if key not in rows}
    with pytest.raises((TypeError, ValueError), match=message):
        whole.cast(**rows, limit_m=1.0, found=world.Found(**changed))


def test_parts_that_do_not_fit_are_refused():
    shapes = np.zeros((2, 9))
    kind = np.zeros(2, np.uint8)
    number = np.zeros(2, np.int32)
    for change, message in (
        ({"shapes": np.zeros((2, 8))}, r"shapes: .* allowed: .*shape=\(\*, 9\)"),
        ({"kind": kind[:1]}, "kind: one for each shape"),
        ({"kind": kind + np.uint8(9)}, "kind: unknown"),
        ({"number": number[:1]}, "number: one for each shape"),
        ({"object": number.astype(np.int64)}, "object: int64"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            world.Bvh(**({"shapes": shapes, "kind": kind, "number": number, "object": number} | change))
    tree = bvh(shapes)
    path = world.path_of_velocity((0.0, 0.0, 0.0))
    for change, message in (
        ({"fixed": path}, "fixed: of type"),
        ({"places_m": np.zeros((2, 3))}, "places_m: one for each of moving"),
        ({"speeds_m_s": np.zeros(0)}, "speeds_m_s: one for each of moving"),
        ({"paths": []}, "paths: one for each of moving"),
        ({"moving": [path]}, r"moving\[0\]: of type"),
    ):
        parts = {
            "fixed": tree,
            "moving": [tree],
            "places_m": np.zeros((1, 3)),
            "speeds_m_s": np.zeros(1),
            "paths": [path],
        }
        with pytest.raises((TypeError, ValueError), match=message):
            world.World(**({"ground_m": 0.0} | parts | change))
    with pytest.raises(ValueError, match="times_s: ascending"):
        world.path_of_poses(np.array([1.0, np.nan]), np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="times_s: two or more"):
        world.path_of_poses(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="read-only"):
        tree.number[0] = 1


def test_a_pickle_is_the_same_hierarchy():
    rng = np.random.default_rng(4)
    tree, (origins, way) = bvh(soup(rng, 500)), rays(rng, 500)
    again = pickle.loads(pickle.dumps(tree))
    assert np.array_equal(again.number, tree.number)
    for one, other in zip(first(again, origins, way), first(tree, origins, way), strict=True):
        assert np.array_equal(one, other)
    assert len(pickle.loads(pickle.dumps(bvh([])))) == 0


def restored(*columns):
    tree = world.Bvh.__new__(world.Bvh)
    tree.__setstate__(columns)
    return tree


TREE = bvh(soup(np.random.default_rng(6), 40))
STATE = TREE.__getstate__()  # nodes, leaves, kinds, numbers, objects


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 2**20), st.integers(0, 255)), max_size=4))
def test_a_pickle_that_was_changed_is_refused_or_harmless(changes):
    columns = [bytearray(column) for column in STATE]
    for column, place, value in changes:
        columns[column][place % len(columns[column])] = value
    try:
        tree = restored(*map(bytes, columns))
    except ValueError:
        return
    first(tree, *rays(np.random.default_rng(7), 100))


def test_pickles_of_no_hierarchy_are_refused():
    nodes, *others = STATE
    children = np.frombuffer(nodes, np.int32).reshape(-1, 56)[:, 48:]  # after two sides of eight boxes
    inner = np.argwhere(children > 0)
    assert len(inner) > 1

    def leading(*pairs):
        """The nodes, some of whose children are others."""
        changed = np.frombuffer(nodes, np.int32).reshape(-1, 56).copy()
        for (node, child), code in pairs:
            changed[node, 48 + child] = code
        return changed.tobytes()

    chain = np.tile(np.frombuffer(nodes, np.int32)[:56], (80, 1))
    chain[:, 48:] = -1
    chain[:-1, 48] = np.arange(1, 80)
    one, other = inner[:2]
    for message, state in {
        "five columns": STATE[:4],
        "not bytes": (nodes, None, *others[1:]),
        "bytes of no column": (nodes[:-1], *others),
        "kind: one for each": (nodes, others[0], others[1][:-1], *others[2:]),
        "kind: unknown": (nodes, others[0], others[1][:-1] + b"\4", *others[2:]),
        "number: one for each": (nodes, *others[:2], others[2][:-4], others[3]),
        "object: one for each": (nodes, *others[:3], others[3][:-4]),
        "nodes: none": (b"", *others),
        "nodes: beyond the leaves": (leading((one, -9 * 2**16)), *others),
        "nodes: not a tree": (leading((one, 2**30)), *others),
        "nodes: not after": (leading((one, -1)), *others),
        "nodes: too many levels": (chain.tobytes(), *others),
    }.items():
        with pytest.raises(ValueError, match=message):
            restored(*state)
    for codes in (((one, 0),), ((one, children[tuple(other)]),)):
        with pytest.raises(ValueError, match="nodes: not a tree"):
            restored(leading(*codes), *others)


def test_rays_that_are_not_near_each_other_are_traced_in_pieces():
    """Each hits what it hits alone, also where all rays of a packet face the same way."""
    rng = np.random.default_rng(5)
    tree, (origins, way) = bvh(soup(rng, 3000, 0.1)), rays(rng, 200)
    way = abs(way) * [0.1, 0.2, 1.0]
    way /= np.linalg.norm(way, axis=1)[:, None]
    range_m, slot = first(tree, origins, way)
    alone = [first(tree, origins[n : n + 1], way[n : n + 1]) for n in range(200)]
    assert np.array_equal(range_m, [one[0][0] for one in alone])
    assert np.array_equal(slot, [one[1][0] for one in alone])
    assert np.array_equal(blocked(tree, origins, way * 3), range_m < 3 * (1 - 1e-9))
