"""The combinations searched for the cheapest rig: on the terminal, as a CSV file, in the report, and as a log."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lidarcfg.clouds.cloud import read_arrays
from lidarcfg.errors import CloudError, ConfigError
from lidarcfg.files import remove_outdated, replacing
from lidarcfg.geometry import Array
from lidarcfg.report.describe import counted, price
from lidarcfg.report.results import FRONT, RESULTS, fingerprint
from lidarcfg.report.rig_report import ChoicePart
from lidarcfg.report.table import COUNT, NOTHING, PRICE, Cell, Column, Table, named
from lidarcfg.report.terminal import print_table, terminal
from lidarcfg.report.text import truncate
from lidarcfg.search.cheapest import Cheapest, CheapestLog, Effort, SearchedCombination
from lidarcfg.search.run import Check, Log
from lidarcfg.study.study import Study

COMBINATIONS = "combinations.csv"
SHOWN = 20  # combinations on the terminal and in the report


def combinations_table(found: Cheapest, tried: Sequence[SearchedCombination]) -> Table:
    """A row for each combination, with a column for each group of sensors that are chosen."""
    columns = [
        Column("price", PRICE),
        *(Column(truncate(name), key=name) for name in found.groups),
        Column("sensors", COUNT),
        Column("verdict"),
        Column("short by", ".0%", key="worst"),
        Column("shortfall", ".6g"),
        Column("misses", key="missed"),
        Column("rigs", COUNT),
        Column("excluded"),
        Column("name"),
    ]
    rows = [
        [
            one.price,
            *(Cell(models or "none", models or NOTHING) for models in one.models),
            one.sensors,
            _verdict(one),
            _short(one),
            _finite(one.shortfall),
            Cell("; ".join(one.failing), ", ".join(map(truncate, one.failing))),
            one.evaluations,
            one.excluded or "",
            named(one.name),
        ]
        for one in tried
    ]
    caption = "Cheaper combinations, the closest first" if found.meets else "The combinations that come closest"
    return Table(caption, columns, rows)


def _short(one: SearchedCombination) -> Cell:
    """How far the best rig's worst place falls short."""
    between = one.worst <= 0 and not one.meets
    return Cell(_finite(one.worst), "places between" if between else f"{max(one.worst, 0):.0%}")


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def save_combinations(found: Cheapest, folder: Path) -> None:
    """Write combinations.csv: a line for each, by price; empty cells where a combination was not looked at."""
    with replacing(folder / COMBINATIONS) as file:
        combinations_table(found, found.tried).write_csv(file)


def print_cheapest(found: Cheapest) -> None:
    """Print the answer, then the cheaper combinations that come closest, or the closest if none meets all."""
    console = terminal()
    console.print(_answer(found))
    console.print(_searched(found))
    table = _shown_table(found)
    if table.rows:
        print_table(table, table.caption)
    if (more := len(_shown(found)) - SHOWN) > 0:
        console.print(f"and {more:,} more: see {COMBINATIONS}")
    first = next((one for one in found.tried if one.excluded), None)
    if first:
        console.print(f"{counted(found.excluded, 'combination')} cannot meet all, such as {', '.join(_models(first))}:")
        console.print(f"{first.excluded}; the others are in {COMBINATIONS}")


def choice_part(found: Cheapest, command: str) -> ChoicePart:
    """The part of the report; `command` goes on with the search."""
    return ChoicePart(
        answer=_answer(found),
        searched=f"{_searched(found)}. {COMBINATIONS} has all of them.",
        table=_shown_table(found),
        again=None if found.meets else command,
    )


def _shown_table(found: Cheapest) -> Table:
    """The first combinations to show, in the columns that people read."""
    table = combinations_table(found, _shown(found)[:SHOWN])
    return table.without("sensors", "verdict", "shortfall", "excluded", "name")


def _answer(found: Cheapest) -> str:
    asked = found.combination
    if found.meets:
        return f"the cheapest rig found that meets all requirements: {asked.sensors}, for {price(asked.price)}"
    return f"no rig found meets all requirements; {asked.sensors}, for {price(asked.price)}, comes closest"


def _searched(found: Cheapest) -> str:
    looked_at = sum(math.isfinite(one.worst) for one in found.tried)
    rigs = sum(one.evaluations for one in found.tried)
    all_of_them = counted(found.combinations, "combination")
    return f"{looked_at:,} of {all_of_them} looked at; {counted(rigs, 'rig')} evaluated, {found.seconds:.1f} s"


