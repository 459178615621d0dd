"""The core's lines through subspaces, spheres in them, and boxes that touch them."""

from types import SimpleNamespace

import numpy as np
import pytest

from lidarcfg.core import analytic as core

ONE = (1.0, 1.0, 1.0)


def lattice_of(shape=(4, 2, 3), axis=0, low=(0.0, 0.0, 0.0), edge=ONE):
    return SimpleNamespace(axis=axis, low=low, edge=edge, shape=shape)


def crossings(*lines):
    """Of lines, given the places on each; the weights count up."""
    at = np.array([place for line in lines for place in line], float)
    first = np.cumsum([0, *map(len, lines)])
    return SimpleNamespace(first=first, at=at, weight=np.arange(len(at)) + 0.5)


def test_cones_are_crossed_where_they_are():
    upright = np.array([0.0, 0, 0, 0, 0, 1, 0.5, 1.0, np.nan])  # 30°, one closed to the axis, and none
    at, weight = core.cross_cones((0.0, 1.0), upright, -9.0, 9.0)
    np.testing.assert_allclose(at, [-(3**0.5), 3**0.5])
    np.testing.assert_allclose(weight, [0.5, 0.5])
    assert len(core.cross_cones((0.0, -1.0), upright, -9.0, 9.0)[0]) == 0  # of the mirrored cone
    level = np.array([0.25, 0, 0, 1, 0, 0, 0.0])
    assert [list(found) for found in core.cross_cones((2.0, 1.0), level, -1.0, 1.0)] == [[0.25], [1.0]]


def swept(label, within=None, lidars=0):
    """What lines along z see of labels, without cones."""
    label = np.asarray(label, np.int32)
    n = label.max(initial=-1) + 1
    lines = 4 * label.shape[1] * label.shape[2]
    sheaf = SimpleNamespace(axis=2, label=label, within=np.ones(label.shape, bool) if within is None else within)
    sheaf.low = (0.0, 0.0, 0.0)
    sheaf.edge = (0.5, 1.0, 2.0)
    sheaf.cones = np.zeros((lidars, 6))
    flips = SimpleNamespace(start=np.ones((lidars + 1, lines), bool), first=np.zeros(lines * (lidars + 1) + 1, int))
    flips.at = np.empty(0)
    flips.weight = np.empty(0)
    sums = SimpleNamespace(volume=np.zeros(n), shadow=np.zeros(n), surface=np.zeros(n), parent=np.arange(n))
    return sheaf, np.zeros((n, lidars), int), np.zeros((lidars, 6)), flips, sums


def test_lines_add_up_to_a_box():
    label = np.zeros((4, 2, 3), int)
    *arguments, sums = swept(label)
    core.sweep_lines(*arguments, sums)
    assert (sums.volume[0], sums.shadow[0], sums.surface[0]) == (24.0, 12.0, 24.0)
    within = np.ones(label.shape, bool)
    within[1] = False
    label[1:] = 1
    *arguments, sums = swept(label, within)
    core.sweep_lines(*arguments, sums)
    assert sums.volume.tolist() == [6.0, 12.0]
    assert sums.surface.tolist() == [24.0, 24.0]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda a: setattr(a[0], "axis", 3), "sheaf.axis"),
        (lambda a: setattr(a[0], "edge", (1.0, 0.0, 1.0)), "sheaf.edge"),
        (lambda a: setattr(a[0], "low", (1.0, np.nan, 1.0)), "sheaf.low"),
        (lambda a: setattr(a[0], "label", a[0].label + 1), "sheaf.label"),
        (lambda a: setattr(a[0], "label", a[0].label.astype(np.int64)), "sheaf.label"),
        (lambda a: setattr(a[0], "within", a[0].within[1:]), "sheaf.within"),
        (lambda a: setattr(a[0], "cones", np.zeros((2, 6))), "sheaf.cones"),
        (lambda a: a.__setitem__(1, np.zeros((1, 2), int)), "gap"),
        (lambda a: a.__setitem__(2, np.zeros((1, 5))), "rows"),
        (lambda a: setattr(a[3], "start", a[3].start[1:]), "flips.start"),
        (lambda a: a[3].first.__setitem__(1, 1), "flips.first"),
        (lambda a: a[3].first.__setitem__(-1, 1), "flips.first"),
        (lambda a: setattr(a[3], "weight", np.empty(1)), "flips.first"),
        (lambda a: setattr(a[4], "volume", np.empty(2)), "sums"),
        (lambda a: a[4].parent.__setitem__(0, 1), "sums.parent"),
    ],
)
def test_a_sweep_refuses_what_does_not_fit(change, named):
    arguments = list(swept(np.zeros((2, 2, 2), int), lidars=1))
    change(arguments)
    with pytest.raises(ValueError, match=rf"^{named}\b"):
        core.sweep_lines(*arguments)


