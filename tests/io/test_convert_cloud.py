"""Clouds through LAS, LAZ and KITTI: read by laspy, Open3D and numpy, and what is refused or told of."""

import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from fractions import Fraction

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laspy.header import GpsTimeType

from lidarcfg.clouds.cloud import FIELDS, PointCloud, load_cloud, save_clouds
from lidarcfg.clouds.las import gps_seconds, load_las, save_las, unix_ns
from lidarcfg.errors import CloudError, ConversionError
from lidarcfg.io.formats import INPUTS, choose_format, convert
from lidarcfg.io.kitti import load_kitti, save_kitti
from tests.capture_fixtures import no_warning
from tests.clouds.test_cloud import assert_same, cloud

UTM = (432_100.25, 5_412_345.75, 118.5)
EXACT = ("intensity", "ring", "sensor", "return_type")


def timed(count: int = 50, **changes) -> PointCloud:
    """A cloud of 2026, so that its times are such as captures have."""
    made = cloud(count)
    time_ns = 1_770_000_000_123_456_789 + np.random.default_rng(1).integers(0, 10**11, count)
    return replace(made, time_ns=time_ns, **changes)


def empty() -> PointCloud:
    return PointCloud.none(("left", "right"))


def converted(source, output, warnings=None, name=None) -> str:
    return convert(
        source,
        output,
        choose_format(source, output, name),
        None,
        None,
        no_warning if warnings is None else warnings.append,
    )


