"""`lidarcfg optimize` of a study with requirements: the verdict first, and exit codes that scripts can use."""

import csv
import json

from tests.command_line import lidarcfg
from tests.placement.test_requirements_search import CHOICE, SLIT


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
    assert "no rig found meets all requirements" in done.stdout
    with open(tmp_path / "out" / "combinations.csv") as file:
        rows = list(csv.DictReader(file))
    assert {row["excluded"] for row in rows} == {"too dear"}
