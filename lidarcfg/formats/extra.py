"""Libraries that are an extra of this package."""

from lidarcfg.errors import ConversionError


def missing(library: str) -> ConversionError:
    """The error for a `library` that is not installed."""
    return ConversionError(f"{library} is not installed; pip install 'lidarcfg[convert]'")
