"""A folder with the inputs of commands, and how often each attack is made."""

import sys

import pytest

from tests.reliability.commands import BRIEF, COMMANDS, prepare

if sys.platform != "linux":
    collect_ignore_glob = ["test_*.py"]  # forks, kills and limits as Linux has them


def pytest_generate_tests(metafunc):
    if "command" in metafunc.fixturenames:
        chosen = COMMANDS if metafunc.config.getoption("nightly") else BRIEF
        metafunc.parametrize("command", chosen.values(), ids=list(chosen))


@pytest.fixture
def times(request):
    """How often: a few times, or many by night."""
    return 40 if request.config.getoption("nightly") else 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where commands find their inputs."""
    prepare(path := tmp_path_factory.mktemp("reliability"))
    return path
