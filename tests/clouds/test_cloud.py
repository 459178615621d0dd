"""Clouds: exact through all three kinds of file, readable by Open3D and numpy, and what is refused."""

import io
import json
import weakref
import zipfile
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarcfg.clouds.cloud import FIELDS, PointCloud, concatenate, gather, load_cloud, save_clouds
from lidarcfg.errors import CloudError
from tests.refusals import refused


def no_warning(text: str) -> None:
    raise AssertionError(text)


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
    assert_same(load_cloud(path, no_warning), concatenate(parts))
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
def test_no_more_than_a_cloud_is_held(tmp_path, suffix):
    """Of many clouds those that are written have gone: by weak references to them."""
    seen: list[weakref.ref[PointCloud]] = []

    def clouds():
        for seed in range(6):
            assert sum(one() is not None for one in seen) <= 1
            some = cloud(20, seed=seed)
            seen.append(weakref.ref(some))
            yield some
            del some

    assert save_clouds(tmp_path / f"a.{suffix}", clouds()) == 120


@pytest.mark.parametrize("points", [0, 1, 149, 150, 1000])
def test_gathering_fills_one_cloud_whatever_room_is_foreseen(points):
    parts = [cloud(50, seed=0), cloud(0), cloud(70, ("right", "rear"), seed=1), cloud(30, seed=2)]
    whole = gather(iter(parts), points)
    assert whole.sensor_names == ("left", "right", "rear")
    for key in FIELDS:
        if key != "sensor":
            np.testing.assert_array_equal(getattr(whole, key), np.concatenate([getattr(part, key) for part in parts]))
    names = [part.sensor_names[one] for part in parts for one in part.sensor.tolist()]
    assert [whole.sensor_names[one] for one in whole.sensor.tolist()] == names


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
        seconds = theirs["time_s"].numpy().ravel()
        rest = theirs["time_rest_ns"].numpy().ravel()
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
        load_cloud(tmp_path / "a.xyz", no_warning)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
@pytest.mark.parametrize(
    "raw", [b"", b"hello", b"\xff\xfe" * 500, b"ply\nformat ascii 1.0\nend_header\n", b"DATA ascii\n"]
)
def test_not_a_cloud(tmp_path, suffix, raw):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(raw)
    with refused(f"a.{suffix}: ", kind=CloudError):
        load_cloud(path, no_warning)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
