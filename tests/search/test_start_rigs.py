"""Rigs that a search begins with: where they are in the unit cube, what is refused, and that no result is worse."""

from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.search.cheapest import cheapest
from lidarcfg.search.combinations import distinct_combinations
from lidarcfg.search.front import front
from lidarcfg.search.optimize import optimize
from lidarcfg.search.start_rigs import point_of, points_by_combination
from lidarcfg.study.loading import load_study
from lidarcfg.study.study import with_solver
from tests.command_line import lidarcfg
from tests.search.test_requirements_search import CHOICE, CRATES

BOX = """
region: {min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 1, 0.5]}
sensors:
  - {name: roof, model: fan-4, count: 2, min: {position_m: [5, 3, 1], rpy_deg: [-10, -10, 170]}, max: {position_m: [7, 5, 2], rpy_deg: [10, 10, 190]}}
  - {name: side, model: fan-8, count: 4, mirror_y_m: 4, min: {position_m: [1, 1, 1], rpy_deg: [0, -5, 20]}, max: {position_m: [2, 2, 1], rpy_deg: [5, 5, 20]}}
solver: {method: annealing, evaluations: 60}
"""
SURFACE = """
region: {min_m: [0, 0, 0], max_m: [12, 8, 3], cuboid_m: [1, 1, 0.5]}
vehicle: {boxes: [{name: box, center_m: [6, 4, 0.6], size_m: [2, 1, 1.2]}]}
sensors:
  - {name: top, model: vlp-16, count: 2, on: {body: box, from: above, within: {min_m: [5, 3, 1], max_m: [7, 5, 1.3]}, standoff_m: 0.1}, roll_deg: [-10, 10]}
solver: {method: annealing, evaluations: 60}
"""


@pytest.fixture
def study(tmp_path):
    def write(text):
        path = tmp_path / "study.yaml"
        path.write_text(text)
        return load_study(path)

    return write


def moved(rig, name, axis, value):
    """The rig with one coordinate of a sensor changed; angles in degrees."""
    mounts = []
    for mount in rig.mounts:
        if mount.name == name:
            position, rpy = list(mount.position_m), list(mount.rpy_rad)
            if axis < 3:
                position[axis] = value
            else:
                rpy[axis - 3] = float(np.radians(value))
            mount = replace(mount, position_m=tuple(position), rpy_rad=tuple(rpy))
        mounts.append(mount)
    return replace(rig, mounts=tuple(mounts))


def renamed(rig, rng):
    """The rig with its sensors in another order, called otherwise, and yaws a turn off."""
    mounts = [
        replace(mount, name=f"x{n}", rpy_rad=(*mount.rpy_rad[:2], mount.rpy_rad[2] - 2 * np.pi))
        for n, mount in enumerate(rig.mounts)
    ]
    return replace(rig, mounts=tuple(mounts[i] for i in rng.permutation(len(mounts))))


@pytest.mark.parametrize(
    "text",
    [
        BOX,
        SURFACE,
        SURFACE.replace("roll_deg: [-10, 10]", "yaw_deg: [0, 90]").replace("standoff", "upright: false, standoff"),
    ],
)
def test_a_rig_stands_where_its_point_says(study, text):
    """The way back of Study.poses, which is the witness: of random points, for sensors in any order."""
    one = study(text)
    rng = np.random.default_rng(1)
    x = rng.random((60, one.space.dimensions))
    poses = one.space.poses(x)
    kept = one.space.violation(poses) == 0
    assert kept.any()
    for pose in poses[kept][:10]:
        again = one.space.poses(point_of(one, renamed(one.rig(pose), rng))[None])[0]
        assert sorted(map(tuple, np.round(again, 6).tolist())) == sorted(map(tuple, np.round(pose, 6).tolist()))


@pytest.mark.parametrize(
    ("name", "axis", "value", "said"),
    [
        ("roof_0", 2, 2.5, "roof_0: z is 2.5 m; allowed: 1 m to 2 m"),
        ("roof_1", 4, -12, "roof_1: pitch is -12°; allowed: -10° to 10°"),
        ("side_0", 2, 1.2, "side_0: z is 1.2 m; allowed: 1 m"),
        ("side_0", 5, 25, "side_0: yaw is 25°; allowed: 20°"),
        ("side_1", 0, 1.9, "side_1: x is 1.9 m; allowed: 1.5 m, as the mirror image of its pair"),
    ],
)
def test_what_is_outside_is_refused_with_its_coordinate(study, name, axis, value, said):
    one = study(BOX)
    rig = one.rig(one.space.midpoint)
    point_of(one, rig)
    with pytest.raises(ConfigError) as caught:
        point_of(one, replace(moved(rig, name, axis, value), name="mine"))
    assert str(caught.value) == f"mine: {said}"


