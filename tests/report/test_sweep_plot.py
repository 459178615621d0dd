"""The plot of a sweep: its lines are medians over seeds by hand, between the least and the greatest."""

from pathlib import Path

import pytest

from lidarcfg.report.sweep import draw_sweep
from lidarcfg.search.sweep_plan import load_plan

STUDY = (Path(__file__).parents[1] / "search/studies/plan.yaml").read_text().partition("vary:")[0]
COSTS = {(1, 1): (5, 1, 3), (1, 2): (4, 4, 1), (2, 1): (9, None, 7), (2, 2): (2, 2, 2)}  # model, count → by seed
VARY = """vary:
  solver.evaluations: [60]
  "sensors[0].model": [fan-4, fan-8]
  "sensors[0].count": [2, 1]
  solver.seed: [1, 2, 3]
"""


@pytest.fixture
def drawn(tmp_path):
    """The axes of a plan's plot, or nothing."""

    def draw(vary, costs):
        (tmp_path / "plan.yaml").write_text(f"{STUDY}  objective: {{max_vsr: 1}}\n{vary}")
        plan = load_plan(tmp_path / "plan.yaml")
        figure = draw_sweep(plan, costs(plan.runs), is_max_vsr=True)
        return figure and figure.axes[0]

    return draw


def test_medians_by_hand(drawn):
    def costs(runs):
        models = {"fan-4": 1, "fan-8": 2}
        return [
            COSTS[models[run.values["sensors[0].model"]], run.values["sensors[0].count"]][run.values["solver.seed"] - 1]
            for run in runs
        ]

    axes = drawn(VARY, costs)
    lines = {line.get_label(): (list(line.get_xdata()), list(line.get_ydata())) for line in axes.get_lines()}
    assert lines == {"fan-4": ([1, 2], [3, 4]), "fan-8": ([1, 2], [8, 2])}
    spread = axes.collections[1].get_paths()[0].vertices
    assert {(x, y) for x, y in spread.tolist()} >= {(1, 7), (1, 9), (2, 2)}
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("sensors[0].count", "max VSR (m)")
    axes.figure.draw_without_rendering()
    assert not axes.get_legend().get_window_extent().overlaps(axes.get_window_extent())


def test_a_body_and_none_have_names(drawn):
    vary = 'vary: {vehicle: [null, {boxes: [{name: b, size_m: [1, 1, 1]}]}], "sensors[0].count": [1, 2]}'
    axes = drawn(vary, lambda runs: [1.0] * len(runs))
    assert [line.get_label() for line in axes.get_lines()] == ["no vehicle", "vehicle"]


@pytest.mark.parametrize(
    "vary",
    ["vary: {solver.seed: [1, 2]}", "vary: {'sensors[0].model': [fan-4, fan-8]}", 'vary: {"sensors[0].count": [1]}'],
)
def test_nothing_to_draw(drawn, vary):
    assert drawn(vary, lambda runs: [1.0] * len(runs)) is None
    assert drawn(VARY, lambda runs: [None] * len(runs)) is None
