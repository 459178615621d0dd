"""A pinhole camera: where points of the vehicle frame are in a picture."""

from dataclasses import dataclass

import numpy as np

from lidarcfg.config.models import COORDINATE_MAX_M
from lidarcfg.errors import ConfigError
from lidarcfg.geometry import Array


@dataclass(frozen=True)
class Camera:
    """A pinhole: position, target and field of view. Raises ConfigError for a camera that sees nothing."""

    eye_m: Array  # (3,)
    target_m: Array  # (3,)
    field_deg: float = 60.0  # across the picture's width

    def __post_init__(self) -> None:
        if not (abs(np.concatenate([self.eye_m, self.target_m])) <= COORDINATE_MAX_M).all():
            raise ConfigError(f"camera: a coordinate is not a number up to {COORDINATE_MAX_M:g} m")
        if not np.linalg.norm(self.target_m - self.eye_m) >= 1e-6:
            raise ConfigError("camera: eye and target are one point; allowed: at least 1e-06 m apart")
        if not 1 <= self.field_deg <= 170:
            raise ConfigError(f"camera: field of view {self.field_deg:g}°; allowed: 1 to 170")

    def view(self, points_m: Array) -> Array:
        """Points (…, 3) as right, up and ahead of the camera in metres; +x is up where it looks straight down."""
        forward = (self.target_m - self.eye_m) / np.linalg.norm(self.target_m - self.eye_m)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        if np.linalg.norm(right) < 1e-9:
            right = np.array([0.0, -1.0, 0.0])
        right /= np.linalg.norm(right)
        return np.asarray((points_m - self.eye_m) @ np.stack([right, np.cross(right, forward), forward], axis=1))

    def focal_px(self, width: int) -> float:
        """Pixels to the side of a metre that is one metre ahead."""
        return float(width / 2 / np.tan(np.radians(self.field_deg) / 2))

    def project(self, xyz: Array, width: int, height: int) -> tuple[Array, Array, Array]:
        """Columns and rows (fractional pixels) and depth in metres of points (N, 3); behind the camera depth <= 0."""
        view = self.view(xyz)
        depth = view[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = view[:, :2] / depth[:, None] * self.focal_px(width)
        return width / 2 + flat[:, 0], height / 2 - flat[:, 1], depth
