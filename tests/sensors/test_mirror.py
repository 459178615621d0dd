"""A mirror's file of angles and its key: what is not allowed is told with file, line and key."""

import shutil
from hashlib import sha256

import pytest
import yaml

from lidarcfg.errors import ConfigError
from lidarcfg.sensors.mirror import parse_mirror_angles
from lidarcfg.sensors.sensor import catalogue, load_sensor


def changed(folder, model, change):
    """The model's file with its scan pattern changed, and its angles beside it."""
    path = catalogue()[model]
    shutil.copy(path.with_suffix(".dat"), folder)
    values = yaml.safe_load(path.read_text())
    change(values["scan_pattern"])
    out = folder / "own.yaml"
    out.write_text(yaml.safe_dump(values))
    return out


CASES = [
    ("at128e2x", lambda p: p.pop("mirror"), "scan_pattern.mirror: missing; a .dat has a mirror's angles"),
    ("at128e2x", lambda p: p.update(file="own.csv"), "scan_pattern.mirror: needs a .dat, which has its angles"),
    ("at128e2x", lambda p: p["mirror"].update(rpm=201), "201 rpm are no 3 frames of 100 ms"),
    ("at128e2x", lambda p: p["mirror"].update(columns_per_facet=2400), "some columns are beyond their facet"),
    ("atx", lambda p: p["mirror"].update(columns_per_facet=1502), "some columns are beyond their facet"),
    ("at128e2x", lambda p: p["mirror"].update(offset_ns=[[0] * 127]), "of 128 lasers, which the angles are of"),
    ("atx", lambda p: p["mirror"].update(offset_ns=[[0] * 100] * 3), "is not one for all facets, or 2, of 100 lasers"),
    ("atx", lambda p: p["mirror"].update(offset_ns=[[0] * 100, [0] * 99]), "has 99 values; allowed: 100, as the first"),
    ("atx", lambda p: p["mirror"]["offset_ns"][0].__setitem__(3, 66_667), "beyond the column's 66667 ns"),
    ("atx", lambda p: p.update(file="other.dat"), "other.dat: no such file"),
]


@pytest.mark.parametrize(("model", "change", "said"), CASES)
def test_what_a_mirror_may_not_be(model, change, said, tmp_path):
    path = changed(tmp_path, model, change)
    with pytest.raises(ConfigError) as raised:
        load_sensor(path)
    assert said in str(raised.value)
    assert str(raised.value).startswith(f"{path}:")


def test_files_that_hold_no_angles():
    """Each has its own checksum right, so that what it says is what is refused."""
    content = catalogue()["at128e2x"].with_suffix(".dat").read_bytes()[:-32]
    atx = catalogue()["atx"].with_suffix(".dat").read_bytes()[:-32]
    for body, said in (
        (b"\xee\xff\x01\x05\x00" + content[5:], "0 lasers"),
        (content[:15] + b"\0" + content[16:], "angles in 0 units"),
        (content[:16] + b"\xff\xff\xff\xff" + content[20:], "a facet is beyond 360 degrees"),
        (content[:40] + b"\x00\x00\x00\x80" + content[44:], "an angle is beyond 360 degrees"),
        (content + b"\0", "47,177 bytes"),
        (atx[:7] + b"\0\0" + atx[9:], "angles in 0 units"),
        (atx[:3] + b"\3" + atx[4:], "version 4.3"),
    ):
        with pytest.raises(ConfigError, match=said):
            parse_mirror_angles("a.dat", body + sha256(body).digest())