def test_shapes_are_crossed():
    """A tetrahedron and a sphere, an even number of times by each line, as often as their areas have it."""
    lattice = lattice_of((10, 40, 40), edge=(0.1, 0.1, 0.1))
    corners = np.array([[0.2, 0.5, 0.5], [0.8, 3.5, 0.6], [0.3, 1.0, 3.6], [0.9, 2.0, 2.0]])
    faces = np.array([corners[[b for b in range(4) if b != a]] for a in range(4)])
    found = core.cross_triangles(lattice, faces)
    assert found.shape[1] == 4
    lines, counts = np.unique(found[:, 0], return_counts=True)
    assert set(counts) == {2}
    outline = corners[:3, 1:] - corners[2, 1:]
    assert len(lines) / 400 == pytest.approx(abs(np.linalg.det(outline[:2])) / 2, rel=0.02)
    rounds = np.array([(0.5, 2.0, 2.0, 0.4, np.nan)])
    sphere = core.cross_rounds(lattice, rounds)
    np.testing.assert_allclose(sphere[::2, 1] + sphere[1::2, 1], 1.0)
    assert len(sphere) / 800 == pytest.approx(np.pi * 0.16, rel=0.02)
    assert len(core.cross_triangles(lattice, np.empty((0, 3, 3)))) == 0
    assert len(core.cross_triangles(lattice, np.full((1, 3, 3), np.nan))) == 0
    assert len(core.cross_rounds(lattice, np.full((1, 5), np.nan))) == 0


def test_states_change_between_crossings():
    lattice = lattice_of((4, 1, 1))
    lines = (1, 3)
    crossed = crossings([1.0, 3.0], [])
    middles = core.find_middles(lattice, lines, crossed)
    assert middles[:, 0].tolist() == [0.5, 2.0, 3.5, 2.0]
    start = np.empty(2, bool)
    first, at, weight = core.find_flips(crossed, np.array([True, True, False, False]), start)
    assert (first.tolist(), at.tolist(), weight.tolist(), start.tolist()) == ([0, 1, 1], [3.0], [1.5], [True, False])
    solid = crossings([-1.0, 1.0, 2.0, 3.0], [])
    first, at, _ = core.find_solid_flips(lattice, solid, np.array([0, 1, 1, 0]), 2, start)
    assert (first.tolist(), at.tolist(), start.tolist()) == ([0, 1, 1], [3.0], [False, True])
    with pytest.raises(ValueError, match="part: not below parts"):
        core.find_solid_flips(lattice, solid, np.array([0, 1, 2, 0]), 2, start)
    for parts in (-1, 2**31):
        with pytest.raises(ValueError, match="parts"):
            core.find_solid_flips(lattice, solid, np.array([0, 1, 1, 0]), parts, start)
    with pytest.raises(ValueError, match="part: one"):
        core.find_solid_flips(lattice, solid, np.zeros(3, int), 2, start)
    with pytest.raises(ValueError, match="states"):
        core.find_flips(crossed, np.ones(3, bool), start)
    for wrong in ((-1, 1), (2, 1), (0, 5)):
        with pytest.raises(ValueError, match="lines"):
            core.find_middles(lattice, wrong, crossed)
    with pytest.raises(ValueError, match="crossed"):
        core.find_middles(lattice, (0, 1), crossed)
    with pytest.raises(ValueError, match=r"lattice\.shape"):
        core.find_middles(lattice_of((1, 0, 1)), lines, crossed)


def bounds_of(edges, quadrics=()):
    """Bounds that every line may meet."""
    bins = core.DIRECTION_BINS
    count = len(edges) + len(quadrics)
    bounds = SimpleNamespace(foot=(0.0, 0.0, 0.0), edges=np.reshape(edges, (-1, 7)).astype(float))
    bounds.quadrics = np.reshape(quadrics, (-1, 10)).astype(float)
    bounds.first = np.arange(bins + 1) * count
    bounds.item = np.tile(np.arange(count), bins)
    return bounds


def test_sight_may_end_at_bounds():
    lattice = lattice_of((5, 1, 1))
    none = crossings(*[[]] * 4)
    plane = (0.5, 0.1, -9, 0.5, 0.1, 9, 0.25)  # an edge beyond which u grows five times
    ball = (1, 0, 0, 1, 0, 1, -2, 0, 0, 4 - 1.5**2)  # 1.5 m around x = 2
    first, at, weight = core.find_candidates(lattice, (0, 4), bounds_of([plane], [ball]), none)
    assert len(first) == 5
    u = (0.5 + np.arange(4)) / 4
    for line in range(4):
        assert 5 * u[line] in np.round(at[first[line] : first[line + 1]], 9)
    assert (weight > 0).all()
    for name, value in (("foot", (np.nan, 0, 0)), ("first", np.zeros(9, int)), ("item", np.full(1024, 5))):
        wrong = bounds_of([plane])
        setattr(wrong, name, value)
        with pytest.raises(ValueError, match=rf"bounds\.{name}"):
            core.find_candidates(lattice, (0, 4), wrong, none)
    with pytest.raises(ValueError, match="surfaces"):
        core.find_candidates(lattice, (0, 4), bounds_of([plane]), crossings([]))


