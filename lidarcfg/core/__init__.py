"""The hot loops, compiled from the C++ beside this file: arrays in, arrays out.

A submodule for each package that has such loops, named as the package: `core.placement` is called by `placement`.
Their signatures are in the `.pyi` files here; README.md says how to build, debug and profile.

On x86-64 the same sources are compiled twice, for processors with AVX2 and for those without: bit for bit the same
results. LIDARCFG_CORE=v2 asks for the latter.
"""

import os
import platform
from importlib import import_module
from types import ModuleType


def _load() -> ModuleType:
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return import_module(f"{__name__}._core_any")
    asked = os.environ.get("LIDARCFG_CORE")
    if asked:
        return import_module(f"{__name__}._core_{asked}")
    module = import_module(f"{__name__}._core_v2")
    return import_module(f"{__name__}._core_v3") if module.has_v3() else module


compiled = _load()
maths = compiled.maths
ouster = compiled.ouster
packets = compiled.packets
placement = compiled.placement
returns = compiled.returns
simulate = compiled.simulate
view = compiled.view
visibility = compiled.visibility
world = compiled.world
