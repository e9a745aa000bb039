"""How noisy a depth image is, by the image itself: what a camera is worth in this scene, whatever its data sheet says.

Most of what a camera sees is smooth. About the planes that fit small windows of it readings scatter by the camera's
noise, and by how the surface is bent; a quarter of all windows lie on what is flat enough for the former alone. Their
scatter beside what is believed says by how much the belief is too narrow: of the tuning families it is 1.05 where
noise is as believed, 1.62 and 2.16 where it is 1.42 and 1.92 times that at its least and grows in proportion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from scenes.recordings.beliefs import LARGEST, Beliefs, DepthModel, usual_beliefs
from scenes.recordings.frames import Frame
from vision import noise_kernels
from vision.look.pixels import quantile

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


def noise_ratio(depth: ArrayLike, believed: DepthModel, settings: NoiseSettings | None = None) -> float:
    """Noise of a depth image (h, w) m beside what is believed of it, no unit; NaN where too little is flat."""
    s, image = settings or NoiseSettings(), np.ascontiguousarray(depth, dtype=np.float32)
    rows, columns = (-(-size // s.stride) for size in image.shape)
    found = np.zeros((rows * columns, 2))
    count = noise_kernels.scatter_on_planes(image, s.apart, s.count, s.stride, s.farthest, found)
    if count < s.fewest:
        return float("nan")
    scatter, z = found[:count].T
    return quantile(scatter / believed.independent_sigma(z), s.flat)


def believed_of(frame: Frame, beliefs: Beliefs, settings: NoiseSettings | None = None) -> Beliefs:
    """The beliefs, through the frame's lens, with the camera's noise and its bias from place to place larger by as much
    as the frame shows beyond what is usual. Of a camera that is told, too: a data sheet knows no walls without texture,
    and one who measured has a ratio of 1.
    """
    s = settings or NoiseSettings()
    if frame.depth is None:
        return beliefs
    if frame.camera is not None:
        through = beliefs.depth.through(frame.camera.fx)
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
