"""The cuboid grid: counts by hand, sizes that do not divide, and Open3D's voxel grids there and back."""

import numpy as np
import open3d as o3d
import pytest

from lidarcfg.config.models import loads
from lidarcfg.errors import ConfigError
from lidarcfg.vsr.region import Region, RegionFile, cuboids_needed
from tests.refusals import exchanged, refused

PAPER = "min_m: [0, 0, 0]\nmax_m: [60, 20, 4]\ncuboid_m: [1, 0.5, 0.2]\n"


def test_the_papers_region():
    region = Region.from_boxes((0, 0, 0), (60, 20, 4), (1, 0.5, 0.2), (((27, 8, 0), (33, 12, 4)),))
    assert region.shape == (60, 40, 20)
    assert region.included.sum() == 60 * 40 * 20 - 6 * 8 * 20
    x, y, z = region.centres()
    assert (x[0], y[0], z[0]) == pytest.approx((0.5, 0.25, 0.1))
    assert (x[-1], y[-1], z[-1]) == pytest.approx((59.5, 19.75, 3.9))
    left_out = np.argwhere(~region.included)
    assert left_out.min(axis=0).tolist() == [27, 16, 0]
    assert left_out.max(axis=0).tolist() == [32, 23, 19]


def test_an_exclusion_takes_its_lower_bound_and_not_its_upper():
    region = Region.from_boxes((0, 0, 0), (4, 1, 1), (1, 1, 1), (((0.5, 0, 0), (2.5, 1, 1)),))
    assert region.included[:, 0, 0].tolist() == [False, False, True, True]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[1, 0.5, 0.2]", "[0.7, 0.5, 0.2]", "cuboid_m[0]: 0.7 does not divide the region's 60 along x; sizes that do: 0.6 and 0.75"),
        ("[1, 0.5, 0.2]", "[1, 0.5, 9]", "cuboid_m[2]: 9 does not divide the region's 4 along z; sizes that do: 4"),
        ("[1, 0.5, 0.2]", "[1e-3, 1e-3, 1e-3]", "cuboid_m: makes more than the 2,147,483,647 cuboids allowed"),
        ("[1, 0.5, 0.2]", "[1e-300, 1, 1]", "cuboid_m: makes more than"),
        ("[1, 0.5, 0.2]", "[0, 0.5, 0.2]", "cuboid_m[0]: 0 is too small; allowed: above 0"),
        ("[60, 20, 4]", "[60, 0, 4]", "max_m[1]: 0 is not above min_m's 0"),
    ],
)  # fmt: skip
def test_refused(old, new, message):
    with refused(message, kind=ConfigError):
        loads(exchanged(PAPER, old, new), RegionFile, "f.yaml")


def test_an_open3d_voxel_grid_is_a_region():
    grid = o3d.geometry.VoxelGrid.create_dense((1.0, 2.0, 3.0), (0, 0, 0), 0.5, 2.0, 1.0, 1.5)
    grid.remove_voxel((1, 1, 1))
    region = Region.from_voxel_grid(grid)
    assert region.shape == (4, 2, 3)
    assert np.argwhere(~region.included).tolist() == [[1, 1, 1]]
    assert region.min_m == pytest.approx([1, 2, 3])
    assert region.cuboid_m == pytest.approx([0.5, 0.5, 0.5])
    assert [axis[0] for axis in region.centres()] == pytest.approx(grid.get_voxel_center_coordinate((0, 0, 0)))


def test_cuboids_go_through_a_scaled_copy_and_back():
    region = Region.from_boxes((1, -2, 0), (4, 2, 1), (1, 0.5, 0.2), (((2, 0, 0), (3, 1, 1)),))
    index = np.argwhere(region.included)
    grid = region.scaled_voxel_grid(index, np.zeros((len(index), 3)))
    assert len(grid.get_voxels()) == len(index)
    back = Region.from_voxel_grid(grid, region.cuboid_m)
    assert np.array_equal(back.included, region.included)
    assert back.min_m == pytest.approx(region.min_m)
    assert back.max_m == pytest.approx(region.max_m)


def test_a_voxel_grid_has_the_region_s_proportions():
    """Cuboids of 1 × 0.5 × 0.2 m as cubes of 0.1 m: 500 of each, in Open3D's bounds; each of its cuboid's colour."""
    region = Region.from_boxes((1, -2, 0), (4, 2, 1), (1, 0.5, 0.2), (((2, 0, 0), (3, 1, 1)),))
    index = np.argwhere(region.included)
    colour = index / np.array(region.shape)
    grid = region.voxel_grid(index, colour, 0.1)
    np.testing.assert_allclose(grid.get_min_bound(), (1, -2, 0), atol=1e-9)
    np.testing.assert_allclose(grid.get_max_bound(), (4, 2, 1), atol=1e-9)
    voxels = grid.get_voxels()
    assert len(voxels) == len(index) * 10 * 5 * 2
    for voxel in voxels[::997]:
        at = np.array(grid.get_voxel_center_coordinate(voxel.grid_index))
        cuboid = ((at - region.min_m) / region.cuboid_m).astype(int)
        np.testing.assert_allclose(voxel.color, cuboid / np.array(region.shape))
    usual = region.voxel_grid(index, colour)
    assert usual.voxel_size == pytest.approx(0.2)
    np.testing.assert_allclose(usual.get_max_bound(), (4, 2, 1), atol=0.21)
    with pytest.raises(ConfigError, match="voxel_m is 0; allowed: above 0"):
        region.voxel_grid(index, colour, 0)


def test_cuboids_as_a_mesh_and_lines():
    """An L of three cuboids: volume, surface and edges by hand; watertight and outward for Open3D."""
    region = Region.from_boxes((1, -2, 0), (4, 2, 1), (1, 0.5, 0.2))
    chosen = np.zeros(region.shape, bool)
    chosen[0, 0, 0] = chosen[1, 0, 0] = chosen[0, 1, 0] = True
    mesh = region.mesh(chosen)
    assert mesh.is_watertight()
    assert mesh.is_orientable()
    assert mesh.get_volume() == pytest.approx(3 * 1 * 0.5 * 0.2)
    assert mesh.get_surface_area() == pytest.approx(2 * 3 * 0.5 + 4 * 1 * 0.2 + 4 * 0.5 * 0.2)
    np.testing.assert_allclose(mesh.get_min_bound(), (1, -2, 0))
    np.testing.assert_allclose(mesh.get_max_bound(), (3, -1, 0.2))
    lines = region.line_set(chosen)
    ends = np.asarray(lines.points)[np.asarray(lines.lines)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert length.sum() == pytest.approx(2 * (4 * 1 + 4 * 0.5) + 6 * 0.2)  # six corners of the L, seen from above
    with pytest.raises(ConfigError, match="no cuboid to draw"):
        region.mesh(np.zeros(region.shape, bool))


def test_an_empty_voxel_grid_is_refused():
    with pytest.raises(ConfigError, match="no voxels"):
        Region.from_voxel_grid(o3d.geometry.VoxelGrid())


def test_objects_are_rounded_up_to_whole_cuboids():
    assert cuboids_needed((0.5, 0.5, 1.7), np.array([1, 0.5, 0.2])) == (1, 1, 9)
    assert cuboids_needed((1.0, 0.51, 0.6000000000000001), np.array([1, 0.5, 0.2])) == (1, 2, 3)
