"""The hot loops, compiled from the C++ beside this file: arrays in, arrays out.

A submodule for each package that has such loops, named as the package, and `maths` for lidarcfg/maths.py.
`tools/make_stubs.py` makes the `.pyi` files here from what is compiled; README.md says how to build, debug and profile.

Built from source the core is compiled for the machine's own processor; wheels have it twice, for processors with AVX2
and for those without: bit for bit the same results. LIDARCFG_CORE=v2 asks for the latter.
"""

import os
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from lidarcfg.core.levels import LEAST, choose


def _load() -> ModuleType:
    level = os.environ.get("LIDARCFG_CORE")
    if not level:
        built = {one for one in LEAST if find_spec(f"{__name__}._core_{one}")}
        level = choose(built, import_module(f"{__name__}._core_processor").x86_64_level())
    return import_module(f"{__name__}._core_{level}")


compiled = _load()
maths = compiled.maths
packets = compiled.packets
returns = compiled.returns
simulate = compiled.simulate
viewer = compiled.viewer
vsr = compiled.vsr
world = compiled.world
