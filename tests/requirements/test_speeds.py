"""A scenario by speed: braking worked by hand, what is said of up to which speed, and tables, JSON and JUnit as one."""

import json
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree

import numpy as np
import pytest

from lidarcfg.report.junit import junit
from lidarcfg.report.results import to_json
from lidarcfg.report.scenario import draw_scenario
from lidarcfg.report.verdict import remarks, speeds_table, verdict_dict, verdict_table
from lidarcfg.requirements.scenarios.approach import EMERGENCY, Approach, VehicleExtent
from lidarcfg.requirements.scenarios.file import load_scenario
from lidarcfg.requirements.scenarios.requirement import by_speed
from lidarcfg.requirements.scenarios.run import Rule, ScenarioCase, ScenarioResult, ScenarioRun, needed
from lidarcfg.requirements.scenarios.sight import LineOfSight
from lidarcfg.requirements.speeds import SpeedVerdicts
from lidarcfg.requirements.verdict import RequirementVerdict, Verdict
from tests.naive import scenario as naive

CAR = VehicleExtent(front_m=2.4, rear_m=-2.4, right_m=-0.95, left_m=0.95)
LEAD_S = 3.0
FRAME_S = 0.1
UPRIGHT = "last moment to brake", "detected", "earliest line of sight"
SHOWS_S = 0.5  # when the target comes into sight


@cache
def cpnco():
    return load_scenario("cpnco")


def case(speed_km_h, enough, impact=0.5, shows_s=SHOWS_S, returns=12):
    """A case of one run of 30 frames, with returns where `enough` says so of a frame's number, else with 7."""
    one = Approach(cpnco(), CAR, speed_km_h, impact, LEAD_S)
    counts = np.array([returns if enough(n) else 7 for n in range(1, 31)])
    run = ScenarioRun(one, 0, (), FRAME_S, needed(one, EMERGENCY), 10, counts)
    return ScenarioCase(speed_km_h, impact, (run,), LineOfSight(shows_s, 1, 1))


def result_of(*cases):
    return ScenarioResult(cpnco(), Rule(), EMERGENCY, ("front",), cases)


def speeds_of(*cases):
    return by_speed(result_of(*cases))


def at_once(speed_km_h):
    """Of a target that is seen from 1.0 s after the start on, 2 s before the impact."""
    return case(speed_km_h, lambda n: n >= 10)


@pytest.mark.parametrize(
    ("speed_km_h", "needed_m", "seen_m"),
    [
        (36.0, 10 * 0.3 + 100 / 16, 20.0),  # 10 m/s: v t + v²/(2a) with 0.3 s and 8 m/s² is 9.25 m
        (72.0, 20 * 0.3 + 400 / 16, 40.0),  # 20 m/s: 31 m, 1.55 s
    ],
)
def test_margins_by_hand(speed_km_h, needed_m, seen_m):
    """Seen 2 s before the impact; needed as the formula and as a vehicle that is stepped to a stop has it."""
    (found,) = speeds_of(at_once(speed_km_h)).tested
    speed_m_s = speed_km_h / 3.6
    assert found.needed_m == pytest.approx(needed_m)
    assert found.needed_s == pytest.approx(naive.last_moment(speed_m_s, 0.3, 8.0), abs=0.02)
    assert (found.seen_m, found.seen_s) == (pytest.approx(seen_m), pytest.approx(2.0))
    assert found.sight_m == pytest.approx(speed_m_s * (LEAD_S - SHOWS_S))
    assert found.margin_m == pytest.approx(seen_m - needed_m)
    assert found.margin_s == pytest.approx((seen_m - needed_m) / speed_m_s)
    assert found.passed


def test_why_it_is_too_late_by_hand():
    """At 36 km/h 0.925 s are needed: frames end at 0.1, 0.2 … s, the last one in time at 2.0 s, 10 m before."""
    late = 36.0
    lost, hidden, never, first = speeds = [
        speeds_of(one).tested[0]
        for one in (
            case(late, lambda n: n < 19 or n > 25),
            case(late, lambda n: n >= 25, shows_s=2.3),
            case(late, lambda n: False),
            case(late, lambda n: n >= 25),
        )
    ]
    assert not any(one.passed for one in speeds)
    assert (lost.cause, lost.why) == ("lost_track", "lost track at 11.0 m: 7 of 10 returns")
    assert lost.seen_m == pytest.approx(4.0)  # again, at 2.6 s
    assert (hidden.cause, hidden.why) == ("in_sight_too_late", "in sight too late")
    assert (never.cause, never.why, never.seen_m) == ("never_seen", "never seen: at most 7 of 10 returns", None)
    assert (never.margin_m, never.margin_s) == (pytest.approx(-9.25), pytest.approx(-0.925))
    assert (first.cause, first.why, first.seen_m) == ("seen_too_late", "first seen too late", pytest.approx(5.0))


