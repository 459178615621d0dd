"""Grids, links, subspaces and trials of the core, on small cases worked out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.core import vsr, world
from tests.core.records import replaced

NO_INDEX = np.empty(0, np.int32)
NO_TREE = world.Bvh(np.empty((0, 9)), np.empty(0, np.uint8), NO_INDEX, NO_INDEX)
FREE = world.Obstacles(tree=NO_TREE, boxes=world.boxes_of(NO_TREE), origin_m=np.zeros(3), ground_m=np.inf)
NONE = np.zeros((0, 9))


def pack(flags):
    """The words of flags (nx, ny, nz), with the margin."""
    nx, ny, nz = flags.shape
    padded = np.zeros((nz + 2, ny + 2, -(-nx // 64) * 64), bool)
    padded[1:-1, 1:-1, :nx] = flags.transpose(2, 1, 0)
    return np.packbits(padded, axis=-1, bitorder="little").view(np.uint64).ravel()


def grid_of(flags, weight=(), weighted=None):
    centres = [np.arange(n) + 0.5 for n in flags.shape]
    words = np.zeros((0, len(pack(flags))), np.uint64) if weighted is None else weighted
    return vsr.Grid(*centres, pack(flags), (1.0, 1.0, 1.0), np.array(weight, float), words)


def cones(*lidars):
    """Rows of upright LiDARs: a position and the beams' u."""
    return np.array([[*position, 0.0, 0.0, 1.0, *beams] for position, *beams in lidars], float).reshape(len(lidars), -1)


def links_of(grid, rows, seen=None):
    out = np.empty((grid.rows, 3), np.uint64)
    vsr.links(grid, rows, np.empty((0, grid.rows), np.uint64) if seen is None else seen, out)
    return out


def sight(limits=NONE, **obstacles):
    return vsr.Sight(limits=limits, obstacles=replaced(FREE, **obstacles))


LEVEL = cones(((1.5, 1.5, 1.0), 0.0))  # one beam along the ground between the two layers


def batch_of(grid, trials, **changes):
    """Trials (n, lidars, columns) of LiDARs that all moved, and room for what becomes of them."""
    n, lidars, _ = trials.shape
    given = {
        "placed": vsr.Placed(cones=trials, limits=np.zeros((n, 0, 9)), obstacles=FREE),
        "upper_bound": np.full(n, np.inf),
        "moved": np.ones((n, lidars), bool),
        "source": np.zeros(n, np.int64),
        "certificates": np.full((n, 4), -1),
        "links": np.empty((0, lidars, grid.rows, 3), np.uint64),
        "same_position": np.zeros((n, lidars), bool),
        "clear": np.empty((0, lidars, grid.rows), np.uint64),
        "smoothing": 0.0,
    }
    result = vsr.BatchResult(
        cost=np.zeros(n),
        refuted_by=np.zeros(n, np.int64),
        certificates=np.full((n, 4), -1),
        links=np.empty((0, grid.rows, 3), np.uint64),
        clear=np.empty((0, grid.rows), np.uint64),
    )
    return vsr.Batch(**given | changes), result


def evaluator_of(grid, cases=((True,),)):
    return vsr.TrialEvaluator(grid, np.array(cases), 4)


def cost_of(grid, rows):
    """Max VSR of LiDARs that see everything, as a trial that is evaluated in full."""
    batch, result = batch_of(grid, rows[None])
    evaluator_of(grid, np.ones((1, len(rows)), bool)).evaluate_batch(np.zeros(1, np.int64), 1, batch, True, result)
    return result.cost[0]


def test_a_level_beam_cuts_a_block_in_two():
    grid = grid_of(np.ones((3, 3, 2), bool))
    label = np.empty((3, 3, 2), np.int32)
    cuboids, internal, first = vsr.label_components(grid, links_of(grid, LEVEL), label)
    assert label.tolist() == [[[0, 1]] * 3] * 3
    assert cuboids.tolist() == [9, 9]
    assert internal.tolist() == [[6, 6, 0]] * 2
    assert first.tolist() == [0, 1]
    assert cost_of(grid, LEVEL) == 9 / 30
    assert vsr.beam_gaps(np.array([[0, 0, 0.5], [0, 0, 1.0], [1.5, 1.5, 1.0]]), LEVEL).tolist() == [[0], [1], [1]]


def test_nothing_is_cut_without_lidars_and_nothing_counts_where_all_is_excluded():
    whole = grid_of(np.ones((3, 2, 1), bool))
    none = np.empty((0, 6))
    assert cost_of(whole, none) == 6 / 22
    nothing = grid_of(np.zeros((3, 2, 1), bool))
    assert cost_of(nothing, LEVEL) == -1.0
    label = np.empty((3, 2, 1), np.int32)
    assert [len(one) for one in vsr.label_components(nothing, links_of(nothing, LEVEL), label)] == [0, 0, 0]
    assert (label == -1).all()


