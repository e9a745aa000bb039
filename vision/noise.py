"""How noisy a depth image is, by the image itself: what a camera is worth in this scene, whatever its data sheet says.

Most of what a camera sees is smooth. About the planes that fit small windows of it readings scatter by the camera's
noise, and by how the surface is bent; a quarter of all windows lie on what is flat enough for the former alone. Their
scatter beside what is believed says by how much the belief is too narrow: of the tuning families it is 1.05 where
noise is as believed, 1.62 and 2.16 where it is 1.42 and 1.92 times that at its least and grows in proportion.

Readings next to each other that scatter less than ones two pixels apart err together: each is an average over a
window, and blunts what is bent. Where each has its own noise, it does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.recordings.beliefs import LARGEST, Beliefs, DepthModel, usual_beliefs
from scenes.recordings.frames import Frame
from vision import noise_kernels
from vision.look.pixels import quantile

Array = NDArray[np.float64]

# What grows with the noise.
NOISY = ("axial_floor", "axial_growth", "bias_sigma")


@dataclass(frozen=True)
class NoiseSettings:
    """Where noise is read off, and what is made of it. By judgement, but for `usual`, tuned on the tuning families."""

    # Readings along each side of a window, and how far apart (px): a stereo camera's neighbours are wrong together, at
    # this distance they hardly are. And from window to window (px).
    count: int = 6
    apart: int = 4
    stride: int = 20
    # Depth (m) up to which windows are asked: farther off noise grows as it will.
    farthest: float = 1.5
    # Share of the windows that are flat, and windows without which nothing is told.
    flat: float = 0.25
    fewest: int = 20
    # Ratio (no unit) that is no news: most tuning families are as noisy as that, and everything was tuned on what they
    # show under the usual belief. Of 1 and this, 1 has nearly twice as many wrong answers that are `ok` (16 and 9 of
    # 2504), as nothing was fitted to what pictures are then worth.
    usual: float = 1.6
    # Most by which noise is taken to be larger than that (a factor), where no less is believed than of a usual camera
    # at this depth (m): of one that is said to be finer it is as much more. Never smaller: what is smooth may be
    # smoothed.
    most: float = 2.5
    at: float = 0.6
    # Scatter (a share) of neighbours beside that of readings two pixels apart from which on each reads its own place,
    # and up to which it averages over all of a window. Of the tuning families it is 0.88 to 1.03 where noise is a
    # pixel's own, 0.81 to 0.89 where depth was registered to a larger image, 0.3 to 0.74 of windows and filters.
    own: float = 0.9
    shared: float = 0.5
    # Windows across an image in which neighbours are compared, and up to which depth (m): walls tell as well.
    across: int = 32
    deepest: float = 5.0


def noise_ratio(depth: ArrayLike, believed: DepthModel, settings: NoiseSettings | None = None) -> float:
    """Noise of a depth image (h, w) m beside what is believed of it, no unit; NaN where too little is flat."""
    s = settings or NoiseSettings()
    scatter, z = _scatter(depth, s.apart, s.stride, s.farthest, s)
    if len(z) < s.fewest:
        return float("nan")
    return quantile(scatter / believed.independent_sigma(z), s.flat)


def grain(depth: ArrayLike, settings: NoiseSettings | None = None) -> float:
    """Scatter of a depth image (h, w) m from pixel to pixel beside that of readings two pixels apart, no unit: 1 where
    each errs by itself; NaN where too little is flat.
    """
    s = settings or NoiseSettings()
    # as many windows of a small image as of a large one
    stride = max(min(np.shape(depth)[1] // s.across, s.stride), 1)
    (fine, near), (coarse, far) = (_scatter(depth, apart, stride, s.deepest, s) for apart in (1, 2))
    if min(len(near), len(far)) < s.fewest:
        return float("nan")
    return quantile(fine / near, s.flat) / max(quantile(coarse / far, s.flat), 1e-12)


def _scatter(depth: ArrayLike, apart: int, stride: int, farthest: float, s: NoiseSettings) -> tuple[Array, Array]:
    """Of windows `stride` pixels apart, of readings `apart` pixels apart, no farther than `farthest` (m), their scatter
    (n,) m about a plane, and their depth (n,) m.
    """
    image = np.ascontiguousarray(depth, dtype=np.float32)
    rows, columns = (-(-size // stride) for size in image.shape)
    found = np.zeros((rows * columns, 2))
    count = noise_kernels.scatter_on_planes(image, apart, s.count, stride, farthest, found)
    return found[:count, 0], found[:count, 1]


def window_of(depth: ArrayLike, believed: float, settings: NoiseSettings | None = None) -> float:
    """How far (px, to either side) readings of a depth image (h, w) m average: at most as is believed, less where they
    err by themselves.
    """
    s = settings or NoiseSettings()
    shown = grain(depth, s) if believed > 0.0 else 0.0
    if not shown > s.shared:  # not true of NaN either
        return believed
    return believed * max(s.own - shown, 0.0) / (s.own - s.shared)


def believed_of(frame: Frame, beliefs: Beliefs, settings: NoiseSettings | None = None) -> Beliefs:
    """The beliefs, through the frame's lens, its window as narrow as the frame shows it, with the camera's noise and
    its bias from place to place larger by as much as it shows beyond what is usual. Of a camera that is told, too: a
    data sheet knows no walls without texture, and one who measured has a ratio of 1.
    """
    s = settings or NoiseSettings()
    if frame.depth is None:
        return beliefs
    if frame.camera is not None:
        through = beliefs.depth.through(frame.camera.fx)
        window = window_of(frame.depth, through.window, s)
        through = through if window == through.window else replace(through, window=window)
        beliefs = beliefs if through is beliefs.depth else replace(beliefs, depth=through)
    ratio = noise_ratio(frame.depth, beliefs.depth, s) / s.usual
    if not ratio > 1.0:  # not true of NaN either
        return beliefs
    known = beliefs.depth
    there = np.array(s.at)
    finer = float(usual_beliefs().depth.independent_sigma(there) / known.independent_sigma(there))
    times = min(ratio, s.most * max(finer, 1.0))
    # no more than a belief may say: of noise alone, a ratio is anything
    larger = {name: min(times * getattr(known, name), LARGEST[name]) for name in NOISY}
    return replace(beliefs, depth=replace(known, **larger))