def test_other_sensors_and_broken_constraints_are_refused(study):
    one = study(BOX)
    other = study(BOX.replace("fan-8", "fan-16"))
    with pytest.raises(ConfigError, match=r"its sensors are fan-16, fan-16, .*; the study's are fan-4, fan-4, fan-8"):
        point_of(one, other.rig(other.space.midpoint))
    near = study(BOX + "constraints: {min_distance_m: 0.5}\n")
    with pytest.raises(ConfigError, match="breaks the constraints"):
        point_of(near, near.rig(near.space.midpoint))  # both on the roof are in its middle


@pytest.mark.parametrize("method", ["abc", "annealing", "auto"])
def test_no_result_is_worse_than_a_start(study, method):
    """A good rig, beside which a search of a few evaluations finds nothing; and the search goes on from it."""
    one = with_solver(study(BOX), method=method)
    good = optimize(with_solver(one, method="annealing", evaluations=3000), threads=2)
    few = with_solver(one, evaluations=20)
    assert optimize(few, threads=2).objective > good.objective
    found = optimize(few, threads=2, starts=[good.rig])
    assert found.objective <= good.objective
    again = optimize(few, threads=1, log=found.log)
    assert again.rig == found.rig
    with pytest.raises(ConfigError, match="no more rigs to start with"):
        optimize(few, log=found.log, starts=[good.rig])


@pytest.mark.slow
def test_a_start_that_meets_all_requirements_is_the_least_that_is_found(study):
    text = CRATES.replace("{{", "{").replace("}}", "}").replace("{returns}", "60").replace("{lost}", "0")
    one = study(text.replace("{more}", "").replace("[0.5, 0.5, 1]", "[1, 1, 1]").replace("[1, 2]", "[1, 2.5]"))
    good = optimize(one, threads=2)
    assert good.verdict.passed
    found = optimize(with_solver(one, evaluations=1), threads=2, starts=[good.rig])
    assert found.verdict.passed
    assert found.objective >= good.objective  # the least margin


def test_a_start_belongs_to_the_combination_with_its_models(study):
    one = study(CHOICE.replace("RETURNS", "10"))
    ones = distinct_combinations(one)
    for number, each in enumerate(ones):
        chosen = each.study
        (found,) = points_by_combination(ones, [chosen.rig(chosen.space.midpoint)])
        assert found == number
    strange = study(BOX)
    with pytest.raises(ConfigError, match="no combination of the study has the sensors fan-4, fan-4, fan-8"):
        points_by_combination(ones, [strange.rig(strange.space.midpoint)])


@pytest.mark.slow
def test_searches_that_choose_begin_with_a_start(study):
    """The dearest combination's rig is verified first, then the search goes down from there; and so does a front."""
    one = study(CHOICE.replace("RETURNS", "300").replace("13000", "14000"))
    dearest = distinct_combinations(one)[-1].study
    rig = dearest.rig(dearest.space.midpoint)
    said = []
    found = cheapest(one, 2, lambda run: said.append(run.doing), rigs=[rig])
    assert dearest.name in said[0]
    assert found.combination.price <= 14000
    ordinary = CHOICE[: CHOICE.index("requirements:")] + "solver: {method: annealing, evaluations: 60}\n"
    points = front(study(ordinary), threads=2, rigs=[rig])
    assert points.log.records[[o.name for o in distinct_combinations(study(ordinary))].index(dearest.name)] is not None


@pytest.mark.slow
def test_the_command_begins_with_rigs(tmp_path, blank_pictures):
    (tmp_path / "study.yaml").write_text(BOX)
    one = load_study(tmp_path / "study.yaml")
    lidarcfg("optimize", "study.yaml", "--evaluations", 400, "-o", "good", "--quiet", cwd=tmp_path)
    words = ("optimize", "study.yaml", "--evaluations", 5, "-o", "out")
    lidarcfg(*words, "--start", "good/rig.yaml", "--quiet", cwd=tmp_path)
    lidarcfg("optimize", "study.yaml", "--resume", "out", "--evaluations", 10, "--quiet", cwd=tmp_path)
    done = lidarcfg(*words, "--start", "good/rig.yaml", "--resume", "out", code=2, cwd=tmp_path)
    assert "--start is for a search that begins" in done.stderr
    text = (tmp_path / "good/rig.yaml").read_text()
    assert one.space.upper[0, 2] == 2
    lines = [line for line in text.splitlines() if "position_m" in line]
    (tmp_path / "high.yaml").write_text(text.replace(lines[0], "  position_m: [6, 4, 2.5]"))
    done = lidarcfg(*words, "--start", "high.yaml", code=2, cwd=tmp_path)
    assert "high.yaml: roof_0: z is 2.5 m; allowed: 1 m to 2 m" in done.stderr
