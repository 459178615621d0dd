"""The makers' packets, a folder each: `layout`, `model`, `encode`, `decode`, `telemetry`.

To read in this order: `codec` is the interface that each maker implements, `families` the registry of them. Then a
maker. `facts`, `blocks` and `inertial` are what several makers share. `emulator` is the interface by
which a maker answers drivers, in its own `emulator`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
