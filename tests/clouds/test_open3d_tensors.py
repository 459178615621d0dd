"""Points to Open3D and back: every attribute exact, by Open3D's own readers and operations too; and what is refused."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest

from lidarcfg.clouds.cloud import FIELDS, PointCloud, save_clouds
from lidarcfg.errors import CloudError
from tests.clouds.test_cloud import assert_same, cloud, no_warning


def back(points, made, on_warning=no_warning):
    return PointCloud.from_open3d(points, made.sensor_names, made.object_names, on_warning)


def test_every_attribute_comes_back_exact():
    objects = np.arange(50, dtype=np.int32) % 4 - 1
    driver = {"range_mm": np.arange(50, dtype=np.uint32), "near_ir": np.arange(50, dtype=np.uint16)}
    made = replace(cloud(), object=objects, object_names=("car", "ground", "post"), driver=driver)
    points = made.to_open3d()
    kinds = {"intensity": "UInt8", "ring": "UInt8", "time_ns": "Int64", "sensor": "UInt16", "return_type": "UInt8"}
    kinds |= {"positions": "Float64", "object": "Int32", "range_mm": "UInt32", "near_ir": "UInt16"}
    assert {name: str(tensor.dtype) for name, tensor in points.point.items()} == kinds
    found = back(points, made)
    assert_same(found, made)
    assert (found.object.tolist(), found.object_names) == (objects.tolist(), made.object_names)
    assert {name: column.tolist() for name, column in found.driver.items()} == {
        n: c.tolist() for n, c in driver.items()
    }


def test_a_copy_shares_nothing():
    made = cloud()
    before = made.xyz.copy()
    points = made.to_open3d()
    points.translate([1.0, 0, 0])
    np.testing.assert_array_equal(made.xyz, before)
    found = back(points, made)
    points.translate([1.0, 0, 0])
    np.testing.assert_array_equal(found.xyz, before + np.array([1.0, 0, 0]))


def test_no_points():
    made = PointCloud.none(("a", "b"))
    assert_same(back(made.to_open3d(), made), made)


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
def test_our_files_read_by_open3d_are_the_same_points(tmp_path, suffix):
    """Of a PLY the times are two attributes, which are joined exactly."""
    made = cloud(200)
    save_clouds(tmp_path / f"a.{suffix}", [made])
    points = o3d.t.io.read_point_cloud(str(tmp_path / f"a.{suffix}"))
    assert points.point.positions.dtype == o3d.core.float64
    assert_same(back(points, made), made)
    if suffix == "pcd":
        assert {name: str(t.dtype) for name, t in points.point.items()} == {
            name: str(t.dtype) for name, t in made.to_open3d().point.items()
        }


def test_what_open3d_writes_of_them_it_reads_back(tmp_path):
    made = cloud(200)
    o3d.t.io.write_point_cloud(str(tmp_path / "a.pcd"), made.to_open3d())
    assert_same(back(o3d.t.io.read_point_cloud(str(tmp_path / "a.pcd")), made), made)


def test_what_open3d_selects_has_its_attributes():
    made = cloud()
    near = made.to_open3d().select_by_mask(o3d.core.Tensor(made.ring < 4))
    assert_same(back(near, made), made.rows(made.ring < 4))


def test_a_legacy_cloud_has_coordinates_alone():
    told = []
    points = cloud().to_open3d().to_legacy()
    points.estimate_normals()
    found = PointCloud.from_open3d(points, on_warning=told.append)
    np.testing.assert_array_equal(found.xyz, cloud().xyz)
    assert found.sensor_names == ("cloud",)
    lacking = "has no intensity, ring, time_ns, sensor, return_type; 0 is assumed"
    assert told == [f"the Open3D cloud {lacking}; normals ignored"]


def test_names_of_other_programs_and_points_without_return():
    """A float intensity to 1 is scaled; seconds are times; NaN is no return; sensors are called by their numbers."""
    points = o3d.t.geometry.PointCloud(np.array([[1.0, 2, 3], [np.nan] * 3, [4, 5, 6]], np.float32))
    columns = {
        "intensity": np.array([0.0, 1.0, 0.2], np.float32),
        "timestamp": np.array([1.5, 2.5, 3.25]),
        "sensor": np.array([1, 0, 0], np.int32),
        "laser_id": np.array([3, 4, 5], np.uint16),
        "curvature": np.array([7.0, 8, 9]),
    }
    for name, column in columns.items():
        points.point[name] = o3d.core.Tensor(column[:, None])
    told = []
    found = PointCloud.from_open3d(points, on_warning=told.append)
    assert found.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found.intensity.tolist() == [0, 51]
    assert found.time_ns.tolist() == [1_500_000_000, 3_250_000_000]
    assert (found.sensor.tolist(), found.sensor_names) == ([1, 0], ("0", "1"))
    assert found.ring.tolist() == [3, 5]
    assert {name: column.tolist() for name, column in found.driver.items()} == {"curvature": [7, 9]}
    assert len(told) == 1
    assert "1 points without coordinates are dropped" in told[0]
    assert all(getattr(found, key).dtype == kind for key, kind in FIELDS.items())


@pytest.mark.parametrize(
    ("name", "values", "what"),
    [
        ("ring", [0, 300], "the Open3D cloud: point 1: ring is 300; allowed: 0 to 255"),
        ("sensor", [0, 2], "the Open3D cloud: a point is of sensor 2; there are 2"),
        ("object", [0, 5], "the Open3D cloud: point 1: object is 5; allowed: -1 to 0"),
    ],
)
def test_what_no_cloud_holds_is_refused(name, values, what):
    points = cloud(2).to_open3d()
    points.point[name] = o3d.core.Tensor(np.array(values, np.int64)[:, None])
    with pytest.raises(CloudError, match=what):
        PointCloud.from_open3d(points, ("left", "right"), ("car",), no_warning)


def test_something_else_is_refused_by_its_type():
    with pytest.raises(CloudError, match="a list is no cloud of Open3D; allowed: open3d"):
        PointCloud.from_open3d([[0, 0, 0]])
