"""Which of the core's modules is loaded, for each processor and each build; by hand."""

import platform
from pathlib import Path

import pytest

from lidarcfg.core import _core_processor, levels


@pytest.mark.parametrize(
    ("built", "processor", "chosen"),
    [
        ({"v3"}, 3, "v3"),
        ({"v2"}, 3, "v2"),
        ({"v2"}, 2, "v2"),
        ({"v2", "v3"}, 3, "v3"),
        ({"v2", "v3"}, 2, "v2"),
        ({"any"}, 0, "any"),
    ],
)
def test_the_best_that_runs_is_chosen(built, processor, chosen):
    assert levels.choose(built, processor) == chosen


@pytest.mark.parametrize(
    ("built", "processor", "message"),
    [
        ({"v3"}, 2, r"compiled for x86-64-v3, but this processor is of x86-64-v2; allowed: .*LEVELS=v2"),
        ({"v2", "v3"}, 1, r"compiled for x86-64-v2 and v3, but this processor is of x86-64-v1"),
    ],
)
def test_what_does_not_run_is_refused(built, processor, message):
    with pytest.raises(ImportError, match=message):
        levels.choose(built, processor)


@pytest.mark.skipif(platform.machine() != "x86_64" or not Path("/proc/cpuinfo").exists(), reason="Linux on x86-64 only")
def test_the_system_says_the_same_of_this_processor():
    flags = next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags")).split()
    expected = 3 if {"avx2", "bmi1", "bmi2", "fma"} <= {*flags} else 2 if {"sse4_2", "popcnt"} <= {*flags} else 1
    assert _core_processor.x86_64_level() == expected