def found_at(in_time, late):
    """The verdicts at speeds at which it is in time, and at others."""
    cases = [at_once(one) for one in in_time] + [case(one, lambda n: False) for one in late]
    return speeds_of(*cases)


@pytest.mark.parametrize(
    ("in_time", "late", "up_to", "said"),
    [
        ((30, 10, 20), (), 30, "in time at all 3 speeds tested, 10 to 30 km/h"),
        ((), (20, 10), None, "too late at all 2 speeds tested, 10 to 20 km/h"),
        ((10, 20), (30, 40), 20, "in time up to 20 km/h, too late at 30, 40 km/h"),
        ((10, 30), (20, 40), 10, "in time up to 10 km/h, too late at 20, 40 km/h, in time again at 30 km/h"),
        ((20, 40), (10, 30), None, "too late at 10, 30 km/h, from the lowest speed tested on; in time at 20, 40 km/h"),
        ((50,), (), 50, "in time at 50 km/h, the only speed tested"),
        ((), (50,), None, "too late at 50 km/h, the only speed tested"),
    ],
)
def test_up_to_which_speed(in_time, late, up_to, said):
    """By a loop over the speeds, in whatever order they are given, until the first that is late."""
    found = found_at(in_time, late)
    assert (found.up_to_km_h, found.text) == (up_to, said)
    assert found.up_to_km_h == naive.up_to({speed: speed in in_time for speed in (*in_time, *late)})
    assert [one.speed_km_h for one in found.tested] == sorted((*in_time, *late))


@pytest.mark.parametrize("speed_km_h", [36.0, 72.0])
def test_margins_of_any_returns(speed_km_h):
    """Beside frames that are walked back from the last moment to brake, one by one."""
    rng = np.random.default_rng(7)
    needed_s = {36.0: 0.925, 72.0: 1.55}[speed_km_h]  # 9.25 m at 10 m/s, 31 m at 20 m/s
    causes = set()
    for _ in range(200):
        counts = rng.choice([0, 9, 10, 40], 30, p=rng.dirichlet([1, 1, 1, 1]))
        (found,) = speeds_of(case(speed_km_h, lambda n, counts=counts: counts[n - 1] >= 10)).tested
        seen_s = naive.seen_before(counts, FRAME_S, LEAD_S, needed_s, 10)
        assert found.seen_s == (None if seen_s is None else pytest.approx(seen_s))
        margin_s = (seen_s or 0.0) - needed_s
        assert found.margin_s == pytest.approx(margin_s)
        assert found.margin_m == pytest.approx(margin_s * speed_km_h / 3.6)
        assert found.passed == (margin_s >= 0)
        assert (found.cause is None) == found.passed
        causes.add(found.cause)
    assert causes >= {None, "lost_track"}


def test_the_worst_impact_counts():
    """Of two impacts at a speed the one that is seen later, and it is said which."""
    both = case(36.0, lambda n: n >= 10, impact=0.25), case(36.0, lambda n: n >= 15, impact=0.75)
    (found,) = speeds_of(*both).tested
    assert (found.impact, found.seen_m) == (0.75, pytest.approx(15.0))


@pytest.mark.slow
def test_no_speed_is_cut_off_the_picture():
    """Of eight speeds, in time, late and never: axes, titles and legend are on the figure and apart, lines in their axes."""
    cases = [at_once(one) for one in (10.0, 20.0, 30.0, 40.0, 50.0)]
    cases += [case(60.0, lambda n: True, shows_s=0.0), case(70.0, lambda n: n >= 29), case(80.0, lambda n: False)]
    figure = draw_scenario(result_of(*cases))
    figure.canvas.draw()
    assert [axes.get_title().split(" km/h")[0] for axes in figure.axes] == [
        "10",
        "20",
        "30",
        "40",
        "50",
        "60",
        "70",
        "80",
    ]
    whole = [axes.get_tightbbox() for axes in figure.axes] + [figure.legends[0].get_window_extent()]
    for n, box in enumerate(whole):
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in whole[:n])
    for axes in figure.axes:
        left, right = axes.get_xlim()
        low, high = axes.get_ylim()
        upright = [line.get_xdata()[0] for line in axes.lines if line.get_label() in UPRIGHT]
        assert len(upright) >= 2
        assert all(left > before_s > right for before_s in upright)
        (returns,) = (line.get_ydata() for line in axes.lines if line.get_label() == "worst run")
        assert low < min(returns) <= max(returns) < high
        assert [label.get_text() for label in axes.get_yticklabels()][:3] == ["0", "1", "10"]
    assert figure.axes[5].get_xlim()[0] > LEAD_S  # in sight from the start