def test_cut(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    save_clouds(path, [cloud()])
    raw = path.read_bytes()
    for size in (10, 100, 300, len(raw) - 5):
        path.write_bytes(raw[:size])
        with pytest.raises(CloudError):
            load_cloud(path, no_warning)


@pytest.mark.parametrize("suffix", ["ply", "pcd", "npz"])
def test_empty_and_not_finite(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    save_clouds(path, [cloud(0)])
    with pytest.raises(CloudError, match="the cloud is empty"):
        load_cloud(path, no_warning)
    bad = cloud()
    bad.xyz[3, 1] = np.nan
    save_clouds(path, [bad])
    with pytest.raises(CloudError, match="point 3 is not finite"):
        load_cloud(path, no_warning)


def test_missing_fields(tmp_path):
    np.savez(tmp_path / "a.npz", xyz=np.zeros((3, 3)))
    with pytest.raises(CloudError, match="missing: intensity, ring, time_ns, sensor, return_type, sensor_names"):
        load_cloud(tmp_path / "a.npz", no_warning)


def test_a_lacking_field_is_zero_and_said(tmp_path):
    save_clouds(tmp_path / "a.ply", [cloud()])
    raw = (tmp_path / "a.ply").read_bytes().replace(b"uchar ring", b"uchar rong")
    (tmp_path / "a.ply").write_bytes(raw)
    told = []
    found = load_cloud(tmp_path / "a.ply", told.append)
    assert told == [f"{tmp_path}/a.ply: has no ring; 0 is assumed; rong ignored"]
    assert_same(found, PointCloud(**vars(cloud()) | {"ring": np.zeros(50, np.uint8)}))


def test_sensor_without_a_name(tmp_path):
    save_clouds(tmp_path / "a.pcd", [cloud()])
    raw = (tmp_path / "a.pcd").read_bytes().replace(f"# sensor {json.dumps('right')}\n".encode(), b"")
    (tmp_path / "a.pcd").write_bytes(raw)
    with pytest.raises(CloudError, match="a point is of sensor 1; there are 1"):
        load_cloud(tmp_path / "a.pcd", no_warning)


def test_no_such_file_and_no_folder(tmp_path):
    for suffix in ("ply", "pcd", "npz"):
        with pytest.raises(CloudError, match="no such file"):
            load_cloud(tmp_path / f"none.{suffix}", no_warning)
        (tmp_path / "file").touch()
        with pytest.raises(CloudError, match="not a directory"):
            save_clouds(tmp_path / "file" / f"a.{suffix}", [cloud()])
        save_clouds(tmp_path / "new" / f"a.{suffix}", [cloud()])
        assert len(load_cloud(tmp_path / "new" / f"a.{suffix}", no_warning).xyz) == len(cloud().xyz)


def columns(**other) -> dict[str, object]:
    """A sound cloud's arrays, with others in their place."""
    ours = cloud(5)
    return {key: getattr(ours, key) for key in FIELDS} | {"sensor_names": np.array(ours.sensor_names)} | other


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"xyz": np.array([["a", "b", "c"]] * 5)}, "xyz is of type <U1; allowed: floats"),
        ({"xyz": np.array(1.0)}, "the fields differ in length"),
        ({"xyz": np.zeros(5)}, "the fields differ in length"),
        ({"xyz": np.zeros((5, 4))}, "the fields differ in length"),
        ({"xyz": np.zeros((5, 3), complex)}, "xyz is of type complex128; allowed: floats"),
        ({"xyz": np.zeros((5, 3), int)}, "xyz is of type int64; allowed: floats"),
        ({"xyz": np.full((5, 3), 1e308)}, "point 0 is beyond 1e+09 m"),
        ({"xyz": np.full((5, 3), np.inf, np.float16)}, "point 0 is not finite"),
        ({"xyz": np.frombuffer(b"\x01\x00\x80\x7f" * 15, "<f4").reshape(5, 3)}, "point 0 is not finite"),
        ({"intensity": np.array([1, 2, 3, 300, 5])}, "point 3: intensity is 300; allowed: 0 to 255"),
        ({"intensity": np.full(5, np.nan)}, "intensity is of type float64; allowed: integers"),
        ({"ring": np.array([1, 2, 3, 4, 5] * 2, np.uint8)}, "the fields differ in length"),
        ({"ring": np.ones(5, bool)}, "ring is of type bool; allowed: integers"),
        ({"time_ns": np.array(["now"] * 5)}, "time_ns is of type <U3; allowed: integers"),
        ({"time_ns": np.full(5, 1e300)}, "time_ns is of type float64; allowed: integers"),
        ({"time_ns": np.full(5, 2**63, np.uint64)}, "point 0: time_ns is 9223372036854775808; allowed: -92233720"),
        ({"sensor": np.array(["left"] * 5)}, "sensor is of type <U4; allowed: integers"),
        ({"sensor": np.full(5, np.nan)}, "sensor is of type float64; allowed: integers"),
        ({"sensor": np.array([0, 0, -1, 0, 0])}, "point 2: sensor is -1; allowed: 0 to 65535"),
        ({"sensor": np.full(5, 2)}, "a point is of sensor 2; there are 2"),
        ({"sensor_names": np.array("left")}, "sensor_names holds something other than a list of texts"),
        ({"sensor_names": np.array([b"left", b"right"])}, "sensor_names holds something other than a list of texts"),
        ({"sensor_names": np.array([["left", "right"]])}, "sensor_names holds something other than a list of texts"),
        ({"sensor_names": np.array(["left", "\ud800"])}, r"the sensor name '\ud800' is not Unicode text"),
        ({"return_type": np.array([object()] * 5)}, "not a whole npz file: Object arrays cannot be loaded"),
    ],
)
def test_columns_that_no_cloud_holds(tmp_path, other, message):
    np.savez(tmp_path / "a.npz", **columns(**other))
    with refused(message, r"a\.npz: ", CloudError):
        load_cloud(tmp_path / "a.npz", no_warning)


def test_other_integers_and_floats_are_taken(tmp_path):
    ours = cloud(5)
    wide = {key: getattr(ours, key).astype(">i8") for key in FIELDS if key != "xyz"}
    np.savez(tmp_path / "a.npz", **columns(**wide, xyz=ours.xyz.astype(np.float16), more=np.array([object()])))
    assert_same(
        load_cloud(tmp_path / "a.npz", no_warning),
        PointCloud(**vars(ours) | {"xyz": np.float64(ours.xyz.astype(np.float16))}),
    )


