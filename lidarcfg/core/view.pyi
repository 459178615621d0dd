import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

def blend_triangles(
    image: Floats, depth_m: Floats, triangles: Array, colours: Array, alpha: Array, focal_px: float, near_m: float
) -> int:
    """Blend triangles (T, 3, 3), far to near, into image (H, W, 3) where they are nearer than depth_m (H, W)."""
