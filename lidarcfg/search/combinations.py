"""The combinations of sensors that a study lets one choose: each is an ordinary study with a price.

The sensors of a group are interchangeable, so a group's part of a combination is a multiset of its models; mirrored
sensors are chosen in pairs. A combination without any sensor is none, nor is one of which failures leave none.

Combinations learn from each other: the best rigs of one are starts for a local search in another.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidarcfg.config.models import NAME_MAX
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array
from lidarcfg.requirements.allowed_rigs import total_price
from lidarcfg.study.mounting import Choice, Slot, slot_name
from lidarcfg.study.study import Study

CHANGES_MAX = 2  # sensors exchanged, added and removed
DRAWS = 4  # of the pose of a sensor that is new
STARTS_MAX = 40
FOLDER_MAX = 80  # characters of a combination's name, which becomes a folder's


@dataclass(frozen=True)
class Combination:
    """One choice of sensors."""

    name: str
    price: float
    study: Study
    groups: tuple[int, ...]  # of the whole study, by slot
    group_names: tuple[str, ...]  # of the whole study

    @property
    def sensors(self) -> str:
        """The number of sensors of each model; of each group, if the whole study has several."""
        parts = []
        for i, name in enumerate(self.group_names):
            slots = [slot for slot, group in zip(self.study.slots, self.groups, strict=True) if group == i]
            counts = Counter(slot.sensor.name for slot in slots)
            text = ", ".join(f"{count} × {model}" for model, count in counts.items())
            if text:
                parts.append(f"{name}: {text}" if len(self.group_names) > 1 else text)
        return "; ".join(parts)


@dataclass(frozen=True)
class _Group:
    """A group of slots, and its choices."""

    values: dict[str, Any]  # in the study's file
    first: int  # its first slot
    together: int  # slots that are chosen as one

    @property
    def places(self) -> int:
        return int(self.values["count"]) // self.together


@dataclass(frozen=True)
class Option:
    """A combination that may be chosen; its study is made when it is asked for."""

    name: str
    price: float
    parent: Study
    chosen: tuple[tuple[Choice | None, ...], ...]  # by group
    sensors: int  # how many

    @property
    def all_sensors(self) -> list[str]:
        """The name of each sensor's model."""
        groups = _groups(self.parent)
        each = zip(groups, self.chosen, strict=True)
        return [choice.sensor.name for group, part in each for choice in part if choice for _ in range(group.together)]

    @property
    def models(self) -> tuple[str, ...]:
        """How many sensors of each model, by group; empty where there is none."""
        groups = _groups(self.parent)
        return tuple(_models(group, part) for group, part in zip(groups, self.chosen, strict=True))

    @property
    def combination(self) -> Combination:
        """The combination."""
        return _combination(self.parent, _groups(self.parent), self.chosen, self.name)


def combinations(study: Study) -> list[Combination]:
    """All combinations of a study that has choices, in the order of its groups and of their choices."""
    groups = _groups(study)
    return [_combination(study, groups, one.chosen, one.name) for one in options(study)]


def options(study: Study) -> list[Option]:
    """`combinations` as options, whose studies are not made yet."""
    groups = _groups(study)
    ways = [combinations_with_replacement(study.slots[group.first].choices, group.places) for group in groups]
    found: list[Option] = []
    needed = study.requirements.lost if study.requirements else 0
    least = 1 + max((study.robust and study.robust.lost) or 0, needed)  # some must be left
    names: Counter[str] = Counter()
    for chosen in product(*ways):
        prices = [
            choice.price
            for group, part in zip(groups, chosen, strict=True)
            for choice in part * group.together
            if choice
        ]
        if len(prices) >= least:
            name = _name(groups, chosen)
            names[name] += 1
            suffix = f"-{names[name]}" if names[name] > 1 else ""
            found.append(Option(name + suffix, total_price(prices), study, chosen, len(prices)))
    return found


def distinct_options(study: Study) -> list[Option]:
    """The options, cheapest first; of those that allow the same rigs one.

    The rigs are the same if groups with the same bounds and choices exchange their sensors. A mirror image of a rig is
    another one, however symmetric all else is: heads turn one way only, and tables of firings and of beams have two
    sides. With mounting errors that are drawn, each sensor has its own, and no two options are the same.
    """
    numbers = list(range(len(study.file["sensors"])))
    if not (study.robust and study.robust.drawn):
        places = [_place_of(study, group) for group in _groups(study)]
        numbers = [places.index(place) for place in places]
    found: dict[object, Option] = {}
    for one in options(study):
        chosen = [
            (number, sorted(choice.model for choice in part if choice))
            for number, part in zip(numbers, one.chosen, strict=True)
        ]
        found.setdefault(repr(sorted(chosen)), one)
    return sorted(found.values(), key=lambda one: one.price)


def _place_of(study: Study, group: _Group) -> object:
    """All that a group's file says but its name; its bounds in radians, whatever unit they are given in."""
    values = {key: value for key, value in group.values.items() if key not in ("name", "min", "max")}
    return values, study.space.lower[group.first].tolist(), study.space.upper[group.first].tolist()


def _groups(study: Study) -> list[_Group]:
    groups = []
    first = 0
    for values in study.file["sensors"]:
        groups.append(_Group(values, first, 2 if "mirror_y_m" in values else 1))
        first += values["count"]
    return groups


