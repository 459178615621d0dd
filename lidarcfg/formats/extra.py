"""Libraries that come with an extra of this package."""

from lidarcfg.errors import HandoverError


def missing(library: str) -> HandoverError:
    """What to do where `library` is not installed."""
    return HandoverError(f"{library} is not installed; pip install 'lidarcfg[convert]'")
