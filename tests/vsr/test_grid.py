"""Subspaces against a direct evaluation in NumPy with SciPy's labels, cuboid for cuboid, where rounding decides too."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.geometry import rotation
from lidarcfg.vsr.cones import Lidar, cone_rows, gaps_at
from lidarcfg.vsr.metric import vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import beam_gaps, check_grid, compare_labels, connect, grid_of, segment
from tests.core.test_vsr import cost_of
from tests.naive import vsr as naive

FAN = np.arange(-15.0, 16.0, 2.0)
UNIT = tuple(tuple(sign * row) for sign in (1.0, -1.0) for row in np.eye(3))


def cones(position, axis, elevation_deg):
    """A LiDAR whose beams at −90°, 0° and 90° have sines of exactly −1, 0 and 1."""
    return Lidar(np.array(position, float), np.array(axis, float), np.sin(np.radians(np.array(elevation_deg, float))))


def digits(centres, lidar):
    """How many beams k have q >= u_k d² at each centre, in the order of operations that is laid down."""
    dx, dy, dz = np.ix_(*(centre - t for centre, t in zip(centres, lidar.position_m, strict=True)))
    a = lidar.axis
    height = (dx * a[0] + dy * a[1]) + dz * a[2]
    distance2 = (dx * dx + dy * dy) + dz * dz
    q = height * np.abs(height)
    return sum((q >= s * abs(s) * distance2 for s in lidar.sin_elevation), np.zeros(q.shape, int))


def direct(centres, included, lidars):
    """Labels in raster order of first cuboids, cuboids, internal faces and first cuboids, without rows of bits."""
    gaps = np.stack([included, *(digits(centres, lidar) for lidar in lidars)], axis=-1)
    signature = np.unique(gaps.reshape(-1, gaps.shape[-1]), axis=0, return_inverse=True)[1].reshape(included.shape)
    label = np.full(included.shape, -1)
    count = 0
    for kind in np.unique(signature[included]):
        part, found = ndimage.label(signature == kind)
        label[part > 0] = part[part > 0] + count - 1
        count += found
    first = np.sort(np.unique(label.ravel()[included.ravel()], return_index=True)[1])
    first = np.flatnonzero(included.ravel())[first]
    number = np.full(count + 1, -1)
    number[label.ravel()[first]] = np.arange(count)
    label = number[label]  # the last entry is for −1
    internal = np.zeros((count, 3), int)
    for axis in range(3):
        a, b = (np.moveaxis(label, axis, 0)[part] for part in (slice(1, None), slice(None, -1)))
        internal[:, axis] = np.bincount(a[(a == b) & (a >= 0)], minlength=count)
    return label, np.bincount(label[included], minlength=count), internal, first


def check(region, lidars):
    """Rows give the direct result: labels, counts, gaps at points and on the grid, and the largest V / S."""
    label, cuboids, internal, first = direct(region.centres(), region.included, lidars)
    labels = compare_labels(region, lidars)
    if len(first):
        mine = connect(labels)
        assert np.array_equal(mine.label, label)
        assert np.array_equal(mine.cuboids, cuboids)
        assert np.array_equal(mine.internal, internal)
        assert np.array_equal(mine.first, first)
        assert mine.label.dtype == np.int32
        assert cost_of(labels.grid, cone_rows(lidars)) == vsr_m(mine).max()
    else:
        with pytest.raises(ConfigError, match="everything is excluded"):
            connect(labels)
    points = np.stack(np.meshgrid(*region.centres(), indexing="ij"), axis=-1).reshape(-1, 3)
    for one in lidars:
        gap = digits(region.centres(), one)
        assert np.array_equal(gaps_at(points, one), gap.ravel())
        on_grid = beam_gaps(region, one)
        assert np.array_equal(on_grid[region.included], gap[region.included])
    return label


def box(shape, edges=(0.5, 0.5, 0.5), low=(0, 0, 0)):
    return Region(np.array(low, float), low + np.array(shape) * edges, np.ones(shape, bool))


shapes = st.tuples(*[st.integers(1, 9)] * 3) | st.sampled_from(
    [(64, 3, 2), (200, 2, 3), (130, 3, 2), (65, 1, 1), (1, 1, 40)]
)
edges = st.tuples(*[st.sampled_from([0.5, 1.0, 0.1, 0.3])] * 3)
axes = st.sampled_from(UNIT) | st.tuples(*[st.floats(-4, 4)] * 2).map(lambda rp: tuple(rotation((*rp, 0))[:, 2]))
fans = st.lists(st.sampled_from([-90, -45, -30, 0, 30, 45, 90]) | st.floats(-90, 90), min_size=1, max_size=6).map(
    sorted
)
sites = st.tuples(*[st.integers(-2, 16).map(lambda n: n / 4) | st.floats(-1, 5)] * 3)
lidars_ = st.lists(st.builds(cones, sites, axes, fans), max_size=4)


@pytest.mark.slow
@settings(max_examples=250, deadline=None)
@given(shapes, edges, lidars_, st.sampled_from([0.0, 0.02, 0.3, 0.9]), st.integers(0, 2**32 - 1))
def test_rows_equal_the_direct_evaluation(shape, edges, lidars, excluded, seed):
    region = box(shape, edges)
    region.included[:] = np.random.default_rng(seed).random(shape) >= excluded
    check(region, lidars)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.integers(1, 12)] * 3),
    st.lists(
        st.builds(
            cones,
            st.tuples(*[st.integers(-1, 12).map(lambda n: n / 4)] * 3),
            st.sampled_from(UNIT),
            st.just((-90, -45, 0, 30, 45, 90)),
        ),
        min_size=1,
        max_size=3,
    ),
)
@example((9, 9, 9), [cones((1.25, 1.25, 1.25), axis, (0,)) for axis in UNIT])
def test_centres_on_apices_planes_and_axes(shape, lidars):
    """Positions on centres and faces: whole lines and planes of centres lie exactly on cones."""
    check(box(shape), lidars)


@pytest.mark.parametrize("off", [5e-324, 1e-200, 1e-160, 1e-100, 1e-30, 1e-16, 1e-12, 1e-8])
def test_lines_that_nearly_hit_the_apex(off):
    region = box((9, 9, 9), (1, 1, 1), (-4.5, -4.5, -4.5))
    for axis in (UNIT[0], UNIT[5], rotation((0.3, 0.2, 0))[:, 2], rotation((off, 0, 0))[:, 2]):
        for position in ((off, 0, 0), (0, -off, 0), (off, off, -off), (1, off, off)):
            check(region, [cones(position, axis, (-90, -30, -1e-9, 0, 1e-9, 30, 90))])


@pytest.mark.slow
@pytest.mark.parametrize("along", [0, 1, 2])
def test_a_line_of_centres_on_a_cone(along):
    """The line through the apex lies on the cone: rounding alone gives each centre its digit."""
    region = box((60, 60, 60), (0.1, 0.1, 0.1))
    axis = rotation((0.3, 0.2, 0.7))[:, 2]
    rig = Lidar(np.array([centre[20] for centre in region.centres()]), axis, np.array([axis[along]]))
    on = np.moveaxis(digits(region.centres(), rig), along, 2)[20, 20]
    assert np.count_nonzero(np.diff(on)) > 5
    check(region, [rig])


@pytest.mark.slow
@pytest.mark.parametrize("end", [0, -1])
def test_a_long_line_that_nears_a_cone(end):
    """Clear of the cone by far more than rounding at one end of the line, and by nothing at the other."""
    region = box((200_000, 1, 1), (0.1, 0.1, 0.1))
    x, y, z = region.centres()
    axis = rotation((0.3, 0.2, 0.7))[:, 2]
    rig = Lidar(np.array([x[end], y[0] - 1e-11, z[0]]), axis, np.array([axis[0] if end == 0 else -axis[0]]))
    on = digits(region.centres(), rig).ravel()
    assert np.count_nonzero(np.diff(on)) > 5
    assert np.ptp(on[1:1000] if end == 0 else on[-1000:-1]) == 0
    check(region, [rig])


def test_the_apex_on_a_centre_is_above_every_beam():
    region = box((5, 5, 5))
    label = check(region, [cones((1.25, 1.25, 1.25), rotation((0.3, 0.2, 0.1))[:, 2], (-30, 0, 30, 89))])
    assert (label == label[2, 2, 2]).sum() < 20
    assert digits(region.centres(), cones((1.25, 1.25, 1.25), UNIT[2], (-30, 90)))[2, 2, 2] == 2


def test_labels_equal_breadth_first_search():
    region = Region.from_boxes((0, 0, 0), (6, 4, 2), (0.4, 0.25, 0.2), (((2, 1, 0), (3, 2, 2)),))
    rig = [cones((2.5, 1.4, 1.9), rotation((0.1, -0.2, 0))[:, 2], FAN), cones((2.2, 1.8, 2.1), UNIT[5], FAN)]
    number = sum(digits(region.centres(), lidar) * 17**m for m, lidar in enumerate(rig))
    label, count = naive.breadth_first(number.tolist(), region.included.tolist())
    mine = segment(region, rig)
    assert mine.label.tolist() == label
    assert len(mine) == count


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 0.2, 1.5, np.pi])
def test_the_papers_region(tilt):
    """60 × 20 × 4 m in 48,000 cuboids, four LiDARs of 16 beams."""
    rng = np.random.default_rng(7)
    region = Region.from_boxes((0, 0, 0), (60, 20, 4), (1, 0.5, 0.2), (((27, 8, 0), (33, 12, 4)),))
    axes = [rotation((*(tilt + 0.1 * rng.normal(size=2) * (tilt > 0)), 0))[:, 2] for _ in range(4)]
    check(region, [cones(rng.uniform((28, 9, 2.2), (31, 11, 3)), axis, FAN) for axis in axes])


def test_many_lidars_of_many_beams():
    """Base-n numbers that no word holds: seven LiDARs of 1,000 beams, and 71 LiDARs."""
    rng = np.random.default_rng(3)
    fan = np.sort(rng.uniform(-60, 60, 1000))
    rig = [cones((0.1, 0.1, 0.1), UNIT[2], fan)] * 6 + [cones((1.3, 0.8, 0.6), (0.6, 0.0, 0.8), (-40, -5, 0, 20))]
    region = box((9, 8, 7), (0.3, 0.3, 0.3))
    region.included[2:4, 3:5] = False
    check(region, rig)
    check(region, [cones((9, 9, 9), UNIT[2], (80,))] * 70 + rig[-1:])  # 70 one-beam LiDARs that cut nothing


def test_nothing_cut_and_nothing_left():
    region = box((4, 3, 2))
    check(region, [])
    region.included[:] = False
    check(region, [cones((1, 1, 1), UNIT[2], FAN)])


def test_a_million_beams_are_compared_with_cuboids_and_not_one_sensor_more():
    grid = grid_of(Region.from_boxes((0, 0, 0), (1, 1, 1), (0.5, 0.5, 0.5)))
    check_grid(grid, 100, 10_000)
    with pytest.raises(LidarcfgError, match=r"101 sensors of up to 10,000 beams are 1,010,000 .* at most 1,000,000"):
        check_grid(grid, 101, 10_000)
