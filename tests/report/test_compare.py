"""Rigs side by side: the table against each rig's own evaluation, what is marked best, and the page."""

import json
from dataclasses import replace

import click
import pytest

from lidarcfg.cli.main import cli
from lidarcfg.errors import ConfigError, LidarcfgError
from lidarcfg.report.comparison import comparison, comparison_dict, comparison_table, contenders, print_comparison
from lidarcfg.report.inputs import report_inputs
from lidarcfg.report.rig_report import Commands
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.extrapolation import Extrapolated
from lidarcfg.study.loading import load_study
from lidarcfg.study.spheres import largest_spheres
from tests.command_line import lidarcfg
from tests.report.test_report import STUDY, read

pytestmark = pytest.mark.slow

OBJECTS = "detection:\n  - {name: box, size_m: [1, 1, 0.5]}\n  - {name: '<i>&', size_m: [1, 1, 2], on_ground: true}\n"
RIG = "name: {name}\nsensors:\n"
SENSOR = "  - {{name: s{n}, elevation_deg: {beams}, position_m: [{x}, 4, 2.5], rpy_deg: [{roll}, 0, 0], data_port: {port}}}\n"


def rig_file(folder, name, *sensors):
    lines = [
        SENSOR.format(n=n, beams=list(beams), x=x, roll=roll, port=2368 + n)
        for n, (beams, x, roll) in enumerate(sensors)
    ]
    path = folder / f"{name}.yaml"
    path.write_text(RIG.format(name=name) + "".join(lines))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    (folder / "s.yaml").write_text(STUDY + OBJECTS)
    (folder / "bare.yaml").write_text(STUDY)
    rig_file(folder, "few", ((-10, 0, 10), 6, 0))
    rig_file(folder, "many", (range(-20, 21, 5), 6, 0), (range(-18, 19, 4), 7, 20))
    return folder


def compared(folder, study, *names, tolerance=None):
    loaded = load_study(folder / study)
    rigs = [(name, load_rig(folder / f"{name}.yaml")) for name in names]
    named = [
        (name, rig, report_inputs(loaded, rig, evaluate(loaded, rig, tolerance), cheap_cuboids=0)) for name, rig in rigs
    ]
    return loaded, contenders(named)


def rows(study, rigs):
    """The cells of each row by its name."""
    return {name.text: cells for name, *cells in comparison_table(study, rigs).cells}


def best(cells):
    return [cell.mark == "best" for cell in cells]


def run(folder, *words):
    return lidarcfg("compare", *words, cwd=folder)


def test_each_column_is_what_evaluate_says(folder):
    study, rigs = compared(folder, "s.yaml", "few", "many", "few", tolerance=0.2)
    table = rows(study, rigs)
    assert [rig.title for rig in rigs] == ["A few", "B many", "C few"]
    for column, name in enumerate(("few", "many", "few")):
        found = evaluate(study, load_rig(folder / f"{name}.yaml"), 0.2)
        bar = found.extrapolated
        expected = {
            "sensors": f"{2 if name == 'many' else 1}",
            "beams": f"{19 if name == 'many' else 3}",
            "max VSR (m)": f"{found.max_vsr_m:.6f}",
            "max VSR, extrapolated (m)": f"{bar.max_vsr_m:.6f} ± {bar.error_m:.6f}",
            "subspaces": f"{len(found.subspaces):,}",
            "volume of the worst (m³)": f"{found.worst[0].volume_m3:.2f}",
            "inner radius of the worst (m)": f"{found.worst[0].inscribed_radius_m:.3f}",
            "largest inner radius of any (m)": f"{largest_spheres(found.subspaces).radius_m.max():.3f}",
            "detection of box": f"{found.detection['box'].rate:.4f}",
            "detection of <i>&": f"{found.detection['<i>&'].rate:.4f}",
        }
        assert {what: table[what][column].text for what in expected} == expected
    assert best(table["max VSR (m)"]) == [False, True, False]
    assert best(table["detection of box"]) == [False, True, False]
    assert not any(best(table["sensors"] + table["beams"] + table["subspaces"]))


def test_nothing_is_best_among_equals(folder):
    study, rigs = compared(folder, "s.yaml", "few", "few", tolerance=0.2)
    assert not any(any(best(row)) for row in rows(study, rigs).values())
    assert comparison_dict(study, rigs)["best"] == {}