def test_weights_count_by_the_heaviest_cuboid():
    flags = np.ones((3, 3, 2), bool)
    top = np.zeros_like(flags)
    top[0, 0, 1] = True
    grid = grid_of(flags, (4.0, 1.0), np.stack([pack(top), pack(~top)]))
    assert cost_of(grid, LEVEL) == 4 * 9 / 30


def test_a_range_is_a_border():
    """A LiDAR that sees two metres from its corner: what it is blind to is one subspace, whatever the beam."""
    grid = grid_of(np.ones((4, 1, 2), bool))
    rows = cones(((0.0, 0.5, 1.0), 0.0))
    limits = np.zeros((1, 9))
    limits[0, 1] = 4.0
    seen = vsr.seen(grid, rows, sight(limits))
    assert seen[0][seen[0] > 0].tolist() == [0b11, 0b11]
    label = np.empty((4, 1, 2), np.int32)
    vsr.label_components(grid, links_of(grid, rows, seen), label)
    assert label[:, 0].tolist() == [[0, 1], [0, 1], [2, 2], [2, 2]]


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([1, 5, 63, 64, 65, 130]), st.integers(1, 3), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_links_are_equal_gaps_of_neighbours(nx, ny, nz, seed):
    rng = np.random.default_rng(seed)
    flags = rng.random((nx, ny, nz)) < 0.9
    grid = grid_of(flags)
    u = np.sort(rng.uniform(-0.3, 0.3, rng.integers(1, 6)))
    rows = cones((rng.uniform(0, 3, 3), *u), (rng.uniform(0, 3, 3), *u))
    points = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in flags.shape), indexing="ij"), -1).reshape(-1, 3)
    gaps = vsr.beam_gaps(points, rows).reshape(*flags.shape, 2)
    expected = []
    for axis in range(3):
        alike = flags.copy()
        before = [slice(None)] * 3
        after = [slice(None)] * 3
        before[axis] = slice(None, -1)
        after[axis] = slice(1, None)
        same = (gaps[tuple(before)] == gaps[tuple(after)]).all(-1)
        alike[tuple(after)] = flags[tuple(after)] & flags[tuple(before)] & same
        alike[tuple(slice(0, 1) if n == axis else slice(None) for n in range(3))] = False
        expected.append(pack(alike))
    assert np.array_equal(links_of(grid, rows), np.stack(expected, 1))


def test_trials_are_evaluated_and_refuted_by_the_subspaces_of_certificates():
    grid = grid_of(np.ones((3, 3, 2), bool))
    evaluator = evaluator_of(grid)
    batch, result = batch_of(grid, np.stack([LEVEL, LEVEL]), upper_bound=np.array([np.inf, 0.5]))
    assert evaluator.evaluate_batch(np.zeros(1, np.int64), 9, batch, True, result) == (2, 0, 0)
    assert result.cost.tolist() == [9 / 30, 9 / 30]
    found = np.repeat(result.certificates[:1], 2, axis=0)
    assert (found[0] >= 0).sum() == 2
    batch, result = batch_of(grid, np.stack([LEVEL, LEVEL]), upper_bound=np.array([9 / 30, 0.5]), certificates=found)
    full, compared, _ = evaluator.evaluate_batch(np.zeros(1, np.int64), 9, batch, False, result)
    assert full == 0
    assert compared > 0
    assert result.refuted_by.tolist() == [found[0, 0], -1]
    assert result.cost[0] == np.inf
    assert np.isnan(result.cost[1])


def test_links_of_sources_are_computed_where_they_changed():
    grid = grid_of(np.ones((3, 3, 2), bool))
    links = np.zeros((2, 1, grid.rows, 3), np.uint64)
    placed = vsr.Placed(cones=LEVEL[None], limits=np.zeros((1, 0, 9)), obstacles=FREE)
    flag = np.ones((1, 1), bool)
    clear = np.empty((0, 1, grid.rows), np.uint64)
    sources = vsr.Sources(row=np.array([1]), placed=placed, changed=flag, same_position=~flag, links=links, clear=clear)
    counter = np.zeros(1, np.int64)
    evaluator_of(grid).recompute_links(counter, 5, sources)
    assert counter[0] == 2  # the first number that is none
    assert not links[0].any()
    assert np.array_equal(links[1, 0], links_of(grid, LEVEL))


