"""The combinations of sensors that a study lets one choose: each is an ordinary study with a price.

The sensors of a group are interchangeable, so a group's part of a combination is a multiset of its models; mirrored
sensors are chosen in pairs. A combination without any sensor is none, nor is one of which failures leave none.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations_with_replacement, product
from typing import Any

from lidarcfg.config.models import NAME_MAX
from lidarcfg.errors import ConfigError
from lidarcfg.requirements.allowed_rigs import total_price
from lidarcfg.study.mounting import Choice, Slot, slot_name
from lidarcfg.study.study import Study

FOLDER_MAX = 80  # characters of a combination's name, which becomes a folder's


@dataclass(frozen=True)
class Group:
    """A group of slots of a study, and what its file says of it."""

    name: str
    values: dict[str, Any]  # in the study's file
    first: int  # its first slot
    together: int  # slots that are chosen as one

    @property
    def places(self) -> int:
        """How many are chosen."""
        return int(self.values["count"]) // self.together


@dataclass(frozen=True)
class Part:
    """What is chosen of a group."""

    group: Group
    choices: tuple[Choice, ...]  # one for each place that has a sensor

    @property
    def prices(self) -> list[float]:
        """The price of each sensor."""
        return [choice.price for choice in self.choices * self.group.together]

    @property
    def sensors(self) -> list[str]:
        """The name of each sensor's model, those of one together."""
        return [choice.sensor.name for choice in self.choices for _ in range(self.group.together)]

    @property
    def text(self) -> str:
        """The number of sensors of each model, in words; empty where there is none."""
        return ", ".join(f"{count} × {model}" for model, count in Counter(self.sensors).items())

    @property
    def name(self) -> str:
        """The same as a valid part of a folder's name."""
        each = [f"{count}x{_plain(model)}" for model, count in Counter(self.sensors).items()]
        return "-".join([self.group.name, *each]) if each else ""

    def entries(self) -> Iterator[tuple[Choice, dict[str, Any]]]:
        """For each model what a study's file says of its sensors."""
        counts = Counter(choice.model for choice in self.choices)
        for choice in {choice.model: choice for choice in self.choices}.values():
            values = {key: value for key, value in self.group.values.items() if key != "choose"}
            values |= {"model": choice.model, "count": counts[choice.model] * self.group.together}
            if len(counts) > 1 and "name" in values:
                values["name"] = f"{values['name']}_{_plain(choice.sensor.name)}"
            yield choice, values


@dataclass(frozen=True)
class Combination:
    """One choice of sensors. Its study is made when it is asked for."""

    name: str
    parent: Study
    parts: tuple[Part, ...]  # by group

    def __repr__(self) -> str:
        return f"<Combination: {self.sensors}, for {self.price:,.15g}>"

    @cached_property
    def price(self) -> float:
        """The price of all sensors."""
        return total_price(price for part in self.parts for price in part.prices)

    @property
    def all_sensors(self) -> list[str]:
        """The name of each sensor's model."""
        return [sensor for part in self.parts for sensor in part.sensors]

    @property
    def models(self) -> tuple[str, ...]:
        """How many sensors of each model, by group; empty where there is none."""
        return tuple(part.text for part in self.parts)

    @property
    def sensors(self) -> str:
        """The number of sensors of each model; of each group, if the whole study has several."""
        named = [f"{part.group.name}: {part.text}" if len(self.parts) > 1 else part.text for part in self.parts]
        return "; ".join(text for text, part in zip(named, self.parts, strict=True) if part.choices)

    @property
    def group_names(self) -> tuple[str, ...]:
        """The groups of the whole study."""
        return tuple(part.group.name for part in self.parts)

    @property
    def groups(self) -> tuple[int, ...]:
        """The group of the whole study, by slot."""
        return tuple(i for i, part in enumerate(self.parts) for _ in part.sensors)

    @property
    def slot_names(self) -> list[str]:
        """The names of its sensors."""
        found: list[str] = []
        for part in self.parts:
            for _, values in part.entries():
                count = values["count"]
                found += [slot_name(values.get("name"), count, number, len(found) + number) for number in range(count)]
        return found

    @cached_property
    def study(self) -> Study:
        """The study in which each group's first sensors are of these models."""
        parent = self.parent
        numbers: list[int] = []
        slots: list[Slot] = []
        names = iter(self.slot_names)
        files = []
        for part in self.parts:
            place = part.group.first
            for choice, values in part.entries():
                files.append(values)
                given = values.get("azimuth_fov_deg")
                fov_deg = choice.sensor.field_of_view_deg(tuple(given) if given else None)
                for number in range(values["count"]):
                    is_image = number % part.group.together > 0
                    surface = choice.surface.image if choice.surface and is_image else choice.surface
                    of = parent.slots[place + number]
                    slot = replace(of, name=next(names), sensor=choice.sensor, model=choice.model, choices=())
                    slots.append(replace(slot, azimuth_fov_deg=fov_deg, surface=surface))
                    numbers.append(place + number)
                place += values["count"]
        used = {values["model"] for values in files}
        named = {model: each for model, each in parent.file["prices"].items() if model in used}
        file = parent.file | {"sensors": files, "prices": named}
        asked = parent.requirements and parent.requirements.of_slots(numbers)
        return replace(parent, name=self.name, slots=tuple(slots), requirements=asked, file=file)


