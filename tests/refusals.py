"""What is refused: an error, of one line for each mistake, that says where, and what."""

import re
from contextlib import contextmanager

import pytest

from lidarcfg.errors import LidarcfgError, one_line


@contextmanager
def refused(message, at="", kind=LidarcfgError):
    """What is done within ends in an error that has the message in one of its lines, and a match of `at`."""
    with pytest.raises(kind) as caught:
        yield
    lines = str(caught.value).split("\n")
    assert any(message in line and re.search(at, line) for line in lines), lines
    assert all(line == one_line(line) for line in lines)


def exchanged(text, old, new):
    """The text with something else in the place of what stands in it."""
    assert old in text
    return text.replace(old, new, 1)