def test_the_largest_sphere_is_found():
    label = np.zeros((5, 6, 70), np.int32)
    label[:, :, 66:] = -1
    label[2, 3, 3] = 1
    ends = core.find_ends(label)
    assert ends.shape == (5, 6, 2)
    assert (int(ends[0, 0, 0]), int(ends[0, 0, 1])) == (0, 1 << 1 | 1 << 5)
    square, node = core.largest_sphere(label, ends, (0.5, 0.5, 0.5), -1, (0, 0, 0), label.shape)
    assert (square, node) == (6.25, (5, 5, 13))
    assert core.clearance(label, (0.5, 0.5, 0.5), node) == square
    assert core.largest_sphere(label, ends, (0.5, 0.5, 0.5), 1, (2, 3, 3), (3, 4, 4))[0] == 0.25
    assert core.clearance(label, (0.5, 0.5, 0.5), (10, 0, 0)) == 0.0
    for changed, named in (
        ({"half": (0.5, 0.0, 0.5)}, "half"),
        ({"ends": ends[:, :, :1].copy()}, "ends"),
        ({"ends": np.zeros_like(ends)}, "ends"),
        ({"low": (-1, 0, 0)}, "low"),
        ({"low": (3, 0, 0), "high": (2, 1, 1)}, "low"),
        ({"high": (6, 6, 70)}, "high"),
        ({"label": label[1:]}, "ends"),
    ):
        arguments = {"label": label, "ends": ends, "half": (0.5, 0.5, 0.5), "number": -1, "low": (0, 0, 0)}
        with pytest.raises(ValueError, match=named):
            core.largest_sphere(**arguments | {"high": label.shape} | changed)
    with pytest.raises(ValueError, match="node"):
        core.clearance(label, (0.5, 0.5, 0.5), (0, -1, 0))


@pytest.mark.parametrize("high", [3, 64, 70, 130])
def test_boxes_are_counted_at_every_place(high):
    rng = np.random.default_rng(high)
    label = np.repeat(rng.integers(-1, 9, (4, 3, -(-high // 5))), 5, axis=2)[:, :, :high].astype(np.int32)
    for size in ((1, 1, 1), (2, 2, 3), (4, 3, high)):
        boxes = np.lib.stride_tricks.sliding_window_view(label, size).reshape(-1, np.prod(size))
        free = boxes[(boxes >= 0).all(axis=1)]
        for threshold in range(4):
            held = np.zeros(9, bool)
            detected, places = core.detected_positions(label, size, threshold, high, 2**62, held)
            assert places.shape == tuple(np.subtract(label.shape, size)[:2] + 1)
            assert places.sum() == len(free)
            assert detected.sum() == sum(len(set(box)) > threshold for box in free)
            assert set(np.flatnonzero(held)) == {box[0] for box in free if len(set(box)) == 1}
    one = (1, 1, 1)
    assert core.detected_positions(label, one, 2**31, high, 2**62, held)[0].sum() == 0  # more than there can be
    rows = core.detected_positions(label, one, 2**31, high, -(2**63), held)[1]
    assert np.count_nonzero(rows.ravel()[1:]) == 0  # so many were missed before the first row
    for changed in ((0, 1, 1), (5, 1, 1), (1, 1, high + 1)):
        with pytest.raises(ValueError, match="size"):
            core.detected_positions(label, changed, 1, 1, 1, held)
    for arguments, named in (
        ((-1, 1, 1, held), "threshold"),
        ((1, 0, 1, held), "layers"),
        ((1, 1, 1, held[:1]), "held"),
    ):
        with pytest.raises(ValueError, match=named):
            core.detected_positions(label, (1, 1, 1), *arguments)


def test_boxes_anywhere():
    label = np.arange(27, dtype=np.int32).reshape(3, 3, 3)
    label[2, 2] = -1
    boxes = np.array([(1, 1, 0, 0), (1.5, 1.5, 1, np.pi / 4), (2.5, 2.5, 0, 0), (9, 9, 9, 0), (np.nan, 1, 1, 0)])
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[:1], (1, 1, 1), 3) == (1, 1)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[1:2], (0.5, 0.5, 0.5), 0) == (1, 1)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[2:3], (0.5, 0.5, 0.5), 0) == (0, 0)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[3:], (0.5, 0.5, 0.5), 0)[0] == 0
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[:0], ONE, 0) == (0, 0)
    assert core.detected_boxes(label, (0, 0, 0), ONE, boxes[:1], (1, 1, 1), 2**31) == (0, 1)
    with pytest.raises(ValueError, match="edge"):
        core.detected_boxes(label, (0, 0, 0), (1, 1, np.nan), boxes, ONE, 0)
    with pytest.raises(ValueError, match="threshold"):
        core.detected_boxes(label, (0, 0, 0), ONE, boxes, ONE, -1)
    with pytest.raises(ValueError, match="boxes"):
        core.detected_boxes(label, (0, 0, 0), ONE, boxes[:, :3].copy(), ONE, 0)
