"""The protocol of a solver: its keys in a study's file, and the search that it begins.

A solver is a module with a `Solver`, which names its method, has keys of its own if it needs some, and begins a
`search.Search`; a line in `solvers.SOLVERS`; and a test.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import Field, model_validator

from lidarcfg.config.models import Model
from lidarcfg.geometry import Array
from lidarcfg.solvers.search import Coordinates, Search

BUDGETS = {"cycles", "evaluations", "seconds"}


class Solver(Model):
    """How to search, as a study says it. The first budget that is reached ends the search."""

    default_budget: ClassVar[Mapping[str, int]] = {"evaluations": 100_000}
    is_upright_central: ClassVar[bool] = (
        True  # of LiDARs that may be tilted any way, in the middle of their coordinates
    )
    in_full: ClassVar[str] = ""  # what reports say of trials of which it needs the very cost

    method: str
    cycles: Annotated[int, Field(ge=1)] | None = None
    evaluations: Annotated[int, Field(ge=1)] | None = None
    seconds: Annotated[float, Field(gt=0)] | None = None
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1

    @abstractmethod
    def begin(self, coordinates: Coordinates, starts: Array | None = None) -> Search:
        """A search over some coordinates. `starts` (s, dimensions): good points, the best first, to begin near."""

    @model_validator(mode="before")
    @classmethod
    def _default_budget(cls, values: Any) -> Any:
        if isinstance(values, dict) and all(values.get(key) is None for key in BUDGETS):
            return {**values, **cls.default_budget}
        return values

    @property
    def own_keys(self) -> dict[str, Any]:
        """The values of the keys that no other solver has, if they are given."""
        keys = type(self).model_fields.keys() - Solver.model_fields.keys()
        return {key: value for key in sorted(keys) if (value := getattr(self, key)) is not None}
