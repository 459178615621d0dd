"""lidarcfg: where should the LiDARs sit on this vehicle, and what will they see?

`__init__.pyi` lists the public names. Each loads its module on first use, so `import lidarcfg` costs nothing.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
