"""Point clouds, and their files: PLY, PCD, NPZ, LAS.

To read in this order: `cloud` defines the columns of a cloud, and saves and loads clouds; `ply_pcd` reads PLY and PCD
files, ours or another program's; `las` reads and writes LAS and LAZ; `open3d_tensors` converts from and to Open3D.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
