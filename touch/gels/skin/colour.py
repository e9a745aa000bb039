"""What a pressed gel's image differs by from its background: where the skin moved, and how sure that is.

Lights shine on the skin from its sides, so its slopes change its colours. A pixel counts as moved when its colours,
smoothed over the grain, differ by more than the image's own noise; what such pixels enclose moved, too (where the
object's slope happens to be the skin's own, nothing changes). Images (h, w, 3) uint8, red first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.robot.gels import Gel
from touch.gels.skin.colour_kernels import judge, most_frequent

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Steps of the mean shift to the most frequent colour, and the least share of all pixels that must be alike there.
SHIFTS, FEWEST_ALIKE = 5, 0.03


@dataclass(frozen=True)
class ColourSettings:
    """How a difference of colours is judged, in counts of 255. Values by judgement."""

    # Smoothing of the difference (pixels, standard deviation): a sensor's grain is gone, outlines stay.
    blur: float = 2.0
    # Sigmas of the smoothed noise, all channels together, from which a pixel has moved; three channels of pure noise
    # are beyond 4.5 in one of 10,000 pixels.
    sigmas: float = 4.5
    # Least difference (counts, no unit) that counts: images kept as JPEG are wrong by about as much.
    least: float = 2.5
    # Share of the moved pixels' usual difference above which a pixel belongs to the core: skin that only bridges to
    # what is touched changes less.
    core: float = 0.4
    # Largest drift of the exposure (share): beyond, it is the contact's own. Darker pixels (counts) tell none.
    drift: float = 0.05
    darkest: float = 12.0
    # What channels drift apart by (share) when it may as well be skin that bridges: an exposure is one for all. More is
    # a lamp's or a white balance's own.
    apart: float = 0.005
    # Gaps closed and specks dropped, pixels across (a tenth of a millimetre or two).
    gap: int = 7
    # Smaller moved areas, as a share of the image, are specks.
    smallest: float = 0.001
    # Smaller areas between moved ones and the image's border, as a share of it, are no untouched skin: a corner under
    # an object whose slope there happens to be the skin's own looks so, comes and goes with the grain, and would hold
    # the height at nothing. This is 1 mm across in a DIGIT; larger corners of recorded images are untouched indeed.
    island: float = 0.004


@dataclass(frozen=True)
class Moved:
    """On the gel's working pixels: difference (h, w, 3) float32 smoothed colour counts; noise: its standard deviation a
    channel (3,); inside (h, w): where the skin moved; core (h, w): where it changed about as much as it usually did;
    edge: uncertainty (working pixels) of the outline.
    """

    difference: NDArray[np.float32]
    noise: Array
    inside: Mask
    core: Mask
    edge: float


def moved_skin(image: NDArray[np.uint8], gel: Gel, settings: ColourSettings | None = None) -> Moved:
    """Where the skin moved in an image of the gel's own size; the gel has a background."""
    import cv2

    settings = settings or ColourSettings()
    assert gel.background is not None
    step = gel.working_step
    raw: NDArray[np.float32] = np.asarray(cv2.subtract(image, gel.background, dtype=cv2.CV_32F), dtype=np.float32)
    blurred: NDArray[np.float32] = np.ascontiguousarray(
        cv2.GaussianBlur(raw, (0, 0), settings.blur)[::step, ::step], dtype=np.float32
    )
    # grain: differences of neighbours, which a slope hardly changes; white grain smoothed with this width is left with
    # 1 / (2 sqrt(pi) width) of it
    noise = 1.4826 / np.sqrt(2.0) * _median_gap(raw[:: 2 * step], step)
    noise = np.maximum(noise / (2.0 * np.sqrt(np.pi) * settings.blur), 0.3)
    # exposure drifts as a whole: pixels about the most frequent relative difference are the untouched ones
    level = np.maximum(gel.working.level, np.float32(settings.darkest))
    drift = most_frequent((blurred[::2, ::2] / level[::2, ::2]).reshape(-1, 3), settings.drift, SHIFTS, FEWEST_ALIKE)
    common, own = drift.mean(), drift - drift.mean()
    drift = common + own * float(own @ own / (own @ own + 3.0 * settings.apart**2))
    smooth, size, counts = np.zeros_like(blurred), *np.zeros((2, *blurred.shape[:2]), dtype=np.float32)
    judge(blurred, level, drift, noise, smooth, size, counts)
    moved = ((size > settings.sigmas) & (counts > settings.least)).astype(np.uint8)
    gap = max(3, settings.gap // step | 1)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap))
    moved = cv2.morphologyEx(moved, cv2.MORPH_OPEN, kernel)
    moved = cv2.morphologyEx(moved, cv2.MORPH_CLOSE, kernel)
    inside = _filled(np.asarray(moved, dtype=np.uint8), settings.smallest * moved.size)
    inside |= _small_pieces(~inside, settings.island * moved.size)
    # an outline is as sharp as the smoothing, sharpened by how far beyond the noise the difference is
    strength = float(np.median(size[inside])) if inside.any() else 1.0
    edge = settings.blur / step * float(np.clip(np.sqrt(settings.sigmas / max(strength, 1e-9)), 0.5, 2.0))
    usual = settings.core * float(np.median(counts[inside])) if inside.any() else 0.0
    core = cv2.morphologyEx((inside & (counts > usual)).astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    return Moved(smooth, noise, inside, _filled(np.asarray(core, dtype=np.uint8), 1.0), edge)


def _median_gap(rows: NDArray[np.float32], step: int) -> Array:
    """(3,) median absolute difference of neighbours in every step-th column of whole counts rows (h, w, 3)."""
    after = rows[:, 1::step]
    gaps = np.abs(after - rows[:, :-1:step][:, : after.shape[1]]).astype(np.int64)
    most, half = 511, 0.5 * (gaps.shape[0] * gaps.shape[1])
    counted = np.bincount((gaps + most * np.arange(3)).ravel(), minlength=3 * most).reshape(3, most).cumsum(axis=1)
    # the mean of the two in the middle of an even number
    return np.array([0.5 * (np.searchsorted(c, half) + np.searchsorted(c, half, side="right")) for c in counted])


def _filled(moved: NDArray[np.uint8], smallest: float) -> Mask:
    """Pieces of at least `smallest` pixels with what they enclose."""
    import cv2

    outlines, _ = cv2.findContours(moved, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = np.zeros(moved.shape, dtype=np.uint8)
    chosen = [outline for outline in outlines if cv2.contourArea(outline) >= smallest]
    cv2.drawContours(out, chosen, -1, 1, thickness=cv2.FILLED)
    return out.astype(bool)


def _small_pieces(mask: Mask, smallest: float) -> Mask:
    """Connected pieces of mask (h, w) with fewer than `smallest` pixels."""
    import cv2

    _, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] < smallest
    small[0] = False  # what is not in the mask
    return np.asarray(small[label])
