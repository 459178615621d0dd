"""search.npz: the log of a search, whatever it chose, from which --resume goes on.

It holds records of candidates, of which a study without a choice has one; each has the logs of its searches, and these
have costs, points and checks. All of one kind are the rows of one array, in this order; what they belong to says how
many of them it has. The places at which rigs of any candidate failed come behind all others.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.clouds.cloud import read_arrays
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import replacing
from lidarcfg.search.log import Check, Log, Places, Record, SearchLog
from lidarcfg.solvers.solver import BUDGETS
from lidarcfg.study.study import Study

SEARCH_LOG = "search.npz"
TURNS_MAX = 64  # each is longer than all before
FLOAT = np.dtype(np.float64)


def _counts(names: str) -> list[tuple[str, Any]]:
    """Fields of whole numbers."""
    return [(name, np.int64) for name in names.split()]


RECORD = np.dtype([*_counts("candidate logs turns evaluations rigs coordinates shortfalls"), ("worst", FLOAT)])
LOG = np.dtype([*_counts("costs points coordinates given places checks"), ("seconds", FLOAT)])
CHECK = np.dtype([*_counts("told places"), ("passed", np.bool_), ("drawn", np.bool_)])
PLACE = np.dtype([*_counts("requirement"), ("pose", FLOAT, 4)])
ARRAYS = {  # types and dimensions
    "asked": ("texts", 0),  # see fingerprint
    "records": (RECORD, 1),
    "excluded": ("texts", 1),  # of records
    "x": (FLOAT, 1),
    "shortfalls": (FLOAT, 1),
    "logs": (LOG, 1),
    "cost": (FLOAT, 2),
    "points": (FLOAT, 1),
    "checks": (CHECK, 1),
    "places": (PLACE, 1),
}


def save_log(study: Study, log: SearchLog, folder: Path) -> None:
    """Write search.npz."""
    with replacing(folder / SEARCH_LOG, "wb") as file:
        np.savez_compressed(file, asked=fingerprint(study), **_arrays(log))


def load_log(study: Study, folder: Path) -> SearchLog:
    """The log in a folder's search.npz. Raises ConfigError if it is not one, or belongs to another search."""
    path = folder / SEARCH_LOG
    try:
        arrays = read_arrays(path, ARRAYS)
    except CloudError as error:
        raise ConfigError(str(error)) from None
    dtypes = {key: "texts" if np.issubdtype(one.dtype, np.str_) else one.dtype for key, one in arrays.items()}
    kinds = {key: (dtypes[key], one.ndim) for key, one in arrays.items()}
    try:
        _check(kinds == ARRAYS)
        found = _LogReader(arrays).log()
        _check(study.to_choose or [len(one.logs) for one in found.records.values()] == [1])
    except ValueError:
        raise ConfigError(f"{path}: is not the log of a search") from None
    if str(arrays["asked"]) != fingerprint(study):
        raise ConfigError(f"{path}: is of another search; study, solver and seed must be the same, but for the budget")
    return found


def fingerprint(study: Study) -> str:
    """Everything that determines the course of a search, as one text: the study without its budgets."""
    solver = {key: value for key, value in study.file["solver"].items() if key not in BUDGETS}
    return json.dumps(study.file | {"solver": solver}, sort_keys=True)


