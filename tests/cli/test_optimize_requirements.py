"""`lidarcfg optimize` of a study with requirements: the verdict first, and exit codes that scripts can use."""

import csv
import json

import numpy as np
import pytest

from tests.command_line import lidarcfg
from tests.search.test_requirements_search import CHOICE, SLIT

pytestmark = pytest.mark.slow


def test_exit_3_where_a_requirement_is_not_met(tmp_path, blank_pictures):
    study = tmp_path / "study.yaml"
    study.write_text(SLIT.replace("returns: 20", "returns: 100000"))
    out = tmp_path / "out"
    done = lidarcfg("optimize", study, "--evaluations", 20, "-o", out, code=3)
    assert done.stdout.index("FAIL") < done.stdout.index("max VSR")
    found = json.loads((out / "result.json").read_text())
    assert not found["verdict"]["pass"]
    assert (out / "rig.yaml").exists()
    done = lidarcfg("evaluate", study, out / "rig.yaml")
    assert "FAIL" in done.stdout
    done = lidarcfg("compare", out / "rig.yaml", out / "rig.yaml", "--study", study, "--json")
    assert not json.loads(done.stdout)["rigs"][0]["verdict"]["pass"]


def test_the_cheapest_rig(tmp_path, blank_pictures):
    study = tmp_path / "study.yaml"
    study.write_text(CHOICE.replace("RETURNS", "300").replace("price_at_most: 13000", "price_at_most: 3999"))
    done = lidarcfg("optimize", study, "--evaluations", 20, "-o", tmp_path / "out", code=3)
    assert "not achievable: the cheapest rig costs 4,000" in done.stderr
    assert "no rig can meet all requirements: the cheapest combination, 1 × vlp-16 for 4,000: too dear" in done.stdout
    assert "to go on" not in done.stdout
    with open(tmp_path / "out" / "combinations.csv") as file:
        rows = list(csv.DictReader(file))
    assert {row["excluded"] for row in rows} == {"too dear"}
    assert {row["verdict"] for row in rows} == {"cannot meet all"}
    assert [(row["left"], row["right"], row["price"]) for row in rows][:2] == [
        ("1 × vlp-16", "none", "4000"),
        ("none", "1 × vlp-16", "4000"),
    ]


def test_a_failed_choice_says_how_to_go_on_and_goes_on(tmp_path, blank_pictures):
    """Until the budget is as large as that of a search that was not interrupted."""
    study = tmp_path / "study.yaml"
    study.write_text(CHOICE.replace("RETURNS", "1500").replace("13000", "15000"))
    done = lidarcfg("optimize", study, "--evaluations", 100, "-o", tmp_path / "out", code=3)
    assert "to go on: lidarcfg optimize" in done.stdout
    report = (tmp_path / "out/report.html").read_text()
    assert f"lidarcfg optimize {study} --resume {tmp_path}/out" in report
    assert "The combinations of sensors" in report
    for price in ("4,000", "7,000", "14,000"):
        assert price in report
    begun = combinations_of(tmp_path / "out")
    lidarcfg("optimize", study, "--evaluations", 300, "--resume", tmp_path / "out", code=3)
    resumed = combinations_of(tmp_path / "out")
    assert sum(int(row["rigs"]) for row in resumed) > sum(int(row["rigs"]) for row in begun)
    for before, after in zip(begun, resumed, strict=True):
        assert before["name"] == after["name"]
    other = tmp_path / "other.yaml"
    other.write_text(study.read_text().replace("1500", "1400"))
    assert "of another search" in lidarcfg("optimize", other, "--resume", tmp_path / "out", code=2).stderr
    np.savez(tmp_path / "out/search.npz", asked=np.str_("x"), state=np.ones(3))
    assert "is not the log" in lidarcfg("optimize", study, "--resume", tmp_path / "out", code=2).stderr


def combinations_of(folder):
    with open(folder / "combinations.csv") as file:
        return list(csv.DictReader(file))
