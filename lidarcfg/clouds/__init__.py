"""Point clouds, and their files: PLY, PCD, NPZ, LAS.

To read in this order: `cloud` has the columns of a cloud, writes and reads its files; `rows` reads the tables in PLY
and PCD, ours or another program's; `las` is LAS and LAZ, `tensors` clouds from and to Open3D.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
