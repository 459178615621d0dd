"""One browser for all tests of the page."""

import pytest

from tests.chromium import browser


@pytest.fixture(scope="session")
def chromium():
    with browser() as driver:
        yield driver
