"""The dots of a projector as a texture over the tangents of its directions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.synthesis.optics.settings import Pattern

Image = NDArray[np.float32]

# Tangents that a pattern reaches to, left and right, up and down: no camera here sees farther aside.
REACH = 1.6
# Side of the haze's grains (tangent).
HAZE_GRAIN = 0.004


@dataclass(frozen=True)
class Texture:
    """Light (h, w) over tangents: texel (row, column) is at ((column - cx) / scale, (row - cy) / scale)."""

    light: Image
    scale: float
    cx: float
    cy: float


@lru_cache(maxsize=4)
def pattern_texture(
    pattern: Pattern, seed: int, scale: float, left: float, right: float, top: float, bottom: float
) -> Texture:
    """The part between the tangents given of the pattern of this seed, `scale` texels to a tangent of 1; mean power."""
    rng = np.random.default_rng([seed, 1])
    cell = 1.0 / np.sqrt(pattern.density)
    count = int(np.ceil(2 * REACH / cell))
    place = rng.random((2, count, count), dtype=np.float32)
    strength = 1.0 + pattern.spread * (2.0 * rng.random((count, count), dtype=np.float32) - 1.0)
    grid = np.arange(count, dtype=np.float64) * cell - REACH
    x, y = grid[None] + place[0] * cell, grid[:, None] + place[1] * cell
    margin = 5 * pattern.radius
    near = (x > left - margin) & (x < right + margin) & (y > top - margin) & (y < bottom + margin)
    shape = (int(np.ceil((bottom - top) * scale)) + 2, int(np.ceil((right - left) * scale)) + 2)
    light = np.zeros(shape, dtype=np.float32)
    # a dot of radius r texels carries 2 pi r^2 of its peak; the mean over a cell is to be the dots' share
    radius = pattern.radius * scale
    share = pattern.power * (1.0 - pattern.haze) * (cell * scale) ** 2 / (2 * np.pi * radius**2)
    _add_dots(light, (x[near] - left) * scale, (y[near] - top) * scale, strength[near] * share, radius)
    light += _haze(shape, pattern, scale, left, top, np.random.default_rng([seed, 2]))
    return Texture(light, scale, -left * scale, -top * scale)


def _haze(
    shape: tuple[int, int], pattern: Pattern, scale: float, left: float, top: float, rng: np.random.Generator
) -> Image:
    import cv2

    count = int(np.ceil(2 * REACH / HAZE_GRAIN))
    # interpolation between grains takes away a good half of their standard deviation
    grains = np.maximum(1.0 + 1.5 * pattern.haze_grain * rng.standard_normal((count, count), dtype=np.float32), 0.0)
    pitch = 1.0 / (scale * HAZE_GRAIN)
    affine = np.array([[pitch, 0.0, (left + REACH) / HAZE_GRAIN], [0.0, pitch, (top + REACH) / HAZE_GRAIN]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    haze = cv2.warpAffine(grains, affine, (shape[1], shape[0]), flags=flags, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(haze * np.float32(pattern.power * pattern.haze), dtype=np.float32)


@numba.njit(cache=True, nogil=True)
def _add_dots(light, columns, rows, strengths, radius):  # type: ignore[no-untyped-def]
    """Add Gaussian dots of peak `strengths` (n,) and standard deviation `radius` (texels) to light (h, w)."""
    reach = int(np.ceil(4.0 * radius))
    for k in range(len(columns)):
        u, v = round(columns[k]), round(rows[k])
        for row in range(max(0, v - reach), min(light.shape[0], v + reach + 1)):
            for column in range(max(0, u - reach), min(light.shape[1], u + reach + 1)):
                square = (row - rows[k]) ** 2 + (column - columns[k]) ** 2
                light[row, column] += strengths[k] * np.exp(-0.5 * square / radius**2)
