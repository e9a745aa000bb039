"""What a depth image is worth: pixels to points, their noise, and how much of it averaging does not remove."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera, is_reading

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DepthModel:
    """The estimator's belief about a depth camera (structured light or stereo at arm's length).

    Independent noise follows Nguyen, Izadi & Lovell (3DIMPVT 2012); the rest is what calibration reports of such
    cameras agree on (Basso, Menegatti & Pretto, IEEE T-RO 2018: smooth local distortion and a global depth error).
    """

    # Axial noise at 0.4 m and its growth, metres and 1/metres.
    axial_floor: float = 0.0012
    axial_growth: float = 0.0019
    # Where the surface slopes there is more: a pixel reads the depth of a place beside its own (pixels; Nguyen et al.,
    # eq. 2), and beyond 60 degrees of incidence the axial noise grows (metres^1.5; eq. 4).
    lateral_sigma: float = 0.8
    lateral_growth: float = 0.035
    axial_steep: float = 0.0001
    # Smooth bias of the surface, metres, and the correlation length of that bias in pixels: exp(-d^2 / (2 length^2)).
    bias_sigma: float = 0.002
    bias_length: float = 40.0
    # In the search rows are weighed down instead: rows within this many pixels count as one. A bias so smooth moves and
    # tilts what is seen but leaves its shape, hence less than its length; but where neither mask nor hand model tells
    # what is in front, whole fingers and not single pixels are taken for the object, and they outvote the contacts.
    sharing_length: float = 12.0
    sharing_length_unknown: float = 40.0
    # A cloud without its camera says nothing of its noise: error of a filtered stereo cloud in a hand's frame, metres,
    # and how many independent patches its points amount to.
    cloud_sigma: float = 0.0035
    cloud_patches: float = 30.0
    # Relative error of the depth scale.
    scale_sigma: float = 0.005

    def independent_sigma(self, depth: Array) -> Array:
        """Standard deviation (m) of one pixel's independent noise at depth (m)."""
        return self.axial_floor + self.axial_growth * np.square(depth - 0.4)

    def sloping_sigma(self, depth: Array, cosine: Array, focal: float) -> Array:
        """Standard deviation (m) along its ray of a pixel whose ray meets the surface at an incidence of this cosine.

        depth (m), cosine (above 0), focal length in pixels.
        """
        theta = np.arccos(np.clip(cosine, 0.0, 1.0))
        past = np.maximum(0.5 * np.pi - theta, 1e-2)
        steep = self.axial_steep / np.sqrt(np.maximum(depth, 0.05)) * np.square(theta / past)
        axial = self.independent_sigma(depth) + np.where(theta > np.deg2rad(60.0), steep, 0.0)
        lateral = (self.lateral_sigma + self.lateral_growth * theta / past) * depth / focal
        return np.asarray(np.hypot(axial, lateral * np.tan(theta)), dtype=np.float64)


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
