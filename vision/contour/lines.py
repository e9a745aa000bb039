"""Lines across an outline: where on each the image changes from the object's colours to those of what is behind.

Region-based correspondence lines (Stoiber, Pfanne, Strobl, Triebel and Albu-Schaeffer, "SRT3D", IJCV 2022): colours
inside and outside are learned in this image, here from the lines nearby, and each line has a probability of every
offset of the border (px, positive away from the object).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vision.contour import kernels
from vision.contour.outline import Outline
from vision.look.pixels import median

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LineSettings:
    """What is read of an image across an outline. By judgement, on the tuning family `d435`."""

    # Offsets (px) that the border is looked for in, and what is read beyond them on either side to learn colours.
    reach: int = 12
    beyond: int = 5
    # Samples this near to the outline (px) teach no colour: the pose may be off by so much.
    gap: int = 1
    # Side of the median filter (px): dots of a projector, grain.
    median: int = 3
    # Levels of grey, and of each channel of colour, between the darkest and brightest percent.
    greys: int = 32
    levels: int = 8
    # Places along the outline that have colours of their own, and how far these are learned from: a share of the
    # outline's size; all other lines count this much.
    groups: int = 16
    spread: float = 0.15
    everywhere: float = 0.02
    # Share of the samples whose colour says nothing (highlights, dots, what the lines nearby do not have).
    unknown: float = 0.02
    # Power of the likelihood: smoothed colours understate how well a line tells. Measured at true poses of `d435`,
    # where lines with a standard deviation of 0.6 px are off by 0.3 px (median absolute deviation).
    temper: float = 1.5
    # Samples (px from the outline, first and last) on either side that must look like that side, and how clearly (nats
    # a sample): an edge within the object is no border, however clear it is.
    near: tuple[int, int] = (2, 5)
    clear: float = 0.1
    # An edge whose change is this share of the contrast is half as strong as any.
    edge_share: float = 0.2
    # Contrast (levels of 255) between the darkest and brightest percent below which nothing is told, and the share of
    # samples at the bright end of the scale from which on the image is overexposed.
    contrast: float = 12.0
    clipped: float = 0.6
    # Width (px, standard deviation of the step that an edge is smeared by; median of the clearest half of the lines)
    # from which on the image is blurred: sharp ones have 0.7 to 1.6 px on `d435` and `lab`.
    blurred: float = 3.5


@dataclass(frozen=True)
class Lines:
    """log_p (n, m): log probability of the offsets lowest, lowest + 1, ... (px) on the lines of an outline. edges (n,
    2 reach + 1): how much the image changes across each whole offset, 0 to 1, whatever the colours. samples (n, k, c):
    the image at every whole offset, k // 2 the outline's own. grey: the image has no colours, as that of an infra-red
    camera. why_not: why it tells nothing; "" when it does.
    """

    outline: Outline
    log_p: Array
    lowest: float
    edges: Array
    samples: NDArray[np.uint8]
    grey: bool = False
    why_not: str = ""

    def __len__(self) -> int:
        return len(self.outline)

    @property
    def clear(self) -> int:
        """Lines whose own samples look like their sides: the others' tables are even."""
        return int((np.ptp(self.log_p, axis=1) > 0.0).sum())


def is_grey(image: NDArray[np.uint8]) -> bool:
    """Whether an image (h, w, 3) has no colours, as that of an infra-red camera."""
    return bool(kernels.is_grey(image))


