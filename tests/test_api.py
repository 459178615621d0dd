"""Pages and stubs that are made of the code."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["make_api", "make_keys", "make_stubs"])
def test_what_is_made_is_up_to_date(name):
    tool = ROOT / f"tools/{name}.py"
    done = subprocess.run([sys.executable, tool, "--check"], check=False)
    assert done.returncode == 0, f"run {tool.relative_to(ROOT)}"
