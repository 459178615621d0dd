"""Builds the package by scikit-build-core; where there is no C++ compiler, with the one of `ziglang`.

That is clang in a wheel of the package index, so nobody needs the rights to install a compiler.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scikit_build_core import build as backend
from scikit_build_core.build import (
    build_sdist,
    get_requires_for_build_sdist,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

Settings = Mapping[str, Any] | None
GCC_LEAST, CLANG_LEAST = 11, 14


def get_requires_for_build_wheel(config_settings: Settings = None) -> list[str]:
    """What building takes beside pyproject.toml's list: a compiler, where there is none."""
    return backend.get_requires_for_build_wheel(config_settings) + _compiler_package()


def get_requires_for_build_editable(config_settings: Settings = None) -> list[str]:
    """The same for an editable installation."""
    return backend.get_requires_for_build_editable(config_settings) + _compiler_package()


def build_wheel(folder: str, config_settings: Settings = None, metadata: str | None = None) -> str:
    """Build a wheel into a folder; returns its name."""
    _choose_compiler()
    return backend.build_wheel(folder, config_settings, metadata)


def build_editable(folder: str, config_settings: Settings = None, metadata: str | None = None) -> str:
    """Build the wheel of an editable installation."""
    _choose_compiler()
    return backend.build_editable(folder, config_settings, metadata)


def _compiler_package() -> list[str]:
    return [] if _compiler() else ["ziglang>=0.14"]


def _compiler() -> str | None:
    """The machine's C++ compiler: the one that CXX names, or the first one that is new enough."""
    if os.environ.get("CXX") or sys.platform == "win32":  # where CMake finds Visual Studio's clang-cl
        return os.environ.get("CXX", "clang-cl")
    return next((name for name in ("c++", "g++", "clang++") if _is_new_enough(name)), None)


def _is_new_enough(name: str) -> bool:
    path = shutil.which(name)
    if path is None:
        return False
    said = subprocess.run([path, "--version"], capture_output=True, text=True).stdout
    found = re.search(r"(\d+)\.\d+\.\d+", said)
    least = CLANG_LEAST if "clang" in said else GCC_LEAST
    return found is not None and int(found[1]) >= least


def _choose_compiler() -> None:
    """Set the environment that CMake looks at."""
    name = _compiler()
    if name:
        os.environ["CXX"] = name
        return
    cache = Path("build").absolute() / "zig"
    os.environ.setdefault("ZIG_GLOBAL_CACHE_DIR", str(cache))
    os.environ["CXX"] = f"{sys.executable} -m ziglang c++"
    os.environ["CMAKE_ARGS"] = f"{os.environ.get('CMAKE_ARGS', '')} -DLIDARCFG_ARCH_FLAG=-mcpu=x86_64_".strip()
