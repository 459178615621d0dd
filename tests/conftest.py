"""What all tests may ask for."""

import importlib
from pathlib import Path

import pytest


def pytest_addoption(parser):
    parser.addoption(
        "--nightly", action="store_true", help="the long form of tests/reliability: every command, many times"
    )


@pytest.fixture
def tool(monkeypatch):
    """A module of tools/ by its name."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "tools"))
    return importlib.import_module