def _arrays(log: SearchLog) -> dict[str, Any]:
    records = {n: one for n, one in log.records.items() if one.logs or one.turns or one.excluded}
    logs = [each for one in records.values() for each in one.logs]
    checks = [check for each in logs for check in each.checks]
    places = [part for each in logs for part in (each.start_places, *(check.places for check in each.checks))]
    xs = [np.empty(0) if one.x is None else one.x for one in records.values()]
    points = [np.empty((0, 0)) if each.points is None else each.points for each in logs]
    return {
        "records": np.array(
            [
                (n, len(one.logs), one.turns, one.evaluations, one.rigs, len(x), len(one.shortfalls), one.worst)
                for (n, one), x in zip(records.items(), xs, strict=True)
            ],
            RECORD,
        ),
        "excluded": np.array([one.excluded for one in records.values()], np.str_),
        "x": np.concatenate([np.empty(0), *xs]),
        "shortfalls": np.concatenate([np.empty(0), *(one.shortfalls for one in records.values())]),
        "logs": np.array(
            [
                (len(each.cost), *own.shape, each.given, _count(each.start_places), len(each.checks), each.seconds)
                for each, own in zip(logs, points, strict=True)
            ],
            LOG,
        ),
        "cost": np.concatenate([np.empty((0, 2)), *(each.cost for each in logs)]),
        "points": np.concatenate([np.empty(0), *(own.ravel() for own in points)]),
        "checks": np.array([(one.told, _count(one.places), one.passed, one.drawn) for one in checks], CHECK),
        "places": np.concatenate([np.empty(0, PLACE), *map(_rows, [*places, log.places])]),
    }


def _count(places: Places) -> int:
    return sum(map(len, places.values()))


def _rows(places: Places) -> NDArray[Any]:
    """Places as rows of their array."""
    rows = np.empty(_count(places), PLACE)
    rows["requirement"] = [number for number, some in places.items() for _ in some]
    rows["pose"] = np.concatenate([np.empty((0, 4)), *places.values()])
    return rows


class _LogReader:
    """Reads the rows of arrays in their order."""

    def __init__(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._left = dict(arrays)
        _check(len(arrays["records"]) == len(arrays["excluded"]) and arrays["cost"].shape[1:] == (2,))
        _check(not np.isnan(arrays["cost"]).any() and not np.isnan(arrays["shortfalls"]).any())
        _check(all(np.isfinite(some).all() for some in (arrays["x"], arrays["points"], arrays["places"]["pose"])))

    def log(self) -> SearchLog:
        """The log. Raises ValueError where the numbers of rows do not fit."""
        each = zip(self._take("records", None), self._take("excluded", None).tolist(), strict=True)
        records = {int(row["candidate"]): self._record(row, excluded) for row, excluded in each}
        places = _places(self._take("places", None))
        _check(not any(len(rows) for name, rows in self._left.items() if name != "asked"))
        return SearchLog(records, places)

    def _take(self, name: str, count: int | None) -> NDArray[Any]:
        """So many of the rows that are left, or all."""
        rows = self._left[name]
        count = len(rows) if count is None else count
        _check(0 <= count <= len(rows))
        self._left[name] = rows[count:]
        return rows[:count]

    def _record(self, row: Any, excluded: str) -> Record:
        _, logs, turns, evaluations, rigs, coordinates, shortfalls, worst = row.tolist()
        _check(0 <= turns <= TURNS_MAX and evaluations >= 0 and rigs >= 0 and worst == worst)
        x = self._take("x", coordinates)
        return Record(
            logs=tuple(map(self._log, self._take("logs", logs))),
            turns=turns,
            excluded=excluded,
            evaluations=evaluations,
            rigs=rigs,
            x=x if shortfalls else None,
            worst=worst,
            shortfalls=self._take("shortfalls", shortfalls),
        )

    def _log(self, row: Any) -> Log:
        costs, points, coordinates, given, places, checks, seconds = row.tolist()
        _check(min(points, coordinates) >= 0 and 0 <= given <= points and 0 <= seconds < np.inf)
        begun = self._take("points", points * coordinates).reshape(points, coordinates)
        return Log(
            cost=self._take("cost", costs),
            seconds=seconds,
            points=begun if points else None,
            given=given,
            start_places=_places(self._take("places", places)),
            checks=tuple(map(self._check, self._take("checks", checks))),
        )

    def _check(self, row: Any) -> Check:
        told, places, passed, drawn = row.tolist()
        return Check(told, passed, _places(self._take("places", places)), drawn)


def _places(rows: NDArray[Any]) -> Places:
    """Places by requirement."""
    number = rows["requirement"]
    return {n: rows["pose"][number == n] for n in dict.fromkeys(number.tolist())}


def _check(is_right: bool) -> None:
    """Raises ValueError."""
    if not is_right:
        raise ValueError
