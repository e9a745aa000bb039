"""Pixels with a reading, as points; and the ball of the world that is looked at. Camera frame, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera
from vision.look import pixel_kernels as kernels

Array = NDArray[np.float64]

# Any pixel.
NO_MASK = np.zeros((0, 0), dtype=bool)


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
        area = int(np.count_nonzero(mask[v0:v1, u0:u1]))
    stride = max(1, int(np.ceil(np.sqrt(area / most))))
    room = min(area, max(0, -(-(u1 - u0) // stride)) * max(0, -(-(v1 - v0) // stride)))
    uv, points = np.zeros((room, 2), dtype=np.int64), np.zeros((room, 3))
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    within = NO_MASK if mask is None else np.ascontiguousarray(mask, dtype=bool)
    count = kernels.read(np.ascontiguousarray(depth), lens, box, stride, within, uv, points)
    return Pixels(uv[:count], points[:count], float(stride * stride))


@dataclass(frozen=True)
class Sorted:
    """Pixels with a reading on an even grid of a box, by whether they are chosen: which (rows, columns), and counts."""

    depth: NDArray[np.float32]
    lens: tuple[float, float, float, float]
    box: tuple[int, int, int, int]
    stride: int
    which: NDArray[np.int8]
    counts: dict[int, int]

    def some(self, kind: int, most: int) -> Pixels:
        """At most `most` pixels of a kind, evenly over their order; each stands for more of the image."""
        count, area = self.counts[kind], float(self.stride**2)
        kept = min(count, most)
        uv, points = np.zeros((kept, 2), dtype=np.int64), np.zeros((kept, 3))
        if kept:
            kernels.take(self.depth, self.lens, self.box, self.stride, self.which, kind, count, uv, points)
        return Pixels(uv, points, area * count / most if count > most else area)


def sort_pixels(
    depth: NDArray[np.float32],
    camera: Camera,
    box: tuple[int, int, int, int],
    most: int,
    region: Region | None,
    mask: NDArray[np.bool_] | None,
    planes: tuple[Array, tuple[float, float, float], tuple[float, float]],
) -> Sorted:
    """Of about `most` pixels of a box, as of `read_pixels`, those in the region and the mask (h, w), off the planes (as
    mask.for_kernels has them), are chosen.
    """
    u0, v0, u1, v1 = box
    stride = max(1, int(np.ceil(np.sqrt((u1 - u0) * (v1 - v0) / most))))
    which = np.zeros((-(-(v1 - v0) // stride), -(-(u1 - u0) // stride)), dtype=np.int8)
    lens, depth = (camera.fx, camera.fy, camera.cx, camera.cy), np.ascontiguousarray(depth)
    ball = (0.0, 0.0, 0.0, np.inf) if region is None else (*(float(x) for x in region.centre), float(region.radius))
    within = NO_MASK if mask is None else np.ascontiguousarray(mask, dtype=bool)
    counts = kernels.sort(depth, lens, box, stride, within, ball, *planes, which)
    return Sorted(depth, lens, box, stride, which, dict(zip((kernels.CHOSEN, kernels.OTHER), counts)))


def median(values: NDArray) -> NDArray:
    """Median along the first axis of at least one finite value; NumPy's own takes many times as long on few."""
    half, even = len(values) // 2, len(values) % 2 == 0
    parted = np.partition(values, (half - 1, half) if even else half, axis=0)
    return np.asarray((parted[half - 1] + parted[half]) / 2 if even else parted[half])


def quantile(values: NDArray, share: float) -> float:
    """What a share of at least one finite value (n,) is below: NumPy's bits, whose own way takes many times as long."""
    place = share * (len(values) - 1)
    low = int(place)
    parted, part = np.partition(values, (low, min(low + 1, len(values) - 1))), place - low
    first, second = float(parted[low]), float(parted[min(low + 1, len(values) - 1)])
    # the nearer of the two is begun at: each is met exactly
    return first + (second - first) * part if part < 0.5 else second - (second - first) * (1.0 - part)
