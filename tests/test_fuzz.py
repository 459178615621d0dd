"""A short run of tools/fuzz.py; docs/capture.md has the long one. And what it found, each with a test of its own."""

import os
import re
import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).parent.parent / "tools" / "fuzz.py"


def test_odd_captures_end_well():
    """Twenty thousand packets, changed at random, with the kernels that everybody uses."""
    command = [sys.executable, str(TOOL), "--random", "--packets", "20000", "--seed", "7"]
    done = subprocess.run(
        command, env=os.environ | {"NUMBA_BOUNDSCHECK": "0"}, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    captures, packets, points, refused = (
        int(number.replace(",", ""))
        for number in re.findall(r"([\d,]+) (?:captures|packets|points|refused)", done.stdout)[:4]
    )
    assert packets >= 20_000
    assert points > 10 * packets  # most are decoded, not refused
    assert 0 < refused < captures
