"""Python's way to studies, plans and rigs: by their files, or loaded; the same as the commands' way."""

from pathlib import Path

import numpy as np
import pytest

import lidarcfg
from lidarcfg.errors import ConfigError
from lidarcfg.study import evaluation

RETURNS = """region: {min_m: [-9, -6, 0], max_m: [9, 6, 2], cuboid_m: [1, 1, 0.5]}
sensors:
  - {model: vlp-16, min: {position_m: [-1, 0, 1.5], rpy_deg: [0, 0, 0]}, max: {position_m: [1, 0, 1.5], rpy_deg: [0, 0, 0]}}
detection: [{name: child, size_m: [0.4, 0.4, 1.0], returns: 5, on_ground: true}]
solver: {method: annealing, evaluations: 20}
"""
RIG = """name: one
sensors:
  - {name: a, model: vlp-16, position_m: [0, 0, 1.5], rpy_deg: [0, 0, 0]}
"""


@pytest.fixture
def files(tmp_path):
    for name, text in (("study", RETURNS), ("rig", RIG), ("plan", "study: study.yaml\nvary: {solver.seed: [1, 2]}")):
        (tmp_path / f"{name}.yaml").write_text(text)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("kind", [str, Path])
def test_a_file_is_as_good_as_what_is_loaded_from_it(files, kind):
    study = kind(files / "study.yaml")
    rig = kind(files / "rig.yaml")
    loaded = lidarcfg.load_study(study), lidarcfg.load_rig(rig)
    found = lidarcfg.evaluate(study, rig)
    known = evaluation.evaluate(*loaded)
    assert np.array_equal(found.vsr_m, known.vsr_m)
    assert found.detection["child"] == known.detection["child"]
    assert lidarcfg.optimize(study).rig == lidarcfg.optimize(loaded[0], threads=1).rig


def test_what_is_wrong_in_a_file_is_said_with_its_line(files):
    (files / "rig.yaml").write_text(RIG.replace("vlp-16", "vlp-17"))
    with pytest.raises(ConfigError, match=r"rig\.yaml:3:\d+: .*vlp-17"):
        lidarcfg.evaluate(files / "study.yaml", files / "rig.yaml")
    with pytest.raises(ConfigError, match=r"none\.yaml: no such file"):
        lidarcfg.optimize(files / "none.yaml")