def test_counters_of_what_is_no_trial():
    """Nothing is taken by a number below 0 or beyond the last one."""
    grid = grid_of(np.ones((3, 3, 2), bool))
    evaluator = evaluator_of(grid)
    batch, result = batch_of(grid, LEVEL[None])
    links = np.zeros((1, 1, grid.rows, 3), np.uint64)
    flag = np.ones((1, 1), bool)
    clear = np.empty((0, 1, grid.rows), np.uint64)
    sources = vsr.Sources(np.zeros(1, int), batch.placed, flag, ~flag, links, clear)
    for number in (-(2**63), -1, 1, 2**63 - 1):
        counter = np.array([number])
        assert evaluator.evaluate_batch(counter, 5, batch, True, result) == (0, 0, 0)
        assert counter[0] != number
        evaluator.recompute_links(np.array([number]), 5, sources)
    assert result.cost.tolist() == [0.0]
    assert not links.any()


def test_what_refuted_comes_first():
    certificates = np.array([[5, 6, 7], [1, 2, 3]])
    vsr.promote_certificates(certificates, np.array([0, 1, 9]), np.array([7, 4, -1]))
    assert certificates.tolist() == [[7, 5, 6], [4, 1, 2]]


def test_what_does_not_fit_is_refused():
    flags = np.ones((3, 3, 2), bool)
    grid = grid_of(flags)
    one = np.zeros(1)
    words = pack(flags)
    none = np.empty((0, len(words)), np.uint64)
    for what, make in {
        "x: empty": lambda: vsr.Grid(np.empty(0), one, one, words, (1, 1, 1), np.empty(0), none),
        "included: one word": lambda: vsr.Grid(one, one, one, words, (1, 1, 1), np.empty(0), none),
        "margin": lambda: vsr.Grid(one, one, one, np.full(9, 1, np.uint64), (1, 1, 1), np.empty(0), none[:, :9]),
        "weighted: one row": lambda: grid_of(flags, (1.0,)),
        "cones: at least six": lambda: links_of(grid, np.zeros((1, 5))),
        "seen: a word": lambda: links_of(grid, LEVEL, np.zeros((1, 3), np.uint64)),
        "out: float64 of shape": lambda: vsr.links(grid, LEVEL, none, np.zeros((grid.rows, 3))),
        "label: of the grid's": lambda: vsr.label_components(grid, links_of(grid, LEVEL), np.empty((1, 1, 1), np.int32)),
        "links: for each row": lambda: vsr.label_components(grid, links_of(grid, LEVEL)[1:], np.empty((3, 3, 2), np.int32)),
        "links: not of neighbours": lambda: vsr.label_components(grid, np.full((grid.rows, 3), 2**64 - 1, np.uint64), np.empty((3, 3, 2), np.int32)),
        "limits: float64 of shape": lambda: vsr.seen(grid, LEVEL, sight(np.zeros((1, 8)))),
        "a row for each LiDAR": lambda: vsr.seen(grid, np.repeat(LEVEL, 2, 0), sight(np.zeros((1, 9)))),
        "boxes": lambda: vsr.seen(grid, LEVEL, sight(np.zeros((1, 9)), boxes=np.zeros((6, 3)))),
        "tree": lambda: vsr.seen(grid, LEVEL, sight(np.zeros((1, 9)), tree=None)),
        "cases: none": lambda: vsr.TrialEvaluator(grid, np.empty((0, 1), bool), 4),
        "certificates: not from 1": lambda: vsr.TrialEvaluator(grid, np.ones((1, 1), bool), 2**31),
        "certificates: no columns": lambda: vsr.promote_certificates(np.empty((1, 0), np.int64), np.array([0]), np.array([0])),
        "source: not a row": lambda: vsr.promote_certificates(np.array([[1]]), np.array([1]), np.array([0])),
    }.items():  # fmt: skip
        with pytest.raises((TypeError, ValueError), match=what):
            make()


def placed_by(boxes):
    """LEVEL among obstacles that other boxes hold."""
    obstacles = replaced(FREE, boxes=boxes)
    return vsr.Placed(cones=LEVEL[None], limits=np.zeros((1, 0, 9)), obstacles=obstacles)


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("source: not a row of links", {"moved": np.zeros((1, 1), bool)}),
        ("source: not a row of clear", {"same_position": np.ones((1, 1), bool)}),
        ("certificates: not a cuboid", {"certificates": np.full((1, 4), 10**6)}),
        ("certificates: not a cuboid", {"certificates": np.full((1, 4), -2)}),
        ("upper_bound: one for each", {"upper_bound": np.zeros(2)}),
        ("moved: a flag", {"moved": np.ones((1, 2), bool)}),
        ("links: of each LiDAR", {"links": np.zeros((1, 1, 2, 3), np.uint64)}),
        ("obstacles.boxes: neither", {"placed": placed_by(np.zeros((6, 3)))}),
    ],
)
def test_batches_that_do_not_fit_are_refused(what, changes):
    grid = grid_of(np.ones((3, 3, 2), bool))
    batch, result = batch_of(grid, LEVEL[None], **changes)
    with pytest.raises(ValueError, match=what):
        evaluator_of(grid).evaluate_batch(np.zeros(1, np.int64), 1, batch, True, result)
