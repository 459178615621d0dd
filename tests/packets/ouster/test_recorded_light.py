"""How bright retro-reflectors are, against a recorded sensor."""

import numpy as np

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
