"""A plan of a sweep: a study, some of its keys and the values that they take, and a run for every combination."""

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import chain, permutations, product
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, model_validator

from lidarcfg import core
from lidarcfg.config.document import Document, Key, document
from lidarcfg.config.models import Model, checked, error_at, validation_error
from lidarcfg.errors import ConfigError
from lidarcfg.files import example
from lidarcfg.search.workers import versions
from lidarcfg.study.file import StudyFile
from lidarcfg.study.loading import check_firing, study_of
from lidarcfg.study.study import Study

RUNS_MAX = 100_000
PATH = re.compile(r"[^.\[\]]+(\[\d{1,9}\])*(\.[^.\[\]]+(\[\d{1,9}\])*)*")
PART = re.compile(r"([^.\[\]]+)|\[(\d+)\]")
SHOWN = 40  # characters of a value in a message
KEPT = 4  # studies in memory
Values = dict[str, Any]  # of a study's keys, by path
Varied = list[tuple[str, Key]]  # the paths that a run varies, and where in the plan each value is


class PlanFile(Model):
    """A plan's file."""

    kind = "plan"
    study: Any  # its file, relative to the plan's; or the study itself
    vary: dict[str, tuple[Any, ...]] = Field(default_factory=dict)  # values by path: every combination is a run
    together: tuple[Values, ...] = ()  # rows of values by path: keys that change together

    @property
    def paths(self) -> dict[str, Key]:
        """The place of each varied path in the plan, in the order of the runs: the last path changes fastest."""
        rows = {path: ("together", 0, path) for path in (self.together[0] if self.together else ())}
        return rows | {path: ("vary", path) for path in self.vary}

    @property
    def count(self) -> int:
        """How many runs it asks for."""
        return math.prod(map(len, self.vary.values())) * max(len(self.together), 1)

    @property
    def grid(self) -> Iterator[Varied]:
        """The places in the plan of each run's values."""
        rows: list[Varied] = [[(path, ("together", i, path)) for path in row] for i, row in enumerate(self.together)]
        axes = [rows] if rows else []
        axes += [[[(path, ("vary", path, i))] for i in range(len(values))] for path, values in self.vary.items()]
        return (list(chain.from_iterable(choice)) for choice in product(*axes))

    @model_validator(mode="after")
    def _check(self) -> "PlanFile":
        if not isinstance(self.study, str | dict):
            raise validation_error("is neither the name of a study's file nor a study", "study")
        if not self.vary and not self.together:
            raise validation_error("missing; give vary or together")
        for i, row in enumerate(self.together):
            if not row or row.keys() != self.together[0].keys():
                raise validation_error(
                    "other keys than in the first row; every row gives the same, and at least one", "together", i
                )
        _check_values(self.together, ("together",))
        for path, values in self.vary.items():
            if not values:
                raise validation_error("has no values; allowed: at least one", "vary", path)
            _check_values(values, ("vary", path))
            if self.together and path in self.together[0]:
                raise validation_error("is also in together; give it in only one of them", "vary", path)
        self._check_paths()
        if self.count > RUNS_MAX:
            what = f"asks for {self.count:,} runs; allowed: at most {RUNS_MAX:,}"
            raise validation_error(what, "vary" if self.vary else "together")
        return self

    def _check_paths(self) -> None:
        for path, at in self.paths.items():
            if not PATH.fullmatch(path):
                raise validation_error("is not the path of a key, such as sensors[0].count", *at)
        for above, path in permutations(self.paths, 2):
            if parsed(above) == parsed(path)[: len(parsed(above))]:
                raise validation_error(
                    f"is a part of {above}, which also varies; vary only one of them", *self.paths[path]
                )


def _check_values(values: tuple[Any, ...], at: Key) -> None:
    """A model's validator: no two values are equal."""
    seen = set()
    for i, value in enumerate(values):
        if (text := json.dumps(_normal(value), sort_keys=True)) in seen:
            raise validation_error(f"{shown(value)} is there already; each may be given once", *at, i)
        seen.add(text)


