"""Subspaces against plain loops, SciPy's labels and bodies worked out by hand."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from lidarcfg.errors import ConfigError
from lidarcfg.study.extents import extents
from lidarcfg.study.spheres import largest_spheres
from lidarcfg.vsr.cones import lidar
from lidarcfg.vsr.metric import surface_m2, volume_m3, vsr_m
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Labels, beam_gaps, connect, grid_of, segment
from tests.naive import vsr as naive

EDGES = (0.8, 0.5, 0.25)
FAN = (-20.0, -5.0, 4.0, 30.0)


def bodies(array, edges=EDGES):
    """Subspaces of a hand-made label array; 0 is left out."""
    array = np.asarray(array)
    region = Region(np.zeros(3), np.array(edges) * array.shape, array > 0)
    padded = np.pad(array, 1).transpose(2, 1, 0)
    alike = [(padded == np.roll(padded, 1, axis)) & (padded > 0) for axis in (2, 1, 0)]
    bits = np.zeros((3, *padded.shape[:2], 64 * -(-array.shape[0] // 64)), bool)
    bits[..., : array.shape[0]] = np.stack(alike)[..., 1:-1]
    links = np.packbits(bits, axis=-1, bitorder="little").view(np.uint64).reshape(3, -1).T.copy()
    found = connect(Labels(region, [], grid_of(region), links, None))
    assert found.label.ravel()[found.first].tolist() == list(range(len(found)))
    return found


def cells(subspaces, number):
    return {tuple(cell) for cell in np.argwhere(subspaces.label == number).tolist()}


def test_a_box_is_abc_over_twice_its_faces():
    box = bodies(np.ones((3, 4, 5)))
    a = 3 * 0.8
    b = 4 * 0.5
    c = 5 * 0.25
    assert vsr_m(box).tolist() == pytest.approx([a * b * c / (2 * (a * b + b * c + c * a))], rel=1e-14)
    assert volume_m3(box) == pytest.approx([a * b * c])
    assert largest_spheres(box).radius_m[0] == pytest.approx(c / 2)
    (extent,) = extents(box, [0])
    assert extent.centroid_m == pytest.approx([a / 2, b / 2, c / 2])
    assert extent.bounds_m[1] == pytest.approx([a, b, c])


def test_an_l_of_three_unit_cubes():
    array = np.zeros((2, 2, 1))
    array[0, 0, 0] = array[1, 0, 0] = array[0, 1, 0] = 1
    body = bodies(array, (1, 1, 1))
    assert len(body) == 1
    assert surface_m2(body).tolist() == [14.0]  # 3 · 6 faces less 2 · 2 joined ones
    assert vsr_m(body).tolist() == pytest.approx([3 / 14])
    assert largest_spheres(body).radius_m[0] == 0.5


def test_boxes_that_touch_at_an_edge_are_two():
    array = np.zeros((2, 2, 1))
    array[0, 0, 0] = array[1, 1, 0] = 1
    body = bodies(array, (1, 1, 1))
    assert len(body) == 2
    assert vsr_m(body).tolist() == pytest.approx([1 / 6, 1 / 6])


def test_a_region_without_lidars_is_one_subspace():
    whole = segment(Region.from_boxes((0, 0, 0), (6, 2, 4), (1, 0.5, 0.2)), [])
    assert len(whole) == 1
    assert vsr_m(whole)[0] == pytest.approx(48 / 88)
    assert whole.gap.shape == (1, 0)


def test_an_exclusion_splits_the_region():
    split = segment(Region.from_boxes((0, 0, 0), (6, 2, 4), (1, 0.5, 0.2), (((2, 0, 0), (4, 2, 4)),)), [])
    assert len(split) == 2
    assert vsr_m(split) == pytest.approx([16 / 40, 16 / 40])


def test_everything_excluded_is_an_error():
    region = Region.from_boxes((0, 0, 0), (1, 1, 1), (1, 1, 1), (((0, 0, 0), (1, 1, 1)),))
    with pytest.raises(ConfigError, match="no cuboid left"):
        segment(region, [])


def test_a_single_flat_beam_is_a_plane():
    region = Region.from_boxes((0, 0, 0), (4, 4, 4), (1, 1, 1))
    halves = segment(region, [lidar((2, 2, 2), (0, 0, 0), np.array([0.0]))])
    assert halves.gap.ravel().tolist() == [0, 1]
    assert vsr_m(halves) == pytest.approx([32 / 64, 32 / 64])


def test_the_apex_on_a_cuboids_centre_is_above_every_beam():
    region = Region.from_boxes((0, 0, 0), (3, 3, 3), (1, 1, 1))
    gap = beam_gaps(region, lidar((1.5, 1.5, 1.5), (0.3, 0.2, 0.1), np.sin(np.radians([-30, 0, 30]))))
    assert gap[1, 1, 1] == 3


def test_a_centre_on_a_cone_belongs_to_the_gap_above():
    region = Region.from_boxes((0, 0, 0), (1, 1, 3), (1, 1, 1))
    gap = beam_gaps(region, lidar((0.5, 0.5, 1.5), (0, 0, 0), np.array([-1.0, 0.0, 1.0])))
    assert gap[0, 0].tolist() == [1, 3, 3]  # straight down is on the −90° beam, straight up on the 90° one


poses = st.tuples(st.tuples(st.floats(-1, 5), st.floats(-1, 3), st.floats(-1, 2)), st.tuples(*[st.floats(-4, 4)] * 3))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.lists(poses, min_size=1, max_size=3), st.integers(1, len(FAN)))
def test_the_kernels_equal_their_twins(sensors, beams):
    region = Region.from_boxes((0, 0, 0), (4, 2, 1), EDGES, (((1.5, 0.4, 0), (2.5, 1.1, 0.6)),))
    sine = np.sin(np.radians(FAN[:beams]))
    subspaces = segment(region, [lidar(*sensor, sine) for sensor in sensors])
    axes = [axis.tolist() for axis in region.centres()]
    number = [
        [
            [naive.base_n([naive.digit((x, y, z), *s, FAN[:beams]) for s in sensors], [beams + 1] * len(sensors)) for z in axes[2]]
            for y in axes[1]
        ]
        for x in axes[0]
    ]  # fmt: skip
    label, count = naive.breadth_first(number, region.included.tolist())
    assert subspaces.label.tolist() == label
    assert len(subspaces) == count
    assert subspaces.cuboids.sum() == region.included.sum()  # volume is conserved
    for n in range(count):
        assert vsr_m(subspaces)[n] == pytest.approx(naive.vsr(cells(subspaces, n), EDGES), rel=1e-12)
        digits = naive.base_n(subspaces.gap[n].tolist(), [beams + 1] * len(sensors))
        i, j, k = next(iter(cells(subspaces, n)))
        assert number[i][j][k] == digits


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.tuples(*[st.integers(1, 7)] * 3))
def test_components_agree_with_scipy(seed, kinds, shape):
    array = np.random.default_rng(seed).integers(0, kinds + 1, shape)
    assume(array.any())
    mine = bodies(array)
    theirs = sum(ndimage.label(array == kind)[1] for kind in range(1, kinds + 1))
    assert len(mine) == theirs
    for n in range(len(mine)):
        assert vsr_m(mine)[n] == pytest.approx(naive.vsr(cells(mine, n), EDGES), rel=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.lists(poses, min_size=2, max_size=4), st.randoms())
def test_the_order_of_the_lidars_does_not_matter(sensors, random):
    region = Region.from_boxes((0, 0, 0), (4, 2, 1), EDGES)
    lidars = [lidar(*sensor, np.sin(np.radians(FAN))) for sensor in sensors]
    straight = segment(region, lidars)
    random.shuffle(lidars)
    shuffled = segment(region, lidars)
    assert np.array_equal(straight.label, shuffled.label)
    assert np.array_equal(vsr_m(straight), vsr_m(shuffled))


def test_a_spin_about_its_own_axis_changes_no_cone():
    region = Region.from_boxes((0, 0, 0), (4, 2, 1), (0.2, 0.1, 0.1))
    a = beam_gaps(region, lidar((2.03, 1.01, 0.52), (0.0, 0.0, 0.0), np.sin(np.radians(FAN))))
    b = beam_gaps(region, lidar((2.03, 1.01, 0.52), (0.0, 0.0, 2.1), np.sin(np.radians(FAN))))
    assert np.array_equal(a, b)


def test_labels_tell_apart_what_base_n_numbers_do():
    """Twenty LiDARs of 1,000 beams: numbers of 200 bits, which no word holds."""
    rng = np.random.default_rng(1)
    region = Region.from_boxes((0, 0, 0), (6, 5, 4), (1, 1, 1), (((2, 2, 0), (4, 3, 4)),))
    elevation = np.sort(rng.uniform(-80, 80, 1000))
    sensors = [(rng.uniform((1, 1, 1), (5, 4, 3)).tolist(), rng.uniform(-3, 3, 3).tolist()) for _ in range(20)]
    lidars = [lidar(*sensor, np.sin(np.radians(elevation))) for sensor in sensors]
    digits = np.stack([beam_gaps(region, one) for one in lidars], axis=-1).tolist()
    assert digits[0][3][2] == [naive.digit((0.5, 3.5, 2.5), *sensor, elevation) for sensor in sensors]
    number = [[[naive.base_n(cell, [1001] * 20) for cell in line] for line in layer] for layer in digits]
    label, count = naive.breadth_first(number, region.included.tolist())
    assert segment(region, lidars).label.tolist() == label
    assert count > 90


def test_subspaces_come_back_as_a_voxel_grid():
    region = Region.from_boxes((0, 0, 0), (4, 4, 4), (1, 1, 1), (((0, 0, 0), (1, 1, 1)),))
    halves = segment(region, [lidar((2, 2, 1), (0, 0, 0), np.array([0.0]))])
    grid = halves.voxel_grid(vsr_m(halves))
    colour = {tuple(v.grid_index.tolist()): v.color for v in grid.get_voxels()}
    assert len(colour) == 63
    assert colour[1, 1, 0][2] > colour[1, 1, 0][0]  # the thin slab below is blue
    assert colour[1, 1, 3][0] > colour[1, 1, 3][2]  # the thick one above red
    scaled = halves.scaled_voxel_grid(vsr_m(halves))  # the same of cubes
    assert {tuple(v.grid_index.tolist()): v.color.tolist() for v in scaled.get_voxels()} == {
        key: value.tolist() for key, value in colour.items()
    }


def test_subspaces_come_back_as_meshes():
    """Their volumes and surfaces are those that the metric has, by Open3D's own sums."""
    region = Region.from_boxes((0, 0, 0), (4, 2, 1), (0.5, 0.25, 0.2), (((0, 0, 0), (1, 1, 1)),))
    parts = segment(region, [lidar((2, 1, 0.5), (0, 0, 0), np.array([-0.1, 0.2]))])
    assert len(parts) > 1
    for number in range(len(parts)):
        mesh = parts.mesh(number)
        assert mesh.get_surface_area() == pytest.approx(surface_m2(parts)[number])
        assert len(parts.line_set(number).lines) >= 12
        if mesh.is_watertight():  # it may touch itself at an edge
            assert mesh.get_volume() == pytest.approx(volume_m3(parts)[number])
    both = parts.mesh(*range(len(parts)))
    assert both.get_volume() == pytest.approx(volume_m3(parts).sum())
    with pytest.raises(ConfigError, match="no cuboid to draw"):
        parts.blind_mesh()  # everything is seen