def _shown(found: Cheapest) -> list[SearchedCombination]:
    """The combinations to show, the closest first; if one meets all, only those that cost less."""
    most = found.combination.price if found.meets else math.inf
    looked_at = [one for one in found.tried if math.isfinite(one.worst) and one.price < most and not one.excluded]
    return sorted(looked_at, key=lambda one: (one.worst, one.price))


def _models(one: SearchedCombination) -> list[str]:
    return [models for models in one.models if models]


def _verdict(one: SearchedCombination) -> str:
    if one.excluded:
        return "cannot meet all"
    if not math.isfinite(one.worst):
        return "not looked at"
    return "meets all" if one.meets else "misses"


def save_cheapest_log(study: Study, log: CheapestLog, folder: Path) -> None:
    """Write search.npz, from which the search for the cheapest rig can resume."""
    state = {
        "efforts": [_effort_dict(number, one) for number, one in log.efforts.items()],
        "turns": list(log.turns.items()),
        "places": _places_list(log.places),
        "excluded": list(log.excluded.items()),
    }
    with replacing(folder / "search.npz", "wb") as file:
        np.savez_compressed(file, asked=fingerprint(study), state=json.dumps(state))


def save_cheapest_progress(study: Study, log: CheapestLog, folder: Path) -> None:
    """Write search.npz of a search that goes on; other results of an earlier search in the folder are removed."""
    remove_outdated(folder / name for name in {*RESULTS, *FRONT, COMBINATIONS} if name != "search.npz")
    save_cheapest_log(study, log, folder)


def load_cheapest_log(study: Study, folder: Path) -> CheapestLog:
    """The log in a folder's search.npz. Raises ConfigError if it is not one, or belongs to another search."""
    path = folder / "search.npz"
    try:
        arrays = read_arrays(path, ("asked", "state"))
    except CloudError as error:
        raise ConfigError(str(error)) from None
    if any(array.dtype.kind != "U" or array.ndim for array in arrays.values()):
        raise ConfigError(f"{path}: is not the log of a search for the cheapest rig")
    if str(arrays["asked"]) != fingerprint(study):
        raise ConfigError(f"{path}: is of another search; study, solver and seed must be the same, but for the budget")
    try:
        return _log_of(json.loads(str(arrays["state"])))
    except (ValueError, TypeError, KeyError, AttributeError):
        raise ConfigError(f"{path}: is not the log of a search for the cheapest rig") from None


def _places_list(places: Any) -> list[tuple[int, list[list[float]]]]:
    return [(number, some.tolist()) for number, some in places.items()]


def _places_of(values: Any) -> dict[int, Array]:
    return {int(number): np.array(some, np.float64).reshape(-1, 4) for number, some in values}


def _effort_dict(number: int, one: Any) -> dict[str, Any]:
    log = one.log
    return {
        "option": number,
        "cost": log.cost.tolist(),
        "seconds": log.seconds,
        "points": log.points.tolist(),
        "given": log.given,
        "checks": [(check.told, check.passed, _places_list(check.places), check.drawn) for check in log.checks],
        "start_places": _places_list(one.start_places),
        "places": _places_list(one.places),
        "evaluations": one.evaluations,
        "rigs": one.rigs,
        "x": one.x.tolist(),
        "worst": one.worst,
        "shortfall": one.shortfall,
        "failing": one.failing,
        "meets": one.meets,
    }


def _log_of(state: Any) -> CheapestLog:
    """The log that a state says. Raises ValueError, TypeError or KeyError if it is none."""
    efforts = {}
    for one in state["efforts"]:
        x = np.array(one["x"], np.float64)
        checks = tuple(
            Check(int(told), bool(passed), _places_of(some), bool(drawn)) for told, passed, some, drawn in one["checks"]
        )
        cost = np.array(one["cost"], np.float64).reshape(-1, 2)
        points = np.array(one["points"], np.float64).reshape(-1, len(x))
        efforts[int(one["option"])] = Effort(
            log=Log(cost, float(one["seconds"]), points, int(one["given"]), checks),
            start_places=_places_of(one["start_places"]),
            places=_places_of(one["places"]),
            evaluations=int(one["evaluations"]),
            rigs=int(one["rigs"]),
            x=x,
            worst=float(one["worst"]),
            shortfall=float(one["shortfall"]),
            failing=tuple(map(str, one["failing"])),
            meets=bool(one["meets"]),
        )
    return CheapestLog(
        efforts=efforts,
        turns={int(number): int(count) for number, count in state["turns"]},
        places=_places_of(state["places"]),
        excluded={int(number): str(why) for number, why in state["excluded"]},
    )
