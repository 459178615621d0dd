"""Which of the core's modules a processor gets: each is compiled for an x86-64 level, or for other processors."""

from collections.abc import Set

LEAST = {"v3": 3, "v2": 2, "any": 0}  # what a module needs; the best first


def choose(built: Set[str], processor: int) -> str:
    """The best module, of those built, that runs on a processor: of x86-64 level 1, 2 or 3, or 0 for another kind.

    Raises ImportError if there is none.
    """
    for level, least in LEAST.items():
        if level in built and least <= processor:
            return level
    raise ImportError(
        f"the core of lidarcfg is compiled for x86-64-{' and '.join(sorted(built))}, but this processor is of "
        f"x86-64-v{processor}; allowed: a build on this machine, or one with -C cmake.define.LIDARCFG_LEVELS=v2"
    )
