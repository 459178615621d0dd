"""One environment with ouster-sdk, which asks for click below 8.1.8: both command lines answer, with either click."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OLDEST = Path(sys.prefix) / "oldest-click"  # where tools/environment.sh puts it
VERSIONS = "from importlib.metadata import version; import click, cloup; print(version('click'), version('cloup'))"
OUSTER = "from ouster.cli.core import run; run()"


def said(pair, *arguments):
    """What a Python with that click prints; it must end well and print no error."""
    run = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | ({"PYTHONPATH": str(OLDEST)} if pair == "oldest" else {}),
    )
    assert (run.returncode, run.stderr) == (0, "")
    return run.stdout


@pytest.mark.parametrize("pair", ["installed", "oldest"])
def test_both_command_lines_answer(pair):
    if pair == "oldest":
        if not OLDEST.is_dir():
            pytest.skip("tools/environment.sh has not put the oldest click beside this Python")
        asked = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
        least = [line.partition(">=")[2] for line in asked if line.split(">=")[0] in ("click", "cloup")]
        assert said(pair, "-c", VERSIONS).split() == least
    assert "Usage: " in said(pair, "-m", "lidarcfg", "--help")
    for command in ("optimize", "export", "decode", "view"):
        assert f"lidarcfg {command} [OPTIONS]" in said(pair, "-m", "lidarcfg", command, "--help")
    pytest.importorskip("ouster.cli.core", reason="ouster-sdk is not installed")
    assert "source" in said(pair, "-c", OUSTER, "--help")
    assert "pcap" in said(pair, "-c", OUSTER, "source", "--help").lower()
