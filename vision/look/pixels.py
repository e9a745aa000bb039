"""Pixels with a reading, as points; and the ball of the world that is looked at. Camera frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera, is_reading

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Region:
    """A ball of interest in the camera frame: centre (3,), radius (m)."""

    centre: Array
    radius: float

    def box(self, camera: Camera) -> tuple[int, int, int, int] | None:
        """Pixels (u0, v0, u1, v1), exclusive ends, that can see the ball; None when it is outside the image."""
        x, y, z = (float(c) for c in self.centre)
        near = z - self.radius
        if z <= 0:
            return None
        near, far = max(near, 0.2 * z), z + self.radius
        # left of the axis the ball's near side is the outermost, right of it the far side is the innermost
        left, right = (min((x - self.radius) / d for d in (near, far)), max((x + self.radius) / d for d in (near, far)))
        top, bottom = (min((y - self.radius) / d for d in (near, far)), max((y + self.radius) / d for d in (near, far)))
        u0, u1 = camera.fx * left + camera.cx, camera.fx * right + camera.cx
        v0, v1 = camera.fy * top + camera.cy, camera.fy * bottom + camera.cy
        box = (
            max(0, int(np.floor(u0))),
            max(0, int(np.floor(v0))),
            min(camera.width, int(np.ceil(u1)) + 1),
            min(camera.height, int(np.ceil(v1)) + 1),
        )
        return box if box[0] < box[2] and box[1] < box[3] else None


@dataclass(frozen=True)
class Pixels:
    """Pixels with a reading: uv (n, 2) int, points (n, 3) camera frame, area: image pixels that each stands for."""

    uv: NDArray[np.int64]
    points: Array
    area: float

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: NDArray) -> Pixels:
        """The chosen pixels."""
        return Pixels(self.uv[index], self.points[index], self.area)

    def some(self, which: NDArray[np.bool_], most: int) -> Pixels:
        """Of the chosen (n,) at most `most`, as `thinned`: only these are copied."""
        chosen = np.flatnonzero(which)
        if len(chosen) <= most:
            return self.take(chosen)
        index = chosen[(np.arange(most) * len(chosen)) // most]
        return Pixels(self.uv[index], self.points[index], self.area * len(chosen) / most)

    def thinned(self, most: int) -> Pixels:
        """At most `most` of them, evenly over their order; each stands for more of the image."""
        if len(self) <= most:
            return self
        index = (np.arange(most) * len(self)) // most
        return Pixels(self.uv[index], self.points[index], self.area * len(self) / most)


def read_pixels(
    depth: NDArray[np.float32],
    camera: Camera,
    box: tuple[int, int, int, int],
    most: int,
    mask: NDArray[np.bool_] | None = None,
) -> Pixels:
    """At most about `most` valid pixels of a box, on an even grid; mask (h, w) restricts them."""
    u0, v0, u1, v1 = box
    area = (u1 - u0) * (v1 - v0)
    if mask is not None:
        area = int(mask[v0:v1, u0:u1].sum())
    stride = max(1, int(np.ceil(np.sqrt(area / most))))
    grid_u, grid_v = np.meshgrid(np.arange(u0, u1, stride), np.arange(v0, v1, stride))
    u, v = grid_u.ravel(), grid_v.ravel()
    z = depth[v, u]
    valid = is_reading(z)
    if mask is not None:
        valid &= mask[v, u]
    u, v, z = u[valid], v[valid], z[valid].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    return Pixels(np.stack([u, v], axis=1), points, float(stride * stride))
