"""Echoes, noise, losses and weather: by hand, by statistics, and against the sources' own figures."""

import numpy as np
import pytest
from scipy import stats

from lidarcfg.core import simulate
from lidarcfg.sensors.realism import Realism
from lidarcfg.sensors.sensor import load_sensor
from lidarcfg.simulate.echoes import (
    CANDIDATES,
    REPORTED,
    add_noise,
    apply_dropout,
    beam_rays,
    extinction_per_m,
    thin_beam_echoes,
    uniforms,
    wide_beam_echoes,
)
from lidarcfg.world.scene_file import Weather
from tests.capture_fixtures import scene

VLP16 = load_sensor("vlp-16")
EDGE = np.array([1, 4, 1]) / 6  # weights of three sub-rays side by side


def made(
    range_m, reflectivity, weights=(1.0,), cosine=1.0, first=0, weather=None, objects=0, which=CANDIDATES, **realism
):
    """The echoes of firings (N, K), with their noise."""
    range_m = np.array(range_m, np.float64)
    rays = simulate.SubRays(
        range_m,
        np.broadcast_to(np.array(reflectivity, np.uint8), range_m.shape).copy(),
        np.broadcast_to(np.array(objects, np.int32), range_m.shape).copy(),
        np.broadcast_to(np.float64(cosine), range_m.shape).copy(),
        np.arange(len(range_m), dtype=np.uint8) % 2,
    )
    realism = Realism(**realism)
    found = wide_beam_echoes(VLP16, realism, weather or Weather(), 0, first, np.array(weights), rays, which)
    apply_dropout(found, realism, 0, first)
    add_noise(found, realism, 0, first)
    return found


def flat(range_m, count):
    return np.full((count, 1), float(range_m))


def test_an_edge_gives_two_echoes():
    """A sixth of the beam hits 20 m, the rest 10 m; then one sub-ray goes by; then the far one is the brighter."""
    found = made([[10, 10, 20], [10, 10, np.inf]], [30, 30, 90], EDGE, objects=[1, 1, 2])
    assert found.range_m.tolist() == [[10, 10, 20, 10, 20, 20], [10, 10, 10, 10, 10, 10]]
    assert found.reflectivity.tolist() == [[25, 25, 15, 25, 15, 15], [25, 25, 25, 25, 25, 25]]
    assert found.object.tolist() == [[1, 1, 2, 1, 2, 2], [1, 1, 1, 1, 1, 1]]
    found = made([[10, 20, 20]], [[2, 90, 90]], EDGE)
    assert found.range_m.tolist() == [[20, 10, 20, 10, 20, 10]]  # the strongest is the last: the next comes beside it
    for mode, expected in (
        ("strongest", [20]),
        ("last", [20]),
        ("first", [10]),
        ("dual", [10, 20]),
        ("first-last", [10, 20]),
        ("first-strongest", [10, 20]),
        ("two-strongest", [20, 10]),
    ):
        assert made([[10, 20, 20]], [[2, 90, 90]], EDGE, which=REPORTED[mode]).range_m.tolist() == [expected]


def test_a_mixed_pixel():
    """Half a metre apart the echoes run into one, at the mean that power weighs: light over range squared."""
    found = made([[10, 10, 10.5]], [60], EDGE)
    near, far = 5 / 6 / 10**2, 1 / 6 / 10.5**2
    assert found.range_m[0] == pytest.approx([(10 * near + 10.5 * far) / (near + far)] * 6)
    assert found.reflectivity.tolist() == [[60, 60, 60, 60, 60, 60]]


def test_three_echoes():
    found = made([[30, 10, 20]], [90, 10, 20], (1 / 3, 1 / 3, 1 / 3))
    assert found.range_m.tolist() == [[10, 10, 30, 10, 30, 30]]  # 10/100 beats 20/400 and 90/900
    found = made([[30, 10, 20]], [95, 10, 20], (1 / 3, 1 / 3, 1 / 3))
    np.testing.assert_allclose(found.range_m, [[30, 10, 30, 10, 30, 10]])


@pytest.mark.parametrize(("reflectivity", "cosine"), [(10, 1.0), (40, 1.0), (40, 0.25), (5, 0.5), (160, 0.1)])
def test_range_by_reflectivity_and_incidence(reflectivity, cosine):
    """P ~ ρ cos θ / r²: ten per cent head on is seen to 20 m, all else to 20 m times sqrt(10 ρ cos θ)."""
    albedo = reflectivity / 100 * (cosine if reflectivity <= 100 else 1)
    most_m = 20 * np.sqrt(10 * albedo)
    found = made([[0.999 * most_m], [1.001 * most_m]], reflectivity, cosine=cosine, range_10_percent_m=20.0)
    assert np.isfinite(found.range_m[:, 0]).tolist() == [True, False]


def test_what_is_black_stays_without_a_budget():
    assert made([[10]], 0, dropout_fraction=0.0).range_m.tolist() == [[10] * 6]