def repacked(raw: bytes, compression: int = zipfile.ZIP_STORED, **members: bytes) -> bytes:
    """The archive with some of its members replaced."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(raw)) as old, zipfile.ZipFile(out, "w", compression) as new:
        for name in old.namelist():
            new.writestr(name, members.get(name.removesuffix(".npy"), old.read(name)))
    return out.getvalue()


def npy(descr: str, shape: str) -> bytes:
    """A .npy file that announces what it does not hold."""
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(40)


@pytest.mark.parametrize(
    "ring",
    [
        b"text",
        npy("<f8", "(99999999999999,)"),
        npy("<f8", "(" + "9" * 40 + ",)"),
        npy("<f8", "(-1,)"),
        npy("<f8", "(5"),
        npy("(5,", "(5,)"),
    ],
)
def test_an_array_that_lies(tmp_path, ring):
    save_clouds(tmp_path / "a.npz", [cloud()])
    (tmp_path / "a.npz").write_bytes(repacked((tmp_path / "a.npz").read_bytes(), ring=ring))
    with pytest.raises(CloudError, match=r"a\.npz: "):
        load_cloud(tmp_path / "a.npz", no_warning)


@pytest.mark.slow
@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_damaged_archives(tmp_path, compression):
    """Every byte of the first member turned, and the versions and flags of all."""
    save_clouds(tmp_path / "a.npz", [cloud(5)])
    raw = repacked((tmp_path / "a.npz").read_bytes(), compression)
    (tmp_path / "a.npz").write_bytes(raw)
    assert_same(load_cloud(tmp_path / "a.npz", no_warning), cloud(5))
    central = raw.index(b"PK\x01\x02")
    for i in (*range(4, 200), *range(central, central + 46)):
        (tmp_path / "a.npz").write_bytes(raw[:i] + bytes([raw[i] ^ 0xFF]) + raw[i + 1 :])
        with suppress(CloudError):
            load_cloud(tmp_path / "a.npz", no_warning)


def test_npy_is_not_npz(tmp_path):
    with open(tmp_path / "a.npz", "wb") as file:
        np.save(file, np.zeros((5, 3)))
    with pytest.raises(CloudError, match="not a whole npz file: allowed is an archive of arrays"):
        load_cloud(tmp_path / "a.npz", no_warning)


@pytest.mark.parametrize(
    ("suffix", "old", "new", "message"),
    [
        (
            "ply",
            b"vertex 50",
            b"vertex 99999999999999",
            "not a whole ply file: element 'vertex': row 50: early end-of-file",
        ),
        ("ply", b"vertex 50", b"vertex 1" + b"0" * 30, "not a whole ply file: "),
        ("ply", b"vertex 50", b"vertex -1", "not a whole ply file: "),
        ("ply", b"element vertex 50", b"element vertices 50", "it has no element vertex"),
        ("ply", b"double x", b"double w", "missing: x"),
        ("ply", b"uchar intensity", b"char intensity", ": intensity is -"),
        ("ply", b"int time_rest_ns", b"float time_rest_ns", "allowed for time_rest_ns are the integers 0 to 999999999"),
        ("ply", b'"left"', b"left", "the sensors' names are not JSON"),
        ("ply", b'"left"', b"5", "sensor_names holds something other than a list of texts"),
        ("ply", b'"left"', b'"\\ud800"', r"the sensor name '\ud800' is not Unicode text"),
        ("pcd", b"POINTS 50", b"POINTS 99999999999999", "not a whole pcd file, or more than memory holds: "),
        ("pcd", b"POINTS 50", b"POINTS 1" + b"0" * 30, "not a whole pcd file: "),
        ("pcd", b"POINTS 50", b"POINTS 51", "51 points are announced, 50 are there"),
        ("pcd", b"POINTS 50", b"POINTS -1", "not a whole pcd file: 1 validation error"),
        ("pcd", b"COUNT 1 1", b"COUNT 1 7", "not a whole pcd file: "),
        ("pcd", b"COUNT 1 1", b"COUNT 1 99999999", "a point has 100000006 values; allowed: up to 1000"),
        ("pcd", b"TYPE F F F U", b"TYPE F F F S", "not a whole pcd file: 1 validation error"),
        ("pcd", b"TYPE F F F", b"TYPE I I I", "is beyond 1e+09 m"),
        ("pcd", b"TYPE F F F", b"TYPE F F", "not a whole pcd file: "),
        ("pcd", b"POINTS 50\n", b"", "not a whole pcd file: 1 validation error"),
    ],
)
def test_headers_that_lie(tmp_path, suffix, old, new, message):
    path = tmp_path / f"a.{suffix}"
    save_clouds(path, [cloud()])
    raw = path.read_bytes()
    assert old in raw
    path.write_bytes(raw.replace(old, new, 1))
    with refused(message, rf"a\.{suffix}: ", CloudError):
        load_cloud(path, no_warning)


@pytest.mark.parametrize("time_s", [1e300, np.nan, np.inf, 0.5, -1e10])
def test_ply_times_that_are_none(tmp_path, time_s):
    save_clouds(tmp_path / "a.ply", [cloud()])
    raw = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(raw[:-12] + np.float64(time_s).tobytes() + raw[-4:])
    with pytest.raises(CloudError, match="allowed for time_s are whole numbers below 9223372036"):
        load_cloud(tmp_path / "a.ply", no_warning)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(["ply", "pcd", "npz"]), st.lists(st.tuples(st.integers(0, 700), st.integers(0, 255)), max_size=4)
)
def test_any_damage_ends_well(tmp_path_factory, suffix, changes):
    path = tmp_path_factory.getbasetemp() / f"fuzz.{suffix}"
    save_clouds(path, [cloud(3)])
    raw = bytearray(path.read_bytes())
    for place, value in changes:
        raw[place % len(raw)] = value
    path.write_bytes(raw)
    with suppress(CloudError):
        loaded = load_cloud(path, lambda text: None)
        assert np.isfinite(loaded.xyz).all()
        assert (loaded.sensor < len(loaded.sensor_names)).all()
