"""What a report says of skipped work and of sampled rates, for every solver and objective.

The witness is a search that skips nothing: it evaluates every rig of every trial in full.
"""

import itertools

import pytest

from lidarcfg.report.describe import describe_skips
from lidarcfg.report.evaluation import detection_table
from lidarcfg.report.results import placement_dict
from lidarcfg.report.rig_report import skipped_facts
from lidarcfg.search.optimize import optimize
from lidarcfg.sensors.rig import load_rig
from lidarcfg.study.evaluation import evaluate
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from lidarcfg.vsr.detection import mean_of

pytestmark = pytest.mark.slow

STUDY = """
region: {min_m: [-4, -3, 0], max_m: [4, 3, 2], cuboid_m: [1, 1, 0.5]}
sensors:
  - model: vlp-16
    count: 2
    min: {position_m: [-1, -1, 1], rpy_deg: [-20, -20, 0]}
    max: {position_m: [1, 1, 1.5], rpy_deg: [20, 20, 0]}
detection:
  - {name: child, size_m: [0.9, 0.9, 0.9]}
  - {name: drawn, size_m: [0.9, 0.9, 0.9], samples: 16}
  - {name: post, size_m: [0.3, 0.3, 1], returns: 2, step_m: 2}
vehicle:
  boxes: [{name: box, center_m: [0, 0, 0.4], size_m: [1, 1, 0.8]}]
solver: {method: METHOD, evaluations: 60, seed: 2, bees: 8}
OBJECTIVE
"""
OBJECTIVES = {
    "max VSR": "objective: {max_vsr: 1}",
    "misses": "objective: {misses: {objects: {tyre: 1}, within_m: [0.1, 2]}}",
    "volumes": "objective: {blind_volume: 1, seen_by_two: 1}",
    "detection": "objective: {detection: {child: 1}}",
    "both": "objective: {max_vsr: 1, detection: {drawn: 2}}",
    "returns": "objective: {detection: {post: 1}}",
    "robust": "objective: {max_vsr: 1}\nrobust: {lost: 1}",
    "zones": "objective: {max_vsr: 1}\nzones: [{name: near, min_m: [-2, -2, 0], max_m: [2, 2, 2], weight: 3}]",
}
METHODS = ("abc", "annealing")


def study_of(folder, method, objective, without="none"):
    path = folder / "s.yaml"
    text = STUDY.replace("METHOD", method).replace("OBJECTIVE", OBJECTIVES[objective])
    text = text if method == "abc" else text.replace(", bees: 8", "")
    path.write_text("\n".join(line for line in text.splitlines() if without not in line))
    return load_study(path)


@pytest.mark.parametrize(
    ("method", "objective"),
    [case for case in itertools.product(METHODS, OBJECTIVES) if case[1] != "misses"] + [("annealing", "misses")],
)
def test_what_was_skipped(tmp_path, method, objective):
    study = study_of(tmp_path, method, objective)
    found = optimize(study, threads=1)
    plain = optimize(study, threads=1, skip=False)
    assert found.objective == plain.objective
    told, none = (placement_dict(study, one, one.evaluation)["skipped"] for one in (found, plain))
    assert none == {"rigs": none["rigs"], "full_evaluations": 0, "cuboids": 0, "segments": none["segments"]}
    trials = plain.evaluations + plain.first_evaluations + plain.scout_evaluations
    lost = 2 if objective == "robust" else 1  # each of two LiDARs
    assert told["rigs"] == none["rigs"] == trials * lost == plain.full_evaluations
    assert 0 <= told["full_evaluations"] == plain.full_evaluations - found.full_evaluations
    assert 0 <= told["cuboids"] <= plain.cuboids
    assert (plain.cuboids == 0) == (objective in ("returns", "misses"))
    facts = skipped_facts(study, told)
    if objective in ("returns", "misses"):  # no subspaces are computed
        assert facts == []
    else:
        ((_, settled),) = facts
        assert settled.startswith(f"{told['full_evaluations']:,} of {plain.full_evaluations:,} (")
    words = describe_skips(study)
    assert "evaluated in full" not in words
    if objective in ("max VSR", "zones"):
        assert "one of its subspaces" in words


def test_a_resumed_search_counts_what_it_evaluated_itself(tmp_path):
    study = study_of(tmp_path, "abc", "max VSR")
    whole = optimize(study, threads=1)
    first = optimize(with_solver(study, evaluations=24), threads=1)
    rest = optimize(study, threads=1, log=first.log)
    assert rest.evaluations == whole.evaluations
    assert first.evaluated + rest.evaluated == whole.evaluated


def test_a_sampled_rate_of_exactly_one_is_not_exact(tmp_path):
    """Of 16 drawn positions all detected: a rate below 0.05 ** (1 / 16) would show that less than once in 20 times."""
    study = study_of(tmp_path, "abc", "max VSR", "post")
    (tmp_path / "r.yaml").write_text(
        "name: r\nsensors:\n" + "".join(
            f"  - {{name: s{i}, elevation_deg: [-60, -45, -30, -20, -10, -5, 0, 5, 10, 20, 30, 45, 60], "
            f"position_m: [{x}, {y}, 1.2], rpy_deg: [0, 0, 0]}}\n"
            for i, (x, y) in enumerate(itertools.product((-3, -1, 1, 3), (-2, 0.7, 2)))
        )
    )  # fmt: skip
    found = evaluate(study, load_rig(tmp_path / "r.yaml"))
    rate = found.detection["drawn"]
    assert rate.rate == 1.0
    assert rate.half_width == 1 - 0.05 ** (1 / rate.places)
    assert (1 - rate.half_width) ** rate.places == pytest.approx(0.05)
    rows = {row[0]: row for row in detection_table(study, found).texts}
    assert rows["drawn"][2] == f"± {rate.half_width:.4f}, {rate.places} drawn places"
    assert rows["child"][2].startswith(f"{found.detection['child'].places:,} places, ")
    assert "exact" not in rows["child"][2]
    assert found.detection["child"].half_width == 0.0


def test_replicates_that_differ_have_students_interval():
    """scipy's own: a mean of 0.5, 0.6, 0.7 and 0.8 within ± 3.182 standard errors."""
    mean, half = mean_of([0.5, 0.6, 0.7, 0.8], 100)
    assert (mean, half) == (pytest.approx(0.65), pytest.approx(3.1824 * 0.129099 / 2, rel=1e-4))
