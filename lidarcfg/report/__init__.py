"""Results as JSON, files, tables, pictures and reports. It shows; `lidarcfg.placement` computes.

`__init__.pyi` lists the names. Each loads its module on first use, so a list of sensors loads no plots.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
