"""How bright retro-reflectors are, against a recorded sensor; and why near-infrared light is not simulated."""

import numpy as np
import pytest

from lidarcfg.packets.ouster.encode import LIGHT
from tests.capture_fixtures import recording
from tests.packets.ouster.judge import judged


def test_light_of_retro_reflectors_is_that_of_a_recorded_os2():
    """Its medians of signal × range², as ouster-sdk reads them, over those of diffuse targets: within a factor of two."""
    path = recording("ouster/OS-2-128-U1_v2.3.0_1024x10.pcap")
    theirs = judged(path, path.with_suffix(".json"))
    range_m, gray, signal = (theirs.fields[key].astype(float) for key in ("range", "reflectivity", "signal"))
    there = (range_m > 2000) & (signal < 60000)
    light = (signal * (range_m / 1000) ** 2)[there]
    gray = gray[there].astype(int)
    diffuse = (gray > 10) & (gray <= 100)
    photons = np.median(light[diffuse] / gray[diffuse])
    for low, high in ((110, 130), (130, 150), (170, 190), (190, 210)):
        some = (gray > low) & (gray <= high)
        assert some.sum() > 50
        ratio = np.median(light[some]) / photons / np.median(LIGHT[gray[some]])
        assert 0.5 < ratio < 2
        assert np.median(light[some]) / photons / np.median(gray[some]) > 2  # a byte in per cent would say too little


def test_near_infrared_light_is_the_places():
    """Photons of a diffuse target's reflectivity differ by a factor of 500 among six recordings, so no scene says them."""
    medians = []
    for name in (
        "OS-0-32-U1_v2.2.0_1024x10",
        "OS-1-128_767798045_1024x10_20230712_120049",
        "OS-2-128-U1_v2.3.0_1024x10",
        "OS-2-32-U0_v2.0.0_1024x10",
        "crc_test",
        "same_ports_legacy",
    ):
        path = recording(f"ouster/{name}.pcap")
        beside = path.with_suffix(".1.json" if name == "same_ports_legacy" else ".json")
        fields = judged(path, beside).fields
        there = (fields["range"] > 0) & (fields["reflectivity"] > 5) & (fields["reflectivity"] <= 100)
        photons = fields["near_ir"][there] / fields["reflectivity"][there]
        low, median, high = np.percentile(photons, [25, 50, 75])
        assert median / 2 < low < high < median * 2
        medians.append(median)
    assert min(medians) == pytest.approx(0.4, abs=0.05)
    assert max(medians) == pytest.approx(204, abs=1)