def test_noise_is_normal():
    found = made(flat(10, 20_000), 50, range_noise_m=0.02, seed=4)
    assert (found.range_m == 10).all()
    assert stats.kstest(found.noise_m[:, 0], "norm", (0, 0.02)).pvalue > 0.01
    assert (found.noise_m[:, :1] == found.noise_m).all()  # one echo has one error
    two = made(np.tile([[10.0, 10, 20]], (20_000, 1)), 30, EDGE, range_noise_m=0.02, seed=4)
    assert abs(np.corrcoef(two.noise_m[:, 0], two.noise_m[:, 2])[0, 1]) < 0.03


def test_dropouts_are_binomial():
    lost = (~np.isfinite(made(flat(10, 20_000), 50, dropout_fraction=0.1, seed=9).range_m[:, 0])).sum()
    assert stats.binomtest(int(lost), 20_000, 0.1).pvalue > 0.01


def test_the_seed_and_the_firing_decide():
    """Whatever the pieces; another seed or sensor gives other numbers."""
    whole = made(flat(10, 64), 50, range_noise_m=0.1, seed=2).noise_m
    parts = [made(flat(10, 16), 50, range_noise_m=0.1, seed=2, first=n).noise_m for n in range(0, 64, 16)]
    assert (whole == np.concatenate(parts)).all()
    assert not (whole == made(flat(10, 64), 50, range_noise_m=0.1, seed=3).noise_m).any()
    one, other = (uniforms(Realism(seed=2), sensor, 1, 0, 64) for sensor in (0, 1))
    assert not (one == other).any()
    assert ((one > 0) & (one < 1)).all()


def test_extinction_is_what_the_sources_say():
    """Visibility leaves two per cent of the light; ITU-R's formula gives 25 mm/h of rain 9.30 dB/km."""
    assert np.exp(-200 * extinction_per_m(Weather(fog_visibility_m=200))) == pytest.approx(0.02, rel=1e-3)
    decibel = 10 * np.log10(np.exp(1000 * extinction_per_m(Weather(rain_mm_h=25))))
    assert decibel == pytest.approx(1.076 * 8.6419, rel=1e-4)
    assert extinction_per_m(Weather()) == 0


def test_fog_hides_and_shines():
    """A target of 50 per cent is lost where 0.5 exp(-2 α r) / r² falls below 0.1 / 100²; fog is seen near by."""
    fog = Weather(fog_visibility_m=60)
    alpha = 3.912 / 60
    reach = np.linspace(1, 100, 100_000)
    most_m = reach[0.5 * np.exp(-2 * alpha * reach) / reach**2 >= 0.1 / 100**2].max()
    ranges = np.repeat([[most_m - 0.1], [most_m + 0.1]], 2000, axis=0)
    found = made(ranges, 50, weather=fog, seed=1)
    target = found.range_m == ranges
    assert target[:2000, 2].all()  # as the last return
    assert not target[2000:].any()
    cloudy = np.isfinite(found.range_m[2000:, 0])
    assert cloudy.mean() > 0.9
    assert np.median(found.range_m[2000:, 0][cloudy]) < 3
    assert (found.object[2000:][cloudy] == -1).all()
    light_rain = made(flat(20, 4000), 50, weather=Weather(rain_mm_h=2), seed=1)
    assert (light_rain.range_m[:, 0] == 20).mean() > 0.99


def test_no_hit_is_no_echo():
    for options in ({}, {"range_noise_m": 0.1}, {"dropout_fraction": 0.5}, {"range_10_percent_m": 5.0}):
        assert np.isinf(made([[np.inf, np.inf, np.inf]] * 4, 50, EDGE, **options).range_m).all()
    assert np.isinf(made([[109.9]], 50).range_m).all()  # beyond what a VLP-16 reports


def test_a_wide_beam():
    """Nine rays whose light has the beam's variance: a sixteenth of the squared full angle at 1/e²."""
    across, above, weights = beam_rays(VLP16, Realism(divergence=True))
    assert len(across) == len(above) == len(weights) == 9
    assert len(set(zip(across, above, strict=True))) == 9
    assert weights.sum() == pytest.approx(1)
    assert above**2 @ weights == pytest.approx((1.5e-3 / 4) ** 2)
    assert across**2 @ weights == pytest.approx((3e-3 / 4) ** 2)
    assert [values.tolist() for values in beam_rays(VLP16, Realism())] == [[0], [0], [1]]


def test_thin_exact_beams_have_one_echo():
    found = thin_beam_echoes(np.array([[7.0]]), np.array([[3]], np.uint8), np.array([[1]], np.int32), "dual")
    assert found.range_m.tolist() == [[7, 7]]
    assert found.noise_m.tolist() == [[0, 0]]


def test_a_scene_says_its_weather(tmp_path):
    stage = scene(tmp_path, "ground: {reflectivity: 9}\nweather: {rain_mm_h: 5}")
    assert stage.file.weather == Weather(rain_mm_h=5)
