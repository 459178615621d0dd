"""The overview, the first page of a report: printed by Chromium, and what losing a sensor costs, by cases made by hand."""

import base64
import re

import pytest

from lidarcfg.report.inputs import report_inputs
from lidarcfg.report.overview import rig_table
from lidarcfg.report.results import save_evaluation
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate, misses_without
from lidarcfg.study.loading import load_study
from tests.chromium import LACKING, browser

pytestmark = pytest.mark.slow

PAPERS_CM = {"A4": (21.0, 29.7), "Letter": (21.59, 27.94)}
BODY = {"boxes": [{"name": "body", "center_m": [0, 0, 1], "size_m": [4, 2, 2]}]}


def pose(x, y, z):
    return {"position_m": [x, y, z], "rpy_deg": [0, 0, 0]}


def study_of(**keys):
    sensors = [{"name": "a", "model": "vlp-16", "min": pose(0, 0, 2.2), "max": pose(0, 0, 2.2)}]
    region = {"min_m": [-8, -8, 0], "max_m": [8, 8, 4], "cuboid_m": [2, 2, 1]}
    objective = {"misses": {"objects": keys.pop("objects", {"post": 1}), "within_m": [0.1, 6]}}
    return load_study({"region": region, "vehicle": BODY, "sensors": sensors, "objective": objective, **keys})


def rig_of(*mounts):
    return load_rig({"name": "r", "sensors": [{"model": "vlp-16", **mount} for mount in mounts]})


def test_what_a_lost_sensor_costs():
    """One of two sees nothing, as its range ends in the air: without it no more is missed, without the other all is."""
    study = study_of()
    rig = rig_of(
        {"name": "seeing", "position_m": [0, 0, 2.5]},
        {"name": "blind", "position_m": [0, 0, 3.0], "range_m": [0.1, 0.2]},
    )
    whole = study.misses.found(rig.mounts).mean
    assert 0 < whole < 1
    assert misses_without(study, rig) == {"seeing": 1.0, "blind": whole}
    assert misses_without(study, rig_of({"name": "alone", "position_m": [0, 0, 2.5]})) == {}


def test_prices_stand_beside_the_sensors_where_all_are_known():
    rig = rig_of({"name": "one", "position_m": [0, 0, 2.5]})
    heads = [
        [column.name for column in rig_table(study, rig, evaluate(study, rig)).columns]
        for study in (study_of(prices={"vlp-16": 4000}), study_of(prices={"os1-64": 12000}), study_of())
    ]
    assert ["price" in one for one in heads] == [True, False, False]


@pytest.mark.skipif(bool(LACKING), reason=LACKING)
def test_it_is_one_page_in_print_also_with_many_sensors_and_requirements(tmp_path):
    """Chromium's PDF of the report without its sections has one page; the sections begin on the next one."""
    names = [f"a requirement of a name that is long, number {n}" for n in range(9)]
    required = [{"name": name, "sensors_at_most": 1 + n} for n, name in enumerate(names)]
    objects = dict.fromkeys(("pedestrian", "child", "cyclist", "tyre", "post", "dog", "car"), 1)
    study = study_of(objects=objects, prices={"vlp-16": 123456.78}, requirements=required)
    rig = rig_of(*({"name": f"sensor_of_a_long_name_{n}", "position_m": [n / 10, 0, 2.5]} for n in range(11)))
    save_evaluation(study, rig, report_inputs(study, rig, evaluate(study, rig)), tmp_path)
    from selenium.webdriver.common.print_page_options import PrintOptions

    with browser() as driver:

        def pages(size_cm):
            options = PrintOptions()
            options.page_width, options.page_height = size_cm
            options.margin_top = options.margin_bottom = 1.4  # as the style has it
            options.margin_left = options.margin_right = 1.5
            return len(re.findall(rb"/Type\s*/Page\b", base64.b64decode(driver.print_page(options))))

        driver.get((tmp_path / "report.html").as_uri())
        whole = {name: pages(size_cm) for name, size_cm in PAPERS_CM.items()}
        driver.execute_script("document.querySelector('main').remove()")
        with_contents = {name: pages(size_cm) for name, size_cm in PAPERS_CM.items()}
        driver.execute_script("document.querySelector('nav').remove()")
        alone = {name: pages(size_cm) for name, size_cm in PAPERS_CM.items()}
    assert alone == {"A4": 1, "Letter": 1}
    assert with_contents == {"A4": 2, "Letter": 2}
    assert min(whole.values()) > 2
