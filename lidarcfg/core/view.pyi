from lidarcfg.geometry import Array

def blend_triangles(
    image: Array, depth_m: Array, triangles: Array, colours: Array, alpha: Array, focal_px: float, near_m: float
) -> int:
    """Blend triangles (T, 3, 3), far to near, into image (H, W, 3) where they are nearer than depth_m (H, W)."""
