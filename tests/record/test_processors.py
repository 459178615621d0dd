"""The recorded answers on a lesser processor: without AVX2 and FMA in the core, the system's library, numpy and BLAS."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
LESSER = {
    "LIDARCFG_CORE": "v2",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Nehalem",
}
OWN_EXP = "not auto"  # cma takes numpy's exp and BLAS, whose last bits are the processor's
BRIEF = f"{OWN_EXP} and not search and not car"  # every kernel; searches around a car by night


@pytest.mark.skipif(not find_spec("lidarcfg.core._core_v2"), reason="no core for lesser processors: LIDARCFG_LEVELS=v2")
def test_a_lesser_processor_gives_the_same_bits(request):
    cases = OWN_EXP if request.config.getoption("nightly") else BRIEF
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-W", "ignore::ImportWarning"]
    words += ["-W", "ignore::RuntimeWarning", "-k", cases, "tests/record/test_record.py"]
    done = subprocess.run(words, cwd=ROOT, env=os.environ | LESSER, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
