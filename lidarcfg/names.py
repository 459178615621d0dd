"""Names of sensors, objects and zones where they are drawn or listed: files keep them whole."""

DRAWN, LISTED = 28, 40  # characters


def short(name: str, most: int = LISTED) -> str:
    """A name of at most so many characters: … stands for the middle of a longer one, as ends tell names apart."""
    if len(name) <= most:
        return name
    end = (most - 1) // 3
    return f"{name[: most - 1 - end]}…{name[len(name) - end :]}"