def _combination(
    study: Study, groups: list[_Group], chosen: tuple[tuple[Choice | None, ...], ...], name: str
) -> Combination:
    """The combination in which each group's first sensors are of these models."""
    numbers: list[int] = []
    slots: list[Slot] = []
    members: list[int] = []
    files: list[dict[str, Any]] = []
    prices: list[float] = []
    for i, (group, part) in enumerate(zip(groups, chosen, strict=True)):
        of_model = {choice.model: choice for choice in part if choice}
        counts = Counter(choice.model for choice in part if choice)
        place = group.first
        for model, places in counts.items():
            choice = of_model[model]
            count = places * group.together
            values = {key: value for key, value in group.values.items() if key != "choose"}
            values |= {"model": model, "count": count}
            if len(counts) > 1 and "name" in values:
                values["name"] = f"{values['name']}_{_plain(choice.sensor.name)}"
            files.append(values)
            prices += [choice.price] * count
            for number in range(count):
                slot = slot_name(values.get("name"), count, number, len(slots))
                of = study.slots[place + number]
                surface = choice.surface.image if choice.surface and number % group.together else choice.surface
                given = group.values.get("azimuth_fov_deg")
                fov_deg = choice.sensor.field_of_view_deg(tuple(given) if given else None)
                slots.append(
                    replace(
                        of,
                        name=slot,
                        sensor=choice.sensor,
                        model=model,
                        azimuth_fov_deg=fov_deg,
                        surface=surface,
                        choices=(),
                    )
                )
                numbers.append(place + number)
                members.append(i)
            place += count
    for slot, times in Counter(one.name for one in slots).items():
        if times > 1:
            raise ConfigError(f"{study.name}: two sensors of a combination are called {slot!r}; rename a group")
        if len(slot) > NAME_MAX:
            what = f"a sensor of a combination has a name of {len(slot)} characters; allowed: at most {NAME_MAX}"
            raise ConfigError(f"{study.name}: {what}")
    used = {values["model"] for values in files}
    named = {model: each for model, each in study.file["prices"].items() if model in used}
    file = study.file | {"sensors": files, "prices": named}
    names = tuple(_group_name(group, i) for i, group in enumerate(groups))
    asked = study.requirements and study.requirements.of_slots(numbers)
    whole = replace(study, name=name, slots=tuple(slots), requirements=asked, file=file)
    return Combination(name, total_price(prices), whole, tuple(members), names)


def _name(groups: list[_Group], chosen: tuple[tuple[Choice | None, ...], ...]) -> str:
    """A name for the choice, group by group, that is a valid folder name."""
    parts = []
    for i, (group, part) in enumerate(zip(groups, chosen, strict=True)):
        counts = Counter(choice.sensor.name for choice in part if choice)
        each = [f"{count * group.together}x{_plain(model)}" for model, count in counts.items()]
        if each:
            parts.append("-".join([_group_name(group, i), *each]))
    return "_".join(parts)[:FOLDER_MAX]


def _models(group: _Group, part: tuple[Choice | None, ...]) -> str:
    """The number of sensors of each model, in words."""
    counts = Counter(choice.sensor.name for choice in part if choice)
    return ", ".join(f"{count * group.together} × {model}" for model, count in counts.items())


def _group_name(group: _Group, index: int) -> str:
    return str(group.values.get("name", f"sensors{index}"))


def _plain(name: str) -> str:
    """A name as a valid part of a file name."""
    return re.sub(r"[^A-Za-z0-9.-]+", "-", name)


@dataclass(frozen=True)
class Example:
    """A rig of some combination, in its unit cube."""

    combination: Combination
    x: Array  # (free coordinates,)
    objective: float


@dataclass(frozen=True, eq=False)
class SensorSlot:
    """A sensor of a combination, or a mirrored pair, and its free coordinates."""

    group: int
    model: str | None
    columns: NDArray[np.int64]


def starts(combination: Combination, examples: Sequence[Example], rng: np.random.Generator) -> Array:
    """(n, free coordinates) points of a combination's unit cube, made from examples, those of the best one first.

    The rig of another combination fits if at most CHANGES_MAX sensors are exchanged, added or removed. Sensors of the
    same group and model keep their poses, then those of the same group; a sensor that is new stands anywhere within its
    bounds.
    """
    slots = _sensor_slots(combination)
    found = []
    for example in sorted(examples, key=lambda example: example.objective):
        for _ in range(DRAWS):
            x, is_new = _fitted(slots, example, rng)
            if x is not None:
                found.append(x)
            if x is None or not is_new:
                break
    return np.array(found[:STARTS_MAX]).reshape(-1, combination.study.space.free.sum())


def _sensor_slots(combination: Combination) -> list[SensorSlot]:
    study = combination.study
    return [
        SensorSlot(combination.groups[i], slot.model, np.flatnonzero(study.space.groups == i))
        for i, slot in enumerate(study.slots)
        if np.isnan(study.space.mirror[i])
    ]


def _fitted(slots: Sequence[SensorSlot], example: Example, rng: np.random.Generator) -> tuple[Array | None, bool]:
    """The example's poses for these slots, and whether one was drawn; None if too many sensors differ."""
    left = _sensor_slots(example.combination)
    left = [left[i] for i in rng.permutation(len(left))]  # which of several is removed
    taken: dict[int, SensorSlot] = {}
    for same in (True, False):  # model and group, then group alone
        for i, slot in enumerate(slots):
            if i not in taken:
                fits = [one for one in left if one.group == slot.group and (one.model == slot.model or not same)]
                if fits:
                    taken[i] = fits[0]
                    left.remove(fits[0])
    exchanged = sum(one.model != slots[i].model for i, one in taken.items())
    new = len(slots) - len(taken)
    if exchanged + new + len(left) > CHANGES_MAX:
        return None, False
    x = rng.random(sum(len(slot.columns) for slot in slots))
    for i, one in taken.items():
        x[slots[i].columns] = example.x[one.columns]
    return x, new > 0
