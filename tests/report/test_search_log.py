"""search.npz: a log that is read back is the one that was written, and what is none is refused."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from lidarcfg.errors import ConfigError
from lidarcfg.report.search_log import load_log, save_log
from lidarcfg.search.log import Check, Log, Record, SearchLog
from lidarcfg.study.loading import load_study
from tests.report.test_front import STUDY

PLACES = {3: np.array([[1.0, 2, 0, 0.5], [4, 5, 6, 7]]), 0: np.array([[8.0, 9, 0, 1]])}
SEARCHED = Log(
    cost=np.array([[0.0, 0.1 + 0.2], [2.0, np.inf], [np.inf, np.inf]]),
    seconds=2.5,
    points=np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]),
    given=1,
    start_places={1: np.array([[1.0, 1, 1, 1]])},
    checks=(Check(2, False, PLACES, drawn=True), Check(3, True, {})),
)
FIXED = Log(np.array([[0.0, 1.0]]), 0.0, points=np.empty((2, 0)))
CHOICE = SearchLog(
    {
        0: Record(excluded="too dear"),
        2: Record((SEARCHED,), 3, "", 360, 400, np.array([0.25, 0.75]), 0.5, np.array([0.0, 1 / 3])),
        3: Record((FIXED,), 1, "", 0, 1, np.empty(0), np.inf, np.full(2, np.inf)),
        4: Record((Log.empty(), SEARCHED)),
        7: Record(turns=1, excluded="child: no range exceeds 3 m"),
    },
    {5: np.array([[0.0, 1, 2, 3]])},
)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "study.yaml"
    path.write_text(STUDY)
    return load_study(path)


def plain(value):
    """Dataclasses and arrays as lists and numbers, which can be compared."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, dict):
        return [(key, plain(one)) for key, one in value.items()]  # the order counts
    if isinstance(value, tuple):
        return [plain(one) for one in value]
    return (value.shape, value.tolist()) if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize("log", [CHOICE, SearchLog({}), SearchLog.of(SEARCHED)], ids=["choice", "nothing", "one"])
def test_what_is_read_back_is_what_was_written(log, study, tmp_path):
    save_log(study, log, tmp_path)
    assert plain(load_log(study, tmp_path)) == plain(log)


def changed(rows, **values):
    """The rows with other values in the field of the last."""
    rows = rows.copy()
    for field, value in values.items():
        rows[field][-1] = value
    return rows


def test_what_is_no_log_is_refused(study, tmp_path):
    save_log(study, CHOICE, tmp_path)
    with np.load(tmp_path / "search.npz") as file:
        good = dict(file)
    odd = [
        *({"cost": one} for one in (np.float64(3), np.ones(2), np.ones((7, 3)), np.ones((7, 2), bool))),
        *({"cost": one} for one in (good["cost"].astype(complex), np.full((7, 2), np.nan), good["cost"][1:])),
        *({"logs": changed(good["logs"], seconds=value)} for value in (np.inf, np.nan, -1)),
        *({"logs": changed(good["logs"], given=value)} for value in (-1, 4)),
        *({"logs": changed(good["logs"], costs=value)} for value in (-1, 2, 4)),
        *({"logs": changed(good["logs"], points=value)} for value in (-1, 2, 4)),
        {"logs": changed(good["logs"], points=-3, coordinates=-2)},
        {"logs": changed(good["logs"], checks=3)},
        {"logs": good["logs"][:-1]},
        *({"records": changed(good["records"], turns=value)} for value in (-1, 10**9)),
        *({"records": changed(good["records"], **{key: -1})} for key in ("evaluations", "rigs", "logs", "coordinates")),
        {"records": changed(good["records"], worst=np.nan)},
        {"records": good["records"][:-1]},
        {"excluded": good["excluded"][:-1]},
        {"checks": np.ones((4, 4), int)},
        {"checks": changed(good["checks"], places=-1)},
        *({"places": one} for one in (np.ones((9, 6)), changed(good["places"], pose=np.nan))),
        *({key: good[key][:-1]} for key in ("x", "shortfalls", "points")),
        *({key: np.full_like(good[key], np.nan)} for key in ("x", "shortfalls", "points")),
        {"asked": np.ones(1)},
    ]
    for change in odd:
        np.savez(tmp_path / "search.npz", **good | change)
        with pytest.raises(ConfigError, match=r"search.npz: is not the log of a search"):
            load_log(study, tmp_path)
    for key in good:
        np.savez(tmp_path / "search.npz", **{name: array for name, array in good.items() if name != key})
        with pytest.raises(ConfigError, match=r"search.npz: is not the log of a search"):
            load_log(study, tmp_path)
    np.savez(tmp_path / "search.npz", **good)
    load_log(study, tmp_path)
