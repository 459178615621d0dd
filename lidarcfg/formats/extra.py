"""Libraries that are an extra of this package."""

from lidarcfg.errors import HandoverError


def missing(library: str) -> HandoverError:
    """The error for a `library` that is not installed."""
    return HandoverError(f"{library} is not installed; pip install 'lidarcfg[convert]'")