def lines_across(image: NDArray[np.uint8], outline: Outline, settings: LineSettings | None = None) -> Lines:
    """Read image (h, w, 3) across an outline of at least one place."""
    import cv2

    s = settings or LineSettings()
    reach = s.reach + s.beyond
    low = np.maximum(np.floor(outline.places.min(axis=0)).astype(int) - reach - 2, 0)
    high = np.minimum(np.ceil(outline.places.max(axis=0)).astype(int) + reach + 3, [image.shape[1], image.shape[0]])
    part = image[low[1] : high[1], low[0] : high[0]]
    grey = is_grey(part)
    part = np.ascontiguousarray(part[..., 0] if grey else part)
    if s.median > 1:
        part = np.asarray(cv2.medianBlur(part, s.median), dtype=np.uint8)
    offsets = np.arange(-reach, reach + 1)
    columns, rows = np.zeros((2, len(outline), len(offsets)), dtype=np.float32)
    kernels.places_across(outline.places, outline.normals, -reach, low, columns, rows)
    read = cv2.remap(part, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = np.asarray(read, dtype=np.uint8)
    log_p = np.zeros((len(outline), 2 * s.reach + 2))
    samples = colours.reshape(*colours.shape[:2], -1)
    why_not, edges, levels = _looked_over(samples, s)
    if why_not:
        return Lines(outline, log_p, -s.reach - 0.5, edges, samples, grey, why_not)
    bins, count = _binned(samples, levels, grey, s)
    ratios, group = _ratios(bins, count, offsets, outline, grey, s)
    sides = np.zeros((len(outline), 2))
    kernels.offset_tables(bins, ratios, group, s.temper, s.beyond, np.array(s.near), log_p, sides)
    log_p[(sides[:, 0] < s.clear) | (sides[:, 1] > -s.clear)] = -np.log(log_p.shape[1])
    return Lines(outline, log_p, -s.reach - 0.5, edges, samples, grey)


def _percents(counts: NDArray[np.int64]) -> tuple[float, float]:
    """The darkest and the brightest percent: the levels up to which the first and the 99th percent of all counted
    (256,) are.
    """
    below = counts.cumsum()
    low, high = np.searchsorted(below, [0.01 * below[-1], 0.99 * below[-1]])
    return float(low), float(high)


def _looked_over(samples: NDArray[np.uint8], settings: LineSettings) -> tuple[str, Array, NDArray[np.int64]]:
    """Why samples (n, k, c) tell nothing: dark, flat, badly exposed or blurred; "" when they do. And (n, 2 reach + 1)
    how much they change over two pixels on either side of each offset, relative to the image's contrast: 0 for none,
    saturating at 1; and (c, 256) how many of each channel have each level.

    Blur: a step h that is smeared by sigma rises by h / (sigma sqrt(2 pi)) a pixel at most; the median of the half of
    the lines with the largest steps.
    """
    s, count = settings, len(samples)
    brightest, height, slope = np.zeros(256, dtype=np.int64), np.zeros(count), np.zeros(count)
    change, levels = np.zeros((count, 2 * s.reach + 1)), np.zeros((samples.shape[2], 256), dtype=np.int64)
    kernels.contrasts(samples, s.beyond - 2, levels, brightest, height, slope, change)
    low, high = _percents(levels.sum(axis=0))
    edges = change / (change + s.edge_share * max(high - low, 1.0))
    low, high = _percents(brightest)
    if high < s.contrast:
        return f"the image is dark: {high:.0f} of 255 at most around the outline", edges, levels
    over = float(brightest[255] / brightest.sum())
    if over > s.clipped:
        return f"the image is overexposed: {over:.0%} of what surrounds the outline", edges, levels
    if high - low < s.contrast:
        return f"the image has no contrast: {high - low:.0f} levels of 255 around the outline", edges, levels
    clear = height >= median(height)
    width = float(median(height[clear] / (np.sqrt(2.0 * np.pi) * np.maximum(slope[clear], 0.5))))
    if width > s.blurred:
        return f"the image is blurred: edges around the outline are {width:.0f} px wide", edges, levels
    return "", edges, levels


def _binned(
    samples: NDArray[np.uint8], counts: NDArray[np.int64], grey: bool, settings: LineSettings
) -> tuple[NDArray[np.int64], int]:
    """(n, k) the bin of the colour of each of samples (n, k, c), and how many bins there are; levels lie between the
    darkest and brightest of a channel, of which counts (c, 256) says how many have each.
    """
    levels = settings.greys if grey else settings.levels
    out = np.zeros(samples.shape[:2], dtype=np.int64)
    for channel, counted in enumerate(counts):
        low, high = _percents(counted)
        level = np.clip((np.arange(256) - low) / max(high - low, 1.0) * levels, 0, levels - 1).astype(np.int64)
        out = out * levels + level[samples[..., channel]]
    return out, int(levels ** len(counts))


def _ratios(
    bins: NDArray[np.int64],
    count: int,
    offsets: NDArray[np.int64],
    outline: Outline,
    grey: bool,
    settings: LineSettings,
) -> tuple[Array, NDArray[np.int64]]:
    """Log of how much likelier a colour (b) is inside than outside in each group (g, b); each line's group (n,)."""
    s = settings
    middle = outline.places.mean(axis=0)
    order = np.argsort(np.arctan2(*(outline.places - middle).T[::-1]), kind="stable")
    anchors = order[np.linspace(0, len(order), s.groups, endpoint=False).astype(int)]
    u, v = outline.places.T
    apart = np.square(u[anchors, None] - u) + np.square(v[anchors, None] - v)
    width = s.spread * float(np.ptp(outline.places, axis=0).max()) + 2.0
    weight = np.exp(-0.5 * apart / width**2) + s.everywhere
    sides = np.zeros((2, count, len(anchors)))
    inner, outer = int((offsets < -s.gap).sum()), int((offsets <= s.gap).sum())
    kernels.tally(bins, np.ascontiguousarray(weight.T), inner, outer, sides)
    kernels.smooth(sides, s.greys if grey else s.levels, np.zeros_like(sides))
    seen = np.ascontiguousarray(sides.swapaxes(1, 2))
    shares = seen / np.maximum(seen.sum(axis=2, keepdims=True), 1e-9) + s.unknown
    return np.log(shares[0] / shares[1]), np.argmin(apart, axis=0)
