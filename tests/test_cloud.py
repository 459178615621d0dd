"""Clouds: exact through all three kinds of file, readable by Open3D and numpy, and what is refused."""

import json

import numpy as np
import pytest

from lidarcfg.cloud import FIELDS, PointCloud, concatenate, load_cloud, save_clouds
from lidarcfg.errors import CloudError


def cloud(count: int = 50, names=("left", "right"), seed: int = 0) -> PointCloud:
    rng = np.random.default_rng(seed)
    return PointCloud(
        xyz=rng.normal(0, 50, (count, 3)),
        intensity=rng.integers(0, 256, count, np.uint8),
        ring=rng.integers(0, 16, count, np.uint8),
        time_ns=rng.integers(0, 5 * 10**18, count),
        sensor=rng.integers(0, len(names), count, np.uint16),
        sensor_names=names,
        return_type=rng.integers(0, 2, count, np.uint8),
    )


def assert_same(a: PointCloud, b: PointCloud) -> None:
    assert a.sensor_names == b.sensor_names
    for key, kind in FIELDS.items():
        assert getattr(a, key).dtype == getattr(b, key).dtype == kind
        np.testing.assert_array_equal(getattr(a, key), getattr(b, key))


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz", "PLY"])
def test_round_trip(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    parts = [cloud(50), cloud(0), cloud(7, ("left", "right", 'odd "name"\n'), seed=1)]
    assert save_clouds(path, iter(parts)) == 57
    assert_same(load_cloud(path), concatenate(parts))
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


def test_concatenate_matches_sensors_by_name():
    whole = concatenate([cloud(5, ("a", "b")), cloud(5, ("b", "c"), seed=1)])
    assert whole.sensor_names == ("a", "b", "c")
    names = np.array(whole.sensor_names)[whole.sensor]
    assert (names[:5] == np.array(["a", "b"])[cloud(5).sensor]).all()
    assert (names[5:] == np.array(["b", "c"])[cloud(5, seed=1).sensor]).all()
    assert len(concatenate([]).xyz) == 0


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
def test_open3d_reads_every_field(tmp_path, suffix, capfd):
    import open3d as o3d

    ours = cloud()
    save_clouds(tmp_path / f"a.{suffix}", [ours])
    theirs = o3d.t.io.read_point_cloud(str(tmp_path / f"a.{suffix}")).point
    assert capfd.readouterr() == ("", "")
    assert (theirs["positions"].numpy() == ours.xyz).all()
    for key in ("intensity", "ring", "return_type", "sensor"):
        assert (theirs[key].numpy().ravel() == getattr(ours, key)).all()
    if suffix == "pcd":
        assert (theirs["time_ns"].numpy().ravel() == ours.time_ns).all()
    else:
        seconds, rest = theirs["time_s"].numpy().ravel(), theirs["time_rest_ns"].numpy().ravel()
        assert (seconds.astype(np.int64) * 10**9 + rest == ours.time_ns).all()


def test_npz_needs_no_pickles(tmp_path):
    save_clouds(tmp_path / "a.npz", [cloud()])
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {*FIELDS, "sensor_names"}
        assert arrays["sensor_names"].tolist() == ["left", "right"]


def test_the_same_cloud_gives_the_same_bytes(tmp_path):
    for suffix in ("ply", "pcd", "npz"):
        for name in "ab":
            save_clouds(tmp_path / f"{name}.{suffix}", [cloud()])
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_wrong_suffix(tmp_path):
    message = r"a\.xyz: \.xyz is not a kind of cloud; allowed: \.ply, \.pcd, \.npz"
    with pytest.raises(CloudError, match=message):
        save_clouds(tmp_path / "a.xyz", [cloud()])
    with pytest.raises(CloudError, match=message):
        load_cloud(tmp_path / "a.xyz")


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
@pytest.mark.parametrize(
    "raw", [b"", b"hello", b"\xff\xfe" * 500, b"ply\nformat ascii 1.0\nend_header\n", b"DATA ascii\n"]
)
def test_not_a_cloud(tmp_path, suffix, raw):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(raw)
    with pytest.raises(CloudError, match=rf"a\.{suffix}: ") as error:
        load_cloud(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
def test_cut(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    save_clouds(path, [cloud()])
    raw = path.read_bytes()
    for size in (10, 100, 300, len(raw) - 5):
        path.write_bytes(raw[:size])
        with pytest.raises(CloudError):
            load_cloud(path)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
def test_empty_and_not_finite(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    save_clouds(path, [cloud(0)])
    with pytest.raises(CloudError, match="the cloud is empty"):
        load_cloud(path)
    bad = cloud()
    bad.xyz[3, 1] = np.nan
    save_clouds(path, [bad])
    with pytest.raises(CloudError, match="point 3 is not finite"):
        load_cloud(path)


def test_missing_fields(tmp_path):
    np.savez(tmp_path / "a.npz", xyz=np.zeros((3, 3)))
    with pytest.raises(CloudError, match="missing: intensity, ring, time_ns, sensor, return_type, sensor_names"):
        load_cloud(tmp_path / "a.npz")
    save_clouds(tmp_path / "a.ply", [cloud()])
    raw = (tmp_path / "a.ply").read_bytes().replace(b"uchar ring", b"uchar rong")
    (tmp_path / "a.ply").write_bytes(raw)
    with pytest.raises(CloudError, match="missing: ring"):
        load_cloud(tmp_path / "a.ply")


def test_sensor_without_a_name(tmp_path):
    save_clouds(tmp_path / "a.pcd", [cloud()])
    raw = (tmp_path / "a.pcd").read_bytes().replace(f"# sensor {json.dumps('right')}\n".encode(), b"")
    (tmp_path / "a.pcd").write_bytes(raw)
    with pytest.raises(CloudError, match="a point is of sensor 1; there are 1"):
        load_cloud(tmp_path / "a.pcd")


def test_no_such_file_or_folder(tmp_path):
    for suffix in ("ply", "pcd", "npz"):
        with pytest.raises(CloudError, match="no such file"):
            load_cloud(tmp_path / f"none.{suffix}")
        with pytest.raises(CloudError, match="no such file"):
            save_clouds(tmp_path / "none" / f"a.{suffix}", [cloud()])