def _normal(value: Any) -> Any:
    """The value with whole floats as integers, so that equal numbers compare equal."""
    if isinstance(value, dict):
        return {key: _normal(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_normal(item) for item in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def parsed(path: str) -> Key:
    """The key that a path means: ("sensors", 0, "count") for sensors[0].count."""
    return tuple(name or int(number) for name, number in PART.findall(path))


def shown(value: Any) -> str:
    """A value as a short text for a message."""
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= SHOWN else text[: SHOWN - 1] + "…"


@dataclass(frozen=True)
class SweepCase:
    """A case of a sweep: the study of one combination of a plan's values."""

    number: int  # from 1, in the order of the plan
    values: Values
    file: StudyFile
    digest: str  # of all that its result depends on: the study, the files that it names, the versions


@dataclass(frozen=True)
class SweepPlan:
    """A plan all of whose runs are possible."""

    path: Path
    study: str  # the study's file as the plan names it; empty for an inline study
    varied: tuple[str, ...]  # paths
    runs: tuple[SweepCase, ...]
    studies: "Studies"


class Studies:
    """Makes the studies of a plan's runs; keeps the last few in memory."""

    def __init__(self, path: Path) -> None:
        """`path` is the file of the base study; for an inline study, the plan's."""
        self.path = path
        self._kept: dict[str, Study] = {}
        self._digests: dict[str, str] = {}
        self._versions = versions()

    def of(self, file: StudyFile) -> Study:
        """The study of a run. Raises ConfigError."""
        key = file.model_dump_json(exclude={"solver"})
        if key not in self._kept:
            self._kept = dict([*self._kept.items()][1 - KEPT :])
            self._kept[key] = study_of(file, self.path)
        solver = {"solver": file.solver.model_dump(mode="json", exclude_none=True)}
        return replace(self._kept[key], solver=file.solver, file=self._kept[key].file | solver)

    def digest(self, file: StudyFile) -> str:
        """A digest of everything that the run's result depends on. Raises ConfigError if the run is impossible."""
        key = file.model_dump_json(exclude={"solver"})
        if key not in self._digests:
            study = self.of(file)
            if study.to_choose:
                what = "choose gives a front, not one rig; vary sensors[…].model instead, or optimize the study"
                raise error_at(self.path, ("sensors",), what)
            if not study.space.free.any():
                raise error_at(self.path, ("sensors",), "nothing is free to move; every bound is equal")
            check_firing(study, self.path)
            content = hashlib.sha256()
            for field in fields(study):
                if field.name != "solver":
                    _update(content, getattr(study, field.name) if field.name != "file" else study.file | {"solver": 0})
            self._digests[key] = content.hexdigest()
        text = json.dumps([self._digests[key], file.solver.model_dump_json(), self._versions])
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _update(content: "hashlib._Hash", value: Any) -> None:
    """Add a value, with all of its parts, to a digest."""
    if isinstance(value, np.ndarray):
        content.update(f"{value.dtype} {value.shape}".encode())
        content.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, core.world.Bvh):
        _update(content, (value.shapes, value.kind, value.number, value.object))
    elif isinstance(value, core.world.Obstacles):
        _update(content, (value.tree, value.boxes, value.origin_m, value.ground_m))
    elif isinstance(value, BaseModel):
        content.update(value.model_dump_json().encode())
    elif is_dataclass(value):
        content.update(type(value).__name__.encode())
        for field in fields(value):
            if field.compare:
                _update(content, getattr(value, field.name))
    elif isinstance(value, dict):
        for key in sorted(value):
            _update(content, (key, value[key]))
    elif isinstance(value, tuple | list):
        content.update(f"({len(value)}".encode())
        for item in value:
            _update(content, item)
    else:
        content.update(f"{getattr(value, '__qualname__', None) or repr(value)},".encode())


def load_plan(path: str | Path, on_checked: Callable[[int, int], None] | None = None) -> SweepPlan:
    """The plan in a YAML file. Every study of it is read; `on_checked` is told how many of how many runs are.

    Raises ConfigError with file, line and key.
    """
    path = example(path)
    plan = document(path)
    file = checked(plan, PlanFile)
    inline = isinstance(file.study, dict)
    studies = Studies(path if inline else path.parent / file.study)
    base = plan.replaced((), plan, ("study",)) if inline else _named(plan, studies.path)
    for varied, at in file.paths.items():
        _check_place(base, varied, plan, at)
    runs = []
    for number, places in enumerate(file.grid, 1):
        runs.append(_run(number, places, plan, base, studies))
        if on_checked:
            on_checked(number, file.count)
    return SweepPlan(path, "" if inline else file.study, tuple(file.paths), tuple(runs), studies)


def _named(plan: Document, path: Path) -> Document:
    """The file of the study that the plan names. Raises ConfigError."""
    if not path.is_file():
        raise plan.error(("study",), f"{path}: no such file")
    return document(path)


def _check_place(base: Document, path: str, plan: Document, at: Key) -> None:
    """Raises ConfigError where the study has no place for the value at a path."""
    value = base.value
    for part in parsed(path):
        if isinstance(part, int):
            if not isinstance(value, tuple):
                raise plan.error(at, f"the study has no list before [{part}]")
            if part >= len(value):
                raise plan.error(at, f"the study's list has no [{part}]; it ends with [{len(value) - 1}]")
            value = value[part]
        else:
            if not isinstance(value, dict | None):
                raise plan.error(at, f"what is before {part} is not a map of keys in the study")
            value = (value or {}).get(part)


def _run(number: int, places: Varied, plan: Document, base: Document, studies: Studies) -> SweepCase:
    """A run of the plan. Raises ConfigError where it is not possible."""
    varied = base
    for path, at in places:
        varied = varied.replaced(parsed(path), plan, at)
    values = {path: plan.at(at) for path, at in places}
    try:
        file = checked(varied, StudyFile)
        try:
            digest = studies.digest(file)
        except ConfigError as error:  # at a key that may have been replaced, and so is in the plan
            if error.at and error.at[0] == str(studies.path):
                raise varied.error(*error.at[1:]) from None
            raise
    except ConfigError as error:
        raise _placed(error, plan, base, places, values) from None
    return SweepCase(number, values, file, digest)


def _placed(error: ConfigError, plan: Document, base: Document, places: Varied, values: Values) -> ConfigError:
    """The error of a run's study, at the value in the plan that causes it; else with all values of the run."""
    name, key, what = error.at or ("", (), "")
    if name == plan.name and key[:1] in (("vary",), ("together",)):
        return error
    for path, at in places:
        top = parsed(path)[0]
        if key and key[-1] == top and top not in base.value:  # a key that only the path has added
            return plan.error(at, f"{top}: {what}")
    where = ", ".join(f"{path}: {shown(value)}" for path, value in values.items())
    return ConfigError(f"{error} (with {where})")