@pytest.mark.parametrize("suffix", ["las", "laz", "LAZ"])
@pytest.mark.parametrize("chunk", [7, 1 << 20])
def test_laspy_reads_what_the_format_says(tmp_path, suffix, chunk):
    ours = timed()
    ours = replace(ours, xyz=ours.xyz + UTM)
    path = tmp_path / f"a.{suffix}"
    save_las(path, ours, chunk)
    theirs = laspy.read(path)
    header = theirs.header
    assert (str(header.version), header.point_format.id, header.point_count) == ("1.4", 6, 50)
    assert header.are_points_compressed == (suffix.lower() == "laz")
    assert header.global_encoding.gps_time_type == GpsTimeType.STANDARD
    assert header.global_encoding.wkt
    assert abs(theirs.xyz - ours.xyz).max() <= 0.5e-4 + 1e-9
    assert (header.mins <= ours.xyz.min(axis=0) + 1e-4).all()
    assert (header.maxs >= ours.xyz.max(axis=0) - 1e-4).all()
    assert (theirs.intensity == ours.intensity.astype(int) * 65_536 // 256).all()
    assert (theirs.return_number == 1).all()
    assert (theirs.number_of_returns == 1).all()
    for key in ("ring", "sensor", "return_type"):
        assert theirs[key].dtype == FIELDS[key]
        assert (theirs[key] == getattr(ours, key)).all()
    # seconds since 1980-01-06 by the calendar, and 18 leap seconds since 2017, minus 1e9
    began_s = int(datetime(1980, 1, 6, tzinfo=UTC).timestamp())
    gps_s = [float(Fraction(time_ns, 10**9) - began_s + 18 - 10**9) for time_ns in ours.time_ns.tolist()]
    assert abs(theirs.gps_time - gps_s).max() <= np.spacing(4.5e8)
    assert header.creation_date.isoformat() == "2026-02-02"
    assert header.generating_software.startswith("lidarcfg 0.")


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_and_back(tmp_path, suffix):
    ours = timed()
    ours = replace(ours, xyz=ours.xyz + UTM, sensor_names=("left", 'odd "näme"\n'))
    save_las(tmp_path / f"a.{suffix}", ours)
    back = load_las(tmp_path / f"a.{suffix}", no_warning)
    assert back.sensor_names == ours.sensor_names
    for key in EXACT:
        np.testing.assert_array_equal(getattr(back, key), getattr(ours, key))
    assert abs(back.xyz - ours.xyz).max() <= 0.5e-4 + 1e-9
    assert abs(back.time_ns - ours.time_ns).max() <= 30
    save_las(tmp_path / f"b.{suffix}", back)  # what LAS holds, it holds for good
    again = load_las(tmp_path / f"b.{suffix}", no_warning)
    assert_same(replace(back, xyz=again.xyz), again)
    assert abs(again.xyz - back.xyz).max() < 2e-9


@pytest.mark.slow
@given(
    st.lists(st.tuples(*[st.floats(-2e5, 2e5)] * 3), min_size=1, max_size=20),
    st.tuples(*[st.floats(-1e8, 1e8)] * 3),
    st.integers(-(10**18), 9 * 10**18),
)
@settings(max_examples=40, deadline=None)
def test_las_anywhere(tmp_path_factory, points, origin, time_ns):
    path = tmp_path_factory.mktemp("las") / "a.las"
    ours = cloud(len(points))
    xyz = np.array(points) + origin
    ours = replace(ours, xyz=xyz, time_ns=np.full(len(points), time_ns))
    save_las(path, ours)
    back = load_las(path, no_warning)
    assert abs(back.xyz - xyz).max() <= 0.5e-4 + 1e-7  # float64 has 1.5e-8 there
    assert abs(back.time_ns - time_ns).max() <= 1000


@pytest.mark.parametrize(
    ("moment", "gps_s"),
    [  # as published: GPS time began; the second 10^9 of it; before and after leap seconds
        ("1980-01-06T00:00:00", 0),
        ("1981-06-30T23:59:59", 46828799),
        ("1981-07-01T00:00:00", 46828801),
        ("2000-01-01T00:00:00", 630720013),
        ("2011-09-14T01:46:25", 1000000000),
        ("2016-12-31T23:59:59", 1167264016),
        ("2017-01-01T00:00:00", 1167264018),
        ("2020-01-01T00:00:00", 1261872018),
    ],
)
def test_gps_time(moment, gps_s):
    time_ns = np.array([int(datetime.fromisoformat(moment).replace(tzinfo=UTC).timestamp()) * 10**9])
    assert gps_seconds(time_ns).tolist() == [gps_s - 1e9]
    assert unix_ns(gps_seconds(time_ns)).tolist() == time_ns.tolist()


@given(st.integers(-(2**63), 2**63 - 1))
@settings(max_examples=300)
def test_gps_time_and_back(time_ns):
    times = np.array([time_ns])
    gps_s = gps_seconds(times)
    off_ns = int(unix_ns(gps_s)[0]) - time_ns if abs(time_ns) < 2**62 else 0
    assert abs(off_ns) <= np.spacing(abs(gps_s[0])) / 2 * 1e9 + 1


def test_a_cloud_without_points(tmp_path):
    for suffix in ("las", "laz", "bin", "ply", "pcd", "npz"):
        save_clouds(tmp_path / "none.npz", [empty()])
        path = tmp_path / f"a.{suffix}"
        assert converted(tmp_path / "none.npz", path, []) == "0 points"
        warnings = []
        assert converted(path, tmp_path / "back.npz", warnings) == "0 points"
        with np.load(tmp_path / "back.npz") as arrays:
            assert arrays["xyz"].shape == (0, 3)
            assert arrays["sensor_names"].tolist() == (["a"] if suffix == "bin" else ["left", "right"])
    assert laspy.read(tmp_path / "a.laz").header.point_count == 0


def test_the_same_cloud_gives_the_same_bytes(tmp_path):
    for suffix in ("las", "laz", "bin"):
        for name in "ab":
            save_clouds(tmp_path / "c.npz", [timed()])
            converted(tmp_path / "c.npz", tmp_path / f"{name}.{suffix}", [])
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


@pytest.mark.slow
def test_every_way_between_clouds(tmp_path):
    """All formats hold positions and intensities; what is kept depends on the poorer of the two."""
    ours = timed()
    suffixes = INPUTS["cloud"]
    for first in suffixes:
        save_clouds(tmp_path / "c.npz", [ours])
        a = tmp_path / f"a{first}"
        converted(tmp_path / "c.npz", a, [])
        for second in suffixes:
            b = tmp_path / f"b{second}"
            assert converted(a, b, []) == "50 points"
            converted(b, tmp_path / "d.npz", [])
            back = load_cloud(tmp_path / "d.npz", print)
            kinds = {first, second}
            step = 1e-4 if kinds & {".las", ".laz", ".bin"} else 0
            assert abs(back.xyz - ours.xyz).max() <= step
            assert (back.intensity == ours.intensity).all()
            if ".bin" not in kinds:
                for key in EXACT:
                    np.testing.assert_array_equal(getattr(back, key), getattr(ours, key))
                assert abs(back.time_ns - ours.time_ns).max() <= (30 if kinds & {".las", ".laz"} else 0)
                assert back.sensor_names == ours.sensor_names


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_a_full_disk_is_one_line(tmp_path, suffix):
    """As the system has it: no file may grow beyond a size. lazrs raises an error of its own for that."""
    save_clouds(tmp_path / "a.ply", [timed(5000)])
    code = (
        "import resource, signal, sys; from lidarcfg.cli.main import main\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
        f"sys.argv = ['lidarcfg', 'convert', 'a.ply', '-o', 'a.{suffix}']\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"a.{suffix}" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply"]


def test_open3d_reads_what_came_from_laz(tmp_path):
    import open3d as o3d

    ours = timed()
    save_las(tmp_path / "a.laz", ours)
    converted(tmp_path / "a.laz", tmp_path / "a.pcd")
    theirs = o3d.t.io.read_point_cloud(str(tmp_path / "a.pcd")).point
    assert abs(theirs["positions"].numpy() - ours.xyz).max() <= 1e-4
    for key in EXACT:
        assert (theirs[key].numpy().ravel() == getattr(ours, key)).all()
    assert abs(theirs["time_ns"].numpy().ravel() - ours.time_ns).max() <= 30


@pytest.mark.parametrize("chunk", [7, 1 << 20])
def test_kitti_is_four_floats_a_point(tmp_path, chunk):
    ours = timed()
    save_kitti(tmp_path / "a.bin", ours, no_warning, chunk)
    rows = np.fromfile(tmp_path / "a.bin", np.float32).reshape(-1, 4)  # as KITTI's readme and pykitti do
    np.testing.assert_array_equal(rows[:, :3], ours.xyz.astype(np.float32))
    np.testing.assert_allclose(rows[:, 3], ours.intensity / 255, rtol=1e-7)
    assert rows[:, 3].max() <= 1
    back = load_kitti(tmp_path / "a.bin", lambda warning: None)
    np.testing.assert_array_equal(back.xyz, rows[:, :3].astype(np.float64))
    np.testing.assert_array_equal(back.intensity, ours.intensity)
    assert back.sensor_names == ("a",)
    for key in ("ring", "time_ns", "sensor", "return_type"):
        assert not getattr(back, key).any()


def test_what_kitti_cannot_hold_is_said(tmp_path):
    warnings = []
    save_clouds(tmp_path / "c.npz", [timed(xyz=np.full((50, 3), UTM))])
    converted(tmp_path / "c.npz", tmp_path / "c.bin", warnings)
    off_m = abs(float(np.float32(UTM[1])) - UTM[1])
    assert warnings == [
        f"{tmp_path}/c.bin: kitti has no ring, time, sensor or return type",
        f"{tmp_path}/c.bin: float32 moves a point by up to {off_m:.2g} m",
    ]


def foreign_las(path, point_format=1, version="1.2", count=20, **columns):
    """A file as others write it: no names, no extra dimensions."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales = [0.01, 0.01, 0.01]
    data = laspy.LasData(header)
    data.x = data.y = data.z = np.arange(count) / 4
    data.intensity = np.arange(count) * 256 + columns.pop("offset", 0)
    for key, values in columns.items():
        data[key] = values
    data.write(path)


def test_a_las_of_others(tmp_path):
    path = tmp_path / "survey.las"
    warnings = []
    foreign_las(path, gps_time=np.arange(20) + 0.5)
    back = load_las(path, warnings.append)
    assert back.xyz[7].tolist() == [1.75, 1.75, 1.75]
    assert back.intensity.tolist() == list(range(20))
    assert back.time_ns[3] == 3_500_000_000
    assert back.sensor_names == ("0",)
    assert warnings == [
        f"{path}: has no ring, sensor, return_type; 0 is assumed",
        f"{path}: its times are of a week that it does not name; 0 is the week's beginning",
    ]
    warnings.clear()
    foreign_las(path, point_format=2, offset=3)  # with colours, without times
    assert load_las(path, warnings.append).intensity.tolist() == list(range(20))
    assert warnings == [
        f"{path}: has no time_ns, ring, sensor, return_type; 0 is assumed",
        f"{path}: intensities of 16 bits are rounded down to 8",
    ]
    foreign_las(path, gps_time=np.full(20, np.nan))
    with pytest.raises(CloudError, match="allowed for gps_time are seconds below 9e"):
        load_las(path, no_warning)


def test_a_chunk_table_that_lies(tmp_path):
    """lazrs would allocate memory for each chunk that is announced, and end the process where there is none."""
    save_las(tmp_path / "a.laz", timed())
    raw = bytearray((tmp_path / "a.laz").read_bytes())
    points_at = int.from_bytes(raw[96:100], "little")
    table_at = int.from_bytes(raw[points_at : points_at + 8], "little")
    assert raw[table_at : table_at + 8] == b"\0\0\0\0\1\0\0\0"  # version, chunks
    raw[table_at + 4 : table_at + 8] = b"\xff" * 4
    (tmp_path / "a.laz").write_bytes(raw)
    with pytest.raises(CloudError, match="4294967295 chunks are announced but missing"):
        load_las(tmp_path / "a.laz", no_warning)
    raw[points_at : points_at + 8] = b"\xff" * 7 + b"\x7f"
    (tmp_path / "a.laz").write_bytes(raw)
    with pytest.raises(CloudError, match="not a whole laz file: "):
        load_las(tmp_path / "a.laz", no_warning)


@pytest.mark.parametrize(("at", "value"), [(32, 0), (32, 999), (36, 29), (42, 6)])
def test_laszip_items_that_lie(tmp_path, at, value):
    """The number of items, and their sizes: where they do not make up a point, lazrs would panic."""
    save_las(tmp_path / "a.laz", timed())
    raw = bytearray((tmp_path / "a.laz").read_bytes())
    data = raw.index(b"laszip encoded") - 2 + 54
    assert raw[data + 32 : data + 44] == b"\2\0" + b"\x0a\0\x1e\0\3\0" + b"\x0e\0\4\0"  # 30 and 4 bytes
    raw[data + at : data + at + 2] = value.to_bytes(2, "little")
    (tmp_path / "a.laz").write_bytes(raw)
    with pytest.raises(CloudError, match=r"not a whole laz file: (its LASzip items|it has no byte)"):
        load_las(tmp_path / "a.laz", no_warning)


def test_far_too_wide_for_las(tmp_path):
    wide = timed(2, xyz=np.array([[0, 0, 0], [0, 5e5, 0]]))
    with pytest.raises(CloudError, match=r"a\.las: the cloud is 500000 m wide; LAS in steps of 0\.1 mm has 429496"):
        save_las(tmp_path / "a.las", wide)
    many = timed(2, sensor_names=("x" * 70_000, "y"))
    with pytest.raises(CloudError, match="the sensors' names take 70009 bytes; a LAS file has 65535 for them"):
        save_las(tmp_path / "a.las", many)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(tmp_path, value):
    bad = timed()
    bad.xyz[3, 1] = value
    for save, name in ((save_las, "a.las"), (lambda *both: save_kitti(*both, no_warning), "a.bin")):
        with pytest.raises(CloudError, match=f"{name}: a point is not finite"):
            save(tmp_path / name, bad)
    assert list(tmp_path.iterdir()) == []
    rows = np.zeros((5, 4), np.float32)
    rows[2, 0] = value
    rows.tofile(tmp_path / "b.bin")
    with pytest.raises(CloudError, match=r"b\.bin: point 2 is not finite"):
        load_kitti(tmp_path / "b.bin", lambda warning: None)
    rows[2] = 0, 0, 0, value
    rows.tofile(tmp_path / "b.bin")
    with pytest.raises(CloudError, match=r"b\.bin: point 2: reflectance is .*; allowed: 0 to 1"):
        load_kitti(tmp_path / "b.bin", lambda warning: None)


def test_odd_kitti_files(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes(50))
    with pytest.raises(CloudError, match=r"a\.bin: not a whole KITTI file: 50 bytes are not points of 16"):
        load_kitti(tmp_path / "a.bin", lambda warning: None)
    (tmp_path / "x.pcd.bin").write_bytes(bytes(80))
    with pytest.raises(CloudError, match="is a nuScenes file, with five numbers a point"):
        load_kitti(tmp_path / "x.pcd.bin", lambda warning: None)
    with pytest.raises(CloudError, match=r"none\.bin: no such file"):
        load_kitti(tmp_path / "none.bin", lambda warning: None)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_odd_las_files(tmp_path, suffix):
    path = tmp_path / f"a.{suffix}"
    with pytest.raises(CloudError, match=f"a.{suffix}: no such file"):
        load_las(path, no_warning)
    save_las(path, timed())
    raw = path.read_bytes()
    rng = np.random.default_rng(0)
    cases = [b"", b"LASF", b"hello" * 100, raw[:100], raw[:400], raw[: len(raw) // 2], raw[:-5]]
    for _ in range(150):
        odd = bytearray(raw)
        for at in rng.integers(0, len(odd) if rng.random() < 0.3 else 375, 3):
            odd[at] = rng.integers(0, 256)
        cases.append(bytes(odd))
    refused = []
    for case in cases:
        path.write_bytes(case)
        try:
            found = load_las(path, lambda warning: None)
        except CloudError as error:
            refused.append(str(error))
        else:
            assert np.isfinite(found.xyz).all()
    assert len(refused) > 20
    assert all(what.startswith(str(path)) and "\n" not in what for what in refused)


def test_without_the_libraries(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    for call in (lambda: save_las(tmp_path / "a.las", timed()), lambda: load_las(tmp_path / "a.las", no_warning)):
        with pytest.raises(
            ConversionError, match=r"laspy\[lazrs\] is not installed; pip install 'lidarcfg\[convert\]'"
        ):
            call()
