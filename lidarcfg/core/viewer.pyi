from typing import Annotated

import numpy
from numpy.typing import NDArray

def blend_triangles(
    image: Annotated[NDArray[numpy.float32], dict(shape=(None, None, 3))],
    depth_m: Annotated[NDArray[numpy.float32], dict(shape=(None, None))],
    triangles: Annotated[NDArray[numpy.float64], dict(shape=(None, 3, 3))],
    colours: Annotated[NDArray[numpy.float64], dict(shape=(None, 3))],
    alpha: Annotated[NDArray[numpy.float64], dict(shape=(None,))],
    focal_px: float,
    near_m: float,
) -> int:
    """
    Blend triangles (T, 3, 3), far to near, into image (H, W, 3) where they are nearer than depth_m (H, W).
    """
