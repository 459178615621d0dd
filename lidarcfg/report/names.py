"""Names of sensors, objects and zones where they are drawn or listed: files keep them whole."""

from collections.abc import Sequence

HEAD = 20  # characters over a column of numbers
DRAWN = 28  # in a drawing
LISTED = 40  # in a row
MANY = 8  # sensors; of more, the first are listed


def truncate(name: str, most: int = LISTED) -> str:
    """A name of at most `most` characters: … replaces the middle of a longer one, as ends tell names apart."""
    if len(name) <= most:
        return name
    end = (most - 1) // 3
    return f"{name[: most - 1 - end]}…{name[len(name) - end :]}"


def summarize(texts: Sequence[str], most: int = MANY) -> list[str]:
    """The first texts and the number of the others; all texts if that takes no more lines."""
    return list(texts) if len(texts) <= most + 1 else [*texts[:most], f"and {len(texts) - most:,} more"]
