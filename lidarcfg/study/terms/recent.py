"""What settled past trials, to be tried first in new ones."""

from collections import Counter, deque
from typing import Generic, TypeVar

from lidarcfg.study.spheres import Node

RECENT = 32  # findings
T = TypeVar("T", bound=Node | int)


class Recent(Generic[T]):
    """Findings that settled trials: first those of the last batch, the most frequent in front, then earlier ones."""

    def __init__(self) -> None:
        self.items: list[T] = []
        self._seen: deque[T] = deque()  # of this batch

    def add(self, item: T) -> None:
        """Record a finding that settled a trial, or would settle a similar one."""
        self._seen.append(item)

    def learn(self) -> None:
        """Sort the findings of the batch in; the order does not depend on which thread was first."""
        counts: Counter[T] = Counter(self._seen)
        self._seen.clear()
        recent: list[T] = sorted(counts, key=lambda item: (-counts[item], item))
        self.items = [*recent, *(item for item in self.items if item not in counts)][:RECENT]