def _check_names(names: Sequence[str], study: str) -> None:
    """Raises ConfigError for two sensors of one name, and for a name that is too long."""
    for slot, times in Counter(names).items():
        if times > 1:
            raise ConfigError(f"{study}: two sensors of a combination are called {slot!r}; rename a group")
        if len(slot) > NAME_MAX:
            what = f"a sensor of a combination has a name of {len(slot)} characters; allowed: at most {NAME_MAX}"
            raise ConfigError(f"{study}: {what}")


def combinations(study: Study) -> list[Combination]:
    """All combinations of a study that has choices, in the order of its groups and of their choices.

    Raises ConfigError for names of sensors that a combination cannot have.
    """
    groups = _groups(study)
    ways = [combinations_with_replacement(study.slots[group.first].choices, group.places) for group in groups]
    found: list[Combination] = []
    needed = study.requirements.lost if study.requirements else 0
    least = 1 + max((study.robust and study.robust.lost) or 0, needed)  # some must be left
    names: Counter[str] = Counter()
    for chosen in product(*ways):
        each = zip(groups, chosen, strict=True)
        parts = tuple(Part(group, tuple(choice for choice in some if choice)) for group, some in each)
        if sum(len(part.sensors) for part in parts) >= least:
            name = "_".join(filter(None, (part.name for part in parts)))[:FOLDER_MAX]
            names[name] += 1
            suffix = f"-{names[name]}" if names[name] > 1 else ""
            found.append(Combination(name + suffix, study, parts))
            _check_names(found[-1].slot_names, study.name)
    return found


def distinct_combinations(study: Study) -> list[Combination]:
    """The combinations, cheapest first; of those that allow the same rigs one.

    The rigs are the same if groups with the same bounds and choices exchange their sensors. A mirror image of a rig is
    another one, however symmetric all else is: heads turn one way only, and tables of firings and of beams have two
    sides. With mounting errors that are drawn, each sensor has its own, and no two combinations are the same.
    """
    numbers = list(range(len(study.file["sensors"])))
    if not (study.robust and study.robust.drawn):
        places = [_place_of(study, group) for group in _groups(study)]
        numbers = [places.index(place) for place in places]
    found: dict[object, Combination] = {}
    for one in combinations(study):
        each = zip(numbers, one.parts, strict=True)
        chosen = [(number, sorted(choice.model for choice in part.choices)) for number, part in each]
        found.setdefault(repr(sorted(chosen)), one)
    return sorted(found.values(), key=lambda one: one.price)


def _place_of(study: Study, group: Group) -> object:
    """All that a group's file says but its name; its bounds in radians, whatever unit they are given in."""
    values = {key: value for key, value in group.values.items() if key not in ("name", "min", "max")}
    return values, study.space.lower[group.first].tolist(), study.space.upper[group.first].tolist()


def _groups(study: Study) -> list[Group]:
    groups = []
    first = 0
    for i, values in enumerate(study.file["sensors"]):
        name = str(values.get("name", f"sensors{i}"))
        groups.append(Group(name, values, first, 2 if "mirror_y_m" in values else 1))
        first += values["count"]
    return groups


def _plain(name: str) -> str:
    """A name as a valid part of a file name."""
    return re.sub(r"[^A-Za-z0-9.-]+", "-", name)
