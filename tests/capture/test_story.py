"""The page "How it works" shows decoding as code; that code, as it is written, gives the points of `lidarcfg.decode`."""

import re
from pathlib import Path

import numpy as np

import lidarcfg
from lidarcfg.clouds.cloud import FIELDS
from tests.capture_fixtures import STREET, tilted_rig

PAGE = Path(__file__).parents[2] / "docs" / "how-it-works.md"


def test_the_story_on_the_page_is_decode(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rig = "data/rigs/roof.yaml"
    lidarcfg.save_rig(tilted_rig(), rig)
    lidarcfg.export(rig, STREET, "out/street.pcap", 0.05)
    story = PAGE.read_text().split("## From a capture to a cloud")[1]
    code = re.search(r"^```python\n(.*?)^```$", story, re.DOTALL | re.MULTILINE)[1]
    names = {}
    exec(code, names)
    expected = lidarcfg.decode("out/street.pcap", rig)
    assert len(expected.xyz) > 10_000
    assert names["cloud"].sensor_names == expected.sensor_names == ("lidar_0", "lidar_1")
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(names["cloud"], field), getattr(expected, field), field)
