"""Clouds that other programs wrote: ASCII, big-endian, floats, other names, fewer fields; and files that lie."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.clouds.cloud import load_cloud
from lidarcfg.errors import CloudError
from tests.refusals import refused

PCD = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS {fields}
SIZE {sizes}
TYPE {types}
COUNT {counts}
WIDTH {points}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {points}
DATA {data}
"""


def pcd(points, data="ascii", fields="x y z intensity ring", sizes="4 4 4 4 2", types="F F F F U", counts=None):
    counts = counts or " ".join("1" for _ in fields.split())
    return PCD.format(points=points, data=data, fields=fields, sizes=sizes, types=types, counts=counts).encode()


def ply(properties, count, kind="ascii", more=""):
    lines = "".join(f"property {text}\n" for text in properties)
    return f"ply\nformat {kind} 1.0\nelement vertex {count}\n{lines}{more}end_header\n".encode()


def loaded(path, raw):
    """The cloud, and the one warning."""
    path.write_bytes(raw)
    told = []
    cloud = load_cloud(path, told.append)
    assert len(told) == 1
    assert told[0].startswith(f"{path}: ")
    return cloud, told[0].removeprefix(f"{path}: ")


def test_pcd_in_ascii(tmp_path):
    """As PCL writes it: no time, no sensor, and nan where there was no return."""
    text = b"1 2 3 12 5\n-1.5e1 2.25 3 255 0\nnan nan nan 0 0\n7 8 9 0.0 65535\n"
    with pytest.raises(CloudError, match="point 2: ring is 65535; allowed: 0 to 255"):
        loaded(tmp_path / "a.pcd", pcd(4) + text)
    cloud, told = loaded(tmp_path / "a.pcd", pcd(4) + text.replace(b"65535", b"3"))
    assert told == "has no time_ns, sensor, return_type; 0 is assumed; 1 points without coordinates are dropped"
    assert cloud.xyz.tolist() == [[1, 2, 3], [-15, 2.25, 3], [7, 8, 9]]
    assert (cloud.intensity.tolist(), cloud.ring.tolist()) == ([12, 255, 0], [5, 0, 3])
    assert (cloud.sensor_names, cloud.time_ns.tolist()) == (("a",), [0, 0, 0])


def test_pcd_compressed_by_open3d(tmp_path):
    """Open3D writes binary_compressed, of floats alone."""
    import open3d as o3d

    rng = np.random.default_rng(1)
    cloud = o3d.t.geometry.PointCloud()
    xyz = rng.normal(size=(500, 3)).astype(np.float32)
    intensity = rng.integers(0, 256, (500, 1)).astype(np.float32)
    cloud.point.positions = o3d.core.Tensor(xyz)
    cloud.point.intensity = o3d.core.Tensor(intensity)
    for ascii_too in ({"write_ascii": True}, {"compressed": True}, {}):
        assert o3d.t.io.write_point_cloud(str(tmp_path / "a.pcd"), cloud, **ascii_too)
        found, told = loaded(tmp_path / "a.pcd", (tmp_path / "a.pcd").read_bytes())
        assert told == "has no ring, time_ns, sensor, return_type; 0 is assumed"
        np.testing.assert_allclose(found.xyz, xyz, rtol=1e-5 if ascii_too else 0, atol=1e-5 if ascii_too else 0)
        assert (found.intensity == intensity.ravel()).all()


@pytest.mark.parametrize(("kind", "order"), [("binary_big_endian", ">"), ("binary_little_endian", "<"), ("ascii", "")])
def test_ply_with_other_types_and_a_mesh(tmp_path, kind, order):
    """Double and float, short and unsigned; normals that no cloud of ours has; faces after the points."""
    kinds = [
        ("x", "f8"),
        ("y", "f4"),
        ("z", "i4"),
        ("nx", "f4"),
        ("Reflectivity", "u2"),
        ("scalar_ring", "f4"),
        ("t", "u4"),
    ]
    given = [(1e5 + 0.001, -2.5, 3, 0.1, 200, 7, 4_000_000_000), (-1e5, 0.125, -4, 0.2, 0, 31, 5)]
    names = {"f8": "double", "f4": "float", "i4": "int", "u2": "ushort", "u4": "uint"}
    head = ply(
        [f"{names[type_]} {name}" for name, type_ in kinds],
        2,
        kind,
        "element face 1\nproperty list uchar int vertex_indices\n",
    )
    if order:
        rows = np.array(given, [(name, order + type_) for name, type_ in kinds])
        body = rows.tobytes() + b"\x03" + np.array([0, 1, 0], f"{order}i4").tobytes()
    else:
        body = "".join(" ".join(map(repr, row)) + "\n" for row in given).encode() + b"3 0 1 0\n"
    cloud, told = loaded(tmp_path / "a.ply", head + body)
    assert told == "has no sensor, return_type; 0 is assumed; nx ignored"
    assert cloud.xyz.tolist() == [[1e5 + 0.001, -2.5, 3], [-1e5, 0.125, -4]]
    assert (cloud.intensity.tolist(), cloud.ring.tolist()) == ([200, 0], [7, 31])
    assert cloud.time_ns.tolist() == [4_000_000_000, 5]


