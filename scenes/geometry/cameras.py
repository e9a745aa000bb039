"""Pinhole cameras, OpenCV convention: z forward, x right, y down, pixel centres on integers."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError

Array = NDArray[np.float64]


# Metres: no depth camera reads so far, and what says so is an overflow.
FARTHEST_READING = 1e3


def is_reading(depth: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Where depths along z (m) are readings: above 0 and no farther than any camera sees; false of NaN, infinity."""
    with np.errstate(invalid="ignore"):
        return np.asarray((depth > 0) & (depth < FARTHEST_READING))


# Share of a focal length that is rounding and no skew.
NEARLY_ZERO = 1e-6


@dataclass(frozen=True)
class Camera:
    """Intrinsics in pixels: focal lengths fx, fy, principal point cx, cy, image width and height."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        """Refuse intrinsics that no camera has."""
        values = (self.fx, self.fy, self.cx, self.cy)
        if not all(isinstance(value, Real) for value in (*values, self.width, self.height)):
            raise InputError(f"camera: expected numbers as fx, fy, cx, cy, width, height, got {self}")
        if not np.isfinite(values).all() or self.fx <= 0 or self.fy <= 0 or self.width < 1 or self.height < 1:
            raise InputError(f"camera: expected positive finite fx, fy, width, height, got {self}")
        for name in ("width", "height"):
            pixels = float(getattr(self, name))
            if not pixels.is_integer():
                raise InputError(f"camera: expected a whole number of pixels as {name}, got {pixels:g}")
            object.__setattr__(self, name, int(pixels))

    @staticmethod
    def from_matrix(matrix: Array, width: int, height: int) -> Camera:
        """From a (3, 3) or (9,) intrinsic matrix K: fx 0 cx, 0 fy cy, 0 0 1. Raises InputError for any other."""
        try:
            k = np.asarray(matrix, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"camera: expected a 3x3 intrinsic matrix of numbers: {error}") from error
        if k.shape not in ((3, 3), (9,)):
            raise InputError(f"camera: expected a 3x3 intrinsic matrix, got shape {k.shape}")
        k = k.reshape(3, 3)
        tiny = NEARLY_ZERO * max(abs(float(k[0, 0])), 1.0)
        if not (np.abs(k[2] - (0.0, 0.0, 1.0)) <= tiny).all():
            hint = ": is it transposed?" if (np.abs(k[:, 2] - (0.0, 0.0, 1.0)) <= tiny).all() else ""
            raise InputError(f"camera: expected a K whose last row is 0 0 1, got {k[2]}{hint}")
        if not (abs(k[0, 1]) <= tiny and abs(k[1, 0]) <= tiny):
            raise InputError(f"camera: expected a K without skew, got {k[0, 1]:.3g} and {k[1, 0]:.3g} beside fx and fy")
        return Camera(k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)

    @property
    def matrix(self) -> Array:
        """K, shape (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def scaled(self, factor: float) -> Camera:
        """The same view with `factor` times as many pixels a side (pixel centres stay on integers)."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        sx, sy = width / self.width, height / self.height
        return Camera(self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5, width, height)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) as (u, v) and depths (n,) of camera-frame points (n, 3); u, v are NaN at z <= 0."""
        z = points[:, 2]
        safe, uv = np.where(z > 0, z, np.nan), np.zeros((len(points), 2))
        uv[:, 0], uv[:, 1] = self.fx * points[:, 0] / safe + self.cx, self.fy * points[:, 1] / safe + self.cy
        return uv, z

    def rays(self) -> Array:
        """(height, width, 3) directions with z = 1: depth times ray is the point."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones(u.shape)], axis=-1)

    def back_project(self, depth: NDArray[np.floating], pixels: NDArray[np.bool_] | None = None) -> Array:
        """Points (n, 3) of the pixels with a reading (and in the (h, w) mask `pixels`), row-major order."""
        valid = is_reading(depth)
        if pixels is not None:
            valid &= pixels
        v, u = np.nonzero(valid)
        z = depth[v, u].astype(np.float64)
        return np.stack([(u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z], axis=1)
