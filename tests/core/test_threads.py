"""The kernels on several threads, under ThreadSanitizer."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RACE = """
#include <thread>
int main() {
  int shared = 0;
  std::thread other([&] { ++shared; });
  ++shared;
  other.join();
}
"""


def has_tsan(folder):
    """Whether the compiler's ThreadSanitizer finds a race here; not all kernels have memory as it wants it."""
    source = folder / "race.cpp"
    source.write_text(RACE)
    compiler = os.environ.get("CXX", "c++")
    words = [compiler, "-std=c++20", "-g", "-fsanitize=thread", "-pthread", str(source), "-o", str(folder / "race")]
    if not shutil.which(compiler) or subprocess.run(words, capture_output=True, check=False).returncode:
        return False
    return "data race" in subprocess.run([folder / "race"], capture_output=True, text=True, check=False).stderr


@pytest.mark.nightly
def test_threads_do_not_race(tmp_path):
    """The program compiles the kernels anew, which takes minutes."""
    if not shutil.which("cmake") or not has_tsan(tmp_path):
        pytest.skip("needs CMake and a compiler with ThreadSanitizer")
    build = tmp_path / "build"
    environment = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    ninja = ["-G", "Ninja"] if shutil.which("ninja") else []
    for words in (
        ["cmake", "-S", str(ROOT / "lidarcfg/core"), "-B", str(build), *ninja, "-DLIDARCFG_TSAN=ON"],
        ["cmake", "--build", str(build), "--parallel", "2"],
        [str(build / "threads")],
    ):
        done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