@pytest.mark.slow
def test_titles_that_say_where_it_is_hit_do_not_touch():
    """Of three impacts at two speeds, one of them of three figures: by the extents of what is drawn."""
    cases = [case(speed, lambda n: n >= 25, impact) for speed in (60.0, 110.0) for impact in (0.25, 0.5, 0.75)]
    figure = draw_scenario(replace(result_of(*cases), scenario=load_scenario("cpna")))
    figure.canvas.draw()
    titles = [axes.title.get_window_extent() for axes in figure.axes]
    assert ["hit at" in axes.get_title() for axes in figure.axes] == [True] * 6
    for n, box in enumerate(titles):
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert not any(box.overlaps(other) for other in titles[:n])


def verdict_of(speeds: SpeedVerdicts, name="child <ahead>") -> Verdict:
    return Verdict(
        (RequirementVerdict(name, "scenario", not speeds.failed, "s", 0.0, -1.0, False, 1.0, speeds=speeds),)
    )


def test_terminal_page_json_and_junit_say_the_same():
    """The table's records are the JSON's; JUnit has a case for each speed, which fails where the table says FAIL."""
    found = verdict_of(found_at((10, 20), (30,)))
    (one,) = found.requirements
    values = json.loads(to_json(verdict_dict(found)))["requirements"][0]["speeds"]
    assert values["in_time_up_to_km_h"] == 20
    table = speeds_table(one)
    assert [column.head for column in table.columns[:5]] == [
        "km/h",
        "in sight (m)",
        "seen (m)",
        "needed (m)",
        "margin (m)",
    ]
    for record, whole in zip(table.records, values["tested"], strict=True):
        assert record == {key: whole[key] for key in record}
    assert [row[6] for row in table.texts] == ["PASS", "PASS", "FAIL"]
    assert table.texts[2][2] == "never"
    assert remarks(found) == ["child <ahead>: in time up to 20 km/h, too late at 30 km/h"]

    suite = ElementTree.fromstring(junit(found, "study rig")).find("testsuite")
    assert (suite.get("tests"), suite.get("failures")) == ("3", "1")
    assert suite.find("properties/property").attrib == {"name": "child <ahead>: in_time_up_to_km_h", "value": "20"}
    cases = suite.findall("testcase")
    assert [case.get("name") for case in cases] == [f"child <ahead> at {speed} km/h" for speed in (10, 20, 30)]
    assert [case.find("failure") is not None for case in cases] == [False, False, True]
    margins = [float(case.find("properties/property[@name='margin_m']").get("value")) for case in cases]
    assert margins == pytest.approx([record["margin_m"] for record in table.records], abs=1e-3)
    # 30 km/h: 8.33 · 0.3 + 8.33² / 16 = 6.8 m, 0.82 s
    assert cases[2].find("failure").get("message") == (
        "never seen: at most 7 of 10 returns, 6.8 m needed, margin -6.8 m, -0.82 s"
    )


def test_a_table_of_scenarios_has_no_empty_columns():
    """It has neither phases nor distances from the body; minus signs are alike."""
    table = verdict_table(verdict_of(found_at((10,), (30,))))
    assert [column.name for column in table.columns] == ["requirement", "verdict", "demanded", "reached", "margin"]
    assert table.texts == [["child <ahead>", "FAIL", "≥ 0.00 s", "-1.00 s", "-1.00 s"]]
    assert "hases" not in table.caption


def test_beside_another_rig():
    """Its margin, and the change: 20 km/h seen 2 s or 1.5 s before the impact is a difference of 2.8 m."""
    found, other = verdict_of(speeds_of(at_once(20.0))), verdict_of(speeds_of(case(20.0, lambda n: n >= 15)))
    table = speeds_table(found.requirements[0], other.requirements[0])
    (record,) = table.records
    assert record["change"] == pytest.approx(20 / 3.6 * 0.5)
    assert record["other's"] == pytest.approx(record["margin_m"] - record["change"])
    assert remarks(found, other)[1] == "child <ahead>: the other rig: in time at 20 km/h, the only speed tested"


def test_a_sensor_that_is_lost_is_named():
    """In the table only where there is one."""
    speeds = speeds_of(at_once(20.0))
    gone = SpeedVerdicts((replace(speeds.tested[0], lost=("front",)),))
    assert speeds_table(verdict_of(gone).requirements[0]).texts[0][-1] == "front"
    assert "sensors lost" not in [column.name for column in speeds_table(verdict_of(speeds).requirements[0]).columns]
