"""Text of reports and tables: short forms of long names, and unprintable characters as escapes."""

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


def printable(text: object) -> str:
    """A text with unprintable characters as escapes, except for line ends and joiners of letters."""
    return "".join(c if c.isprintable() or c in "\n\u200c\u200d" else repr(c)[1:-1] for c in str(text))