def test_ply_by_open3d_and_as_a_mesh(tmp_path):
    import open3d as o3d

    xyz = np.random.default_rng(2).normal(size=(20, 3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz))
    for ascii_too in (False, True):
        assert o3d.io.write_point_cloud(str(tmp_path / "a.ply"), cloud, write_ascii=ascii_too)
        found, _ = loaded(tmp_path / "a.ply", (tmp_path / "a.ply").read_bytes())
        np.testing.assert_allclose(found.xyz, xyz, atol=1e-5 if ascii_too else 0)


@pytest.mark.parametrize(
    ("column", "expected", "told"),
    [
        ([0, 100, 255], [0, 100, 255], None),
        ([0.4, 99.6, 255], [0, 100, 255], "intensity is rounded"),
        ([0, 0.5, 1], [0, 128, 255], "intensity, from 0 to 1, is scaled to 0 to 255"),
        ([0, 32768, 65535], [0, 128, 255], "intensity, from 0 to 65535, is scaled to 0 to 255"),
        ([-50, 25, 50], [0, 191, 255], "intensity, from -50 to 50, is scaled to 0 to 255"),
    ],
)
def test_intensities(tmp_path, column, expected, told):
    text = "".join(f"0 0 0 {value}\n" for value in column).encode()
    cloud, warning = loaded(tmp_path / "a.ply", ply(["float x", "float y", "float z", "float intensity"], 3) + text)
    assert cloud.intensity.tolist() == expected
    assert warning.partition("; 0 is assumed")[2] == (f"; {told}" if told else "")


@pytest.mark.parametrize(
    ("column", "expected", "told"),
    [
        ("double timestamp", 1_700_000_000_250_000_000, "timestamp is taken for seconds"),
        ("double time", 1_700_000_000_250_000_000, "time is taken for seconds"),
    ],
)
def test_times_in_seconds(tmp_path, column, expected, told):
    head = ply(["float x", "float y", "float z", column], 1)
    cloud, warning = loaded(tmp_path / "a.ply", head + b"0 0 0 1700000000.25\n")
    assert (cloud.time_ns.tolist(), warning.partition("; ")[2].partition("; ")[2]) == ([expected], told)
    cloud, warning = loaded(tmp_path / "a.ply", head + b"0 0 0 1700000000250000000\n")
    assert (cloud.time_ns.tolist(), told.replace("seconds", "nanoseconds") in warning) == (
        [int(1.70000000025e18)],
        True,
    )


def test_sensors_by_number(tmp_path):
    head = ply(["float x", "float y", "float z", "float sensor"], 3)
    cloud, _ = loaded(tmp_path / "a.ply", head + b"0 0 0 0\n0 0 0 2\n0 0 0 1\n")
    assert (cloud.sensor_names, cloud.sensor.tolist()) == (("0", "1", "2"), [0, 2, 1])


