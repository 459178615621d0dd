"""Our YAML files: strict models whose errors name file, line and key.

To read in this order: `document` reads YAML 1.2 with line numbers, `models` checks it against a pydantic model, `kinds`
tells which kind a file is.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
