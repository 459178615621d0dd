"""What all tests may ask for."""

import importlib
from pathlib import Path

import pytest

from tests.command_line import without_drawing


def pytest_addoption(parser):
    parser.addoption("--nightly", action="store_true", help="all cases, and the long form of tests/reliability")


def pytest_collection_modifyitems(config, items):
    if config.getoption("nightly"):
        return
    left_out = [item for item in items if item.get_closest_marker("nightly")]
    items[:] = [item for item in items if not item.get_closest_marker("nightly")]
    config.hook.pytest_deselected(items=left_out)


@pytest.fixture
def blank_pictures():
    """As tests/command_line.py has it."""
    with without_drawing():
        yield


@pytest.fixture
def tool(monkeypatch):
    """A module of tools/ by its name."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "tools"))
    return importlib.import_module