@pytest.mark.parametrize(
    ("raw", "what"),
    [
        (pcd(300) + b"1 2 3 4 5\n", "300 points are announced, 1 are there"),
        (pcd(99999999999999, "binary") + b"1 2 3 4 5\n", "not a whole pcd file"),
        (pcd(4000000000, "binary_compressed") + b"\x04\0\0\0\xff\xff\xff\xff", "not a whole pcd file"),
        (pcd(2, "binary_compressed") + b"\xff\xff\xff\xff\x38\0\0\0" + bytes(4), "not a whole pcd file"),
        (pcd(2) + b"a b c d e\n1 2 3 4 5\n", "not a whole pcd file"),
        (pcd(2) + b"1 2\n1 2 3 4 5\n", "not a whole pcd file"),
        (pcd(0) + b"", "the cloud is empty"),
        (pcd("many"), "not a whole pcd file"),
        (pcd(2, "binary", sizes="4 4 4 3 2") + bytes(60), "not a whole pcd file"),
        (pcd(2, "binary", sizes="4 4") + bytes(60), "not a whole pcd file"),
        (pcd(2, "binary", fields="x x z intensity ring") + bytes(60), "not a whole pcd file"),
        (pcd(1, fields="a b c d e") + b"1 2 3 4 5\n", "missing: x, y, z"),
        (b"#\n" * 5000 + pcd(1) + b"1 2 3 4 5\n", "not a whole pcd file: no header"),
        (b"FIELDS " + b"x " * 100_000 + b"\nDATA ascii\n1 2 3\n", "not a whole pcd file"),
        (pcd(2) + b"1 2 3 nan 5\n1 2 3 4 5\n", "intensity is not finite"),
        (pcd(1, fields="x y z intensity time", sizes="4 4 4 4 8", types="F F F F F") + b"1 2 3 4 nan\n", "time holds times"),
        (pcd(1, types="F F F F F", sizes="4 4 4 4 4") + b"1 2 3 4 2.5\n", "ring holds something other than whole numbers"),
    ],
)  # fmt: skip
def test_pcd_that_lies(tmp_path, raw, what):
    (tmp_path / "a.pcd").write_bytes(raw)
    with refused(what, r"a\.pcd: ", CloudError):
        load_cloud(tmp_path / "a.pcd", lambda text: None)


@pytest.mark.parametrize(
    ("raw", "what"),
    [
        (ply(["float x"], 1) + b"1\n", "missing: y, z"),
        (ply(["float x", "float y", "float z"], 300) + b"1 2 3\n", "row 1: early end-of-file"),
        (ply(["float x", "float y", "float z"], 10**15) + b"1 2 3\n", "not a whole ply file"),
        (ply(["float x", "float y", "float z"], 1) + b"1 2 c\n", "malformed input"),
        (ply(["float x", "float y", "float z"], 1) + b"1 2\n", "early end-of-line"),
        (ply(["float x", "float y", "float x"], 1) + b"1 2 3\n", "not a whole ply file"),
        (ply(["list uchar float x", "float y", "float z"], 1) + b"1 2 3 4\n", "missing: x"),
        (ply(["float x", "float y", "float z"], 1, more=f"element none {10**15}\n") + b"1 2 3\n", "not a whole ply file"),
        (ply(["float x", "float y", "list uint char z"], 1, "binary_big_endian") + bytes(8) + b"\xff" * 4, "not a whole"),
    ],
)  # fmt: skip
def test_ply_that_lies(tmp_path, raw, what):
    (tmp_path / "a.ply").write_bytes(raw)
    with refused(what, r"a\.ply: ", CloudError):
        load_cloud(tmp_path / "a.ply", lambda text: None)


FILES = {
    "a.pcd": pcd(2) + b"1 2 3 12 5\n4 5 6 7 8\n",
    "b.pcd": pcd(2, "binary", fields="x y z intensity time", sizes="4 4 4 4 8", types="F F F F F") + bytes(48),
    "a.ply": ply(["float x", "double y", "int z", "float time"], 2, more="comment sensor \"a\"\n") + b"1 2 3 12\n4 5 6 7\n",
    "b.ply": ply(["float x", "float y", "float z"], 2, "binary_big_endian", "element face 1\nproperty list uchar int v\n")
    + bytes(24) + b"\x03" + bytes(12),
}  # fmt: skip


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(FILES)), st.lists(st.tuples(st.integers(0, 300), st.integers(0, 255)), max_size=4))
def test_any_damage_ends_well(tmp_path_factory, name, changes):
    path = tmp_path_factory.getbasetemp() / f"fuzz_{name}"
    raw = bytearray(FILES[name])
    for place, value in changes:
        raw[place % len(raw)] = value
    path.write_bytes(raw)
    with suppress(CloudError):
        loaded = load_cloud(path, lambda text: None)
        assert np.isfinite(loaded.xyz).all()
        assert (loaded.sensor < len(loaded.sensor_names)).all()
