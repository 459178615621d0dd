"""One environment with ouster-sdk, which asks for click below 8.1.8: both command lines answer, with either click."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
OLDEST = Path(sys.prefix) / "oldest-click"  # where tools/environment.sh puts it
VERSIONS = "from importlib.metadata import version; import click, cloup; print(version('click'), version('cloup'))"
HELP = """
import sys
from {} import {} as run
for words in {}:
    sys.argv = ["lidarcfg", *words, "--help"]
    try:
        run()
    except SystemExit as ended:
        assert not ended.code, words
"""


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
    names = "optimize", "export", "decode", "view"
    ours = said(pair, "-c", HELP.format("lidarcfg.cli.main", "main", [[], *([name] for name in names)]))
    assert ours.count("Usage: ") == 5
    for name in names:
        assert f"lidarcfg {name} [OPTIONS]" in ours
    pytest.importorskip("ouster.cli.core", reason="ouster-sdk is not installed")
    theirs = said(pair, "-c", HELP.format("ouster.cli.core", "run", [[], ["source"]]))
    assert "source" in theirs
    assert "pcap" in theirs.lower()