def test_error_bars_that_reach_the_best_are_marked_as_well(folder):
    study, rigs = compared(folder, "s.yaml", "few", "many")

    def marked(*bars):
        named = [
            (rig.file, rig.rig, replace(rig.details, evaluation=replace(rig.found, extrapolated=bar)))
            for rig, bar in zip(
                [*rigs, rigs[0]],
                [Extrapolated(value, error, 1.0, [1.0, 1.0, 1.0], 1, 0.0) for value, error in bars],
                strict=True,
            )
        ]
        return best(rows(study, contenders(named))["max VSR, extrapolated (m)"])

    assert marked((1.0, 0.1), (1.15, 0.1), (1.3, 0.1)) == [True, True, False]
    assert marked((1.0, 0.01), (1.15, 0.01), (0.9, 0.01)) == [False, False, True]
    assert marked((1.0, 0.1), (1.1, 0.1), (1.1, 0.1)) == [False, False, False]


def test_the_command_prints_a_table_and_writes_a_page(folder):
    words = ("few.yaml", "many.yaml", "many.yaml", "--study", "s.yaml", "-o", "out")
    done = run(folder, *words)
    result = json.loads((folder / "out/compare.json").read_text())
    page = read((folder / "out/compare.html").read_text())
    assert [rig["letter"] for rig in result["rigs"]] == ["A", "B", "C"]
    assert [rig["file"] for rig in result["rigs"]] == ["few.yaml", "many.yaml", "many.yaml"]
    assert result["best"]["max VSR (m)"] == ["B", "C"]
    assert result["rigs"][0]["extrapolated"] is None
    for rig in result["rigs"]:
        assert f"{rig['max_vsr_m']:.6f}" in done.stdout
        assert f"{rig['letter']} {rig['name']} {rig['max_vsr_m']:.6f} m" in page.words
        for rate in rig["detection"].values():
            assert f"{rate:.4f}" in page.words
    assert "detection of <i>&" in page.words
    assert "best of its row" in done.stdout
    assert "lidarcfg compare few.yaml many.yaml many.yaml --study s.yaml -o out" in page.words
    assert [link for link in page.links if link in ("#table", "#worst", "#detection", "#coverage", "#rigs", "#repeat")]
    printed = run(folder, *words[:-2], "--json")
    again = json.loads(printed.stdout)
    assert printed.stderr == ""
    for rig in (*again["rigs"], *result["rigs"]):
        rig.pop("seconds")
    assert again == result


def test_six_rigs_stand_in_two_tables(folder, capsys):
    study, rigs = compared(folder, "s.yaml", *["few", "many"] * 3)
    assert [rig.letter for rig in rigs] == list("ABCDEF")
    page = read(comparison(study, rigs, Commands("typed", "typed")))
    assert page.tags.count("caption") == 1 + 2 + 6  # what was compared, four rigs a table, each rig's poses
    assert all(rig.title in page.words for rig in rigs)
    print_comparison(study, rigs)
    printed = capsys.readouterr().out
    assert "…" not in printed
    assert max(map(len, printed.splitlines())) <= 110
    assert printed.count(f"{rigs[1].found.max_vsr_m:.6f} *") == 3


def test_a_study_without_objects(folder):
    study, rigs = compared(folder, "bare.yaml", "few", "many")
    page = read(comparison(study, rigs, Commands("typed", "typed")))
    assert "names no objects" in page.words
    assert not [what for what in rows(study, rigs) if what.startswith("detection")]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["few.yaml", "--study", "s.yaml"], "1 rig to compare; allowed: 2 to 10"),
        (["--study", "s.yaml"], "0 rigs to compare; allowed: 2 to 10"),
        (["few.yaml"] * 11 + ["--study", "s.yaml"], "11 rigs to compare; allowed: 2 to 10"),
        (["few.yaml", "few.yaml"], "Missing option '--study'"),
        (["few.yaml", "none.yaml", "--study", "s.yaml"], "none.yaml: no such file"),
        (["few.yaml", "s.yaml", "--study", "s.yaml"], "s.yaml:2:1: this is a study; a rig belongs here"),
        (["few.yaml", "few.yaml", "--study", "few.yaml"], "few.yaml:1:1: this is a rig; a study belongs here"),
        (["few.yaml", "few.yaml", "--study", "s.yaml", "--tolerance", "0"], "Invalid value for '--tolerance'"),
        (["few.yaml", "few.yaml", "--study", "s.yaml", "-o", "s.yaml"], "File exists"),
    ],
)
def test_mistakes_are_one_line(folder, words, message, monkeypatch):
    """How such errors are printed, and that they end with 2, tests/cli/test_cli.py shows."""
    monkeypatch.chdir(folder)
    before = set(folder.iterdir())
    with pytest.raises((LidarcfgError, click.ClickException, OSError)) as caught:
        cli.main(["compare", *words, "--quiet"], standalone_mode=False)
    error = caught.value
    said = error.format_message() if isinstance(error, click.ClickException) else str(error)
    assert message in said
    assert "\n" not in said
    assert set(folder.iterdir()) == before


def test_too_many_from_python():
    with pytest.raises(ConfigError, match="1 rig to compare; allowed: 2 to 10"):
        contenders([None])
