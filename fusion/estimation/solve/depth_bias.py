"""A smooth error of depth over the image: a Gaussian process on a few inducing pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.solve.kernels import lay_bells, mark_near, places
from scenes.geometry.cameras import Camera
from scenes.recordings.beliefs import DepthModel

Array = NDArray[np.float64]

# How much farther apart inducing pixels are tried where there would be too many.
COARSER = 1.2


def _no_lines() -> tuple[Array, NDArray[np.int64], Array, NDArray[np.int64]]:
    none = np.zeros(0, dtype=np.int64)
    return np.zeros(0), none, np.zeros(0), none


@dataclass(frozen=True)
class DepthBias:
    """inducing (k, 2) pixels; factor (k, k): the lower Cholesky factor of their covariance in units of the bias' own
    standard deviation; length: of the correlation exp(-|u - v|^2 / (2 length^2)), pixels. k is 0 without a camera.
    lines: columns and rows (px) on which inducing pixels lie, each with which of them is each pixel's (k,).
    """

    camera: Camera | None
    inducing: Array
    factor: Array
    length: float
    lines: tuple[Array, NDArray[np.int64], Array, NDArray[np.int64]] = field(default_factory=_no_lines)

    @staticmethod
    def over(
        camera: Camera | None,
        points: Array,
        depth: DepthModel,
        spacing: float,
        most: int,
        known: DepthBias | None = None,
    ) -> DepthBias:
        """Inducing pixels at most `most`, `spacing` correlation lengths apart, where points (n, 3) camera frame are
        seen. Where so few are not enough the bias is as much smoother as they are farther apart: of the length that is
        believed it would be next to none between them, and what is seen from near by much surer than one patch is.
        known: one of the same camera, which is it again where its inducing pixels are the same.
        """
        length = depth.bias_length
        if camera is None or not len(points):
            return DepthBias(camera, np.zeros((0, 2)), np.zeros((0, 0)), length)
        uv, (low, high) = _places(camera, points)
        step = spacing * length
        while True:
            counts = np.maximum(1.0, np.ceil((high - low) / step)) + 1.0
            if counts.prod() <= 4 * most:  # as floats: steps may be so small that whole numbers run over
                u, v = (np.linspace(a, b, int(n)) for a, b, n in zip(low, high, counts))
                column, row = np.tile(np.arange(len(u)), len(v)), np.repeat(np.arange(len(v)), len(u))
                grid = np.stack([u[column], v[row]], axis=1)
                near = _is_near(grid, uv, step)
                grid, column, row = grid[near], column[near], row[near]
                if len(grid) <= most:
                    break
            step *= COARSER
        length = max(length, step / spacing)
        if known is not None and known.length == length and np.array_equal(known.inducing, grid):
            return known
        kernel = _kernel(grid, grid, length) + 1e-6 * np.eye(len(grid))
        factor = np.asarray(np.linalg.cholesky(kernel), dtype=np.float64)
        return DepthBias(camera, grid, factor, length, (u, column, v, row))

    @cached_property
    def _whitening(self) -> Array:
        """(k, k) the factor's inverse."""
        return np.asarray(np.linalg.inv(self.factor), dtype=np.float64)

    def __len__(self) -> int:
        return len(self.inducing)

    def basis(self, points: Array) -> Array:
        """(n, k) bias at the pixels of points (n, 3) per whitened unknown, in units of the bias' sigma."""
        if self.camera is None or not len(self) or not len(points):
            return np.zeros((len(points), len(self)))
        uv, _ = _places(self.camera, points)
        out = np.zeros((len(points), len(self)))
        lay_bells(uv, *self.lines, -0.5 / self.length**2, out)
        return np.asarray(out @ self._whitening.T, dtype=np.float64)


def _places(camera: Camera, points: Array) -> tuple[Array, Array]:
    """Pixels (n, 2) of points (n, 3), and the least and the largest of them (2, 2)."""
    uv, bounds = np.zeros((len(points), 2)), np.zeros((2, 2))
    lens = float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)
    places(np.ascontiguousarray(points, np.float64), lens, uv, bounds)
    return uv, bounds


def _is_near(grid: Array, uv: Array, reach: float) -> NDArray[np.bool_]:
    """(k,) whether any of uv (n, 2) is nearer than `reach` to grid (k, 2), all pixels."""
    out = np.zeros(len(grid), dtype=bool)
    mark_near(grid, uv, float(reach), out)
    return out


def _kernel(a: Array, b: Array, length: float) -> Array:
    # axis by axis: no array of differences, n by m by 2
    square = np.square(a[:, None, 0] - b[None, :, 0]) + np.square(a[:, None, 1] - b[None, :, 1])
    return np.asarray(np.exp(square * (-0.5 / length**2)), dtype=np.float64)
