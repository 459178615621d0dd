"""What is refused: an error of one line that says where, and what."""

import re
from contextlib import contextmanager

import pytest

from lidarcfg.errors import LidarcfgError


@contextmanager
def refused(message, at="", kind=LidarcfgError):
    """What is done within ends in an error of one line that has the message in it, and a match of `at`."""
    with pytest.raises(kind) as caught:
        yield
    line = str(caught.value)
    assert message in line
    assert re.search(at, line), line
    assert "\n" not in line


def exchanged(text, old, new):
    """The text with something else in the place of what stands in it."""
    assert old in text
    return text.replace(old, new, 1)
