"""Disparity of two rectified infra-red images, by OpenCV's matchers, as the processors of depth cameras find it.

Images are first freed of their local mean and contrast, so that light which falls off and things that are darker do not
matter; windows whose contrast is that of their noise are not read. The matcher's disparities are refined by the slope
of the image in a Gaussian window (Lucas and Kanade 1981, along the row): OpenCV's parabola prefers whole pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.synthesis.optics.light.infrared import Counts
from scenes.synthesis.optics.settings import Matcher

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Standard deviation (px) of the window whose mean and contrast are taken away.
LOCAL = 6.0
# Counts of the matcher's images per local standard deviation; 8 bits hold +- 4.
SCALE = 32.0
# Slopes below this share of the mean square slope tell no shift (no unit).
LEAST_SLOPE = 0.005
# Largest change (px) by the refinement: beyond it the matcher was on another dot.
LARGEST_REFINEMENT = 1.0
# OpenCV's disparities are whole numbers of 1/16 px.
SIXTEENTHS = 16.0


def normalised(image: Image, floor: Image | float) -> tuple[Image, Image]:
    """An image (h, w) without its local mean, over its local standard deviation, and that deviation; `floor` (in the
    image's unit) is added to it.
    """
    import cv2

    mean = cv2.GaussianBlur(image, (0, 0), LOCAL)
    less = image - mean
    deviation = np.sqrt(cv2.GaussianBlur(less * less, (0, 0), LOCAL))
    return np.asarray(less / (deviation + floor + 1e-6), dtype=np.float32), np.asarray(deviation)


def disparity(left: Counts, right: Counts, matcher: Matcher) -> Image:
    """Disparity (h, w) in pixels of the left image, 0 where none is read; nowhere in images no larger than a window."""
    import cv2

    if min(left.image.shape) <= matcher.window:
        return np.zeros(left.image.shape, dtype=np.float32)
    first, contrast = normalised(left.image, left.noise)
    second, _ = normalised(right.image, right.noise)
    pad = matcher.disparities
    pair = [_bytes(np.pad(image, ((0, 0), (pad, 0)))) for image in (first, second)]
    found = _matcher(matcher).compute(*pair)[:, pad:]
    columns = np.arange(found.shape[1], dtype=np.float32)
    # what the right camera does not see any more has no partner, whatever was found
    valid = (found > 0) & (columns[None] - found / SIXTEENTHS >= 0)
    valid &= contrast > matcher.contrast * np.sqrt(cv2.GaussianBlur(left.noise**2, (0, 0), LOCAL))
    values = np.where(valid, found / SIXTEENTHS, 0.0).astype(np.float32)
    for _ in range(matcher.refinements):
        values = _refined(first, second, values, matcher.refinement_window)
    if matcher.median > 1:
        values = np.where(valid, cv2.medianBlur(values, matcher.median), 0.0).astype(np.float32)
    return _without_speckles(np.rint(values / matcher.step) * matcher.step, matcher)


def _bytes(image: Image) -> NDArray[np.uint8]:
    return np.clip(np.rint(128.0 + SCALE * image), 0, 255).astype(np.uint8)


def _matcher(matcher: Matcher) -> Any:
    import cv2

    opencv: Any = cv2  # its stubs lack the matchers in some versions
    if matcher.method == "block":
        block = opencv.StereoBM_create(matcher.disparities, matcher.window)
        block.setUniquenessRatio(matcher.uniqueness)
        block.setTextureThreshold(0)  # `contrast` decides; and no agreement is asked for, see Matcher
        block.setPreFilterCap(63)
        return block
    area = matcher.window**2
    return opencv.StereoSGBM_create(
        minDisparity=0,
        numDisparities=matcher.disparities,
        blockSize=matcher.window,
        P1=int(matcher.small_step * area),
        P2=int(matcher.large_step * area),
        disp12MaxDiff=matcher.agreement,
        preFilterCap=63,
        uniquenessRatio=matcher.uniqueness,
        speckleWindowSize=0,
        speckleRange=0,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )


def _refined(first: Image, second: Image, values: Image, window: float) -> Image:
    """Disparities moved to where the windows agree best, by one step of Gauss and Newton."""
    import cv2

    height, width = values.shape
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    warped = cv2.remap(second, columns - values, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    slope = cv2.Sobel(first + warped, cv2.CV_32F, 1, 0, ksize=3, scale=1.0 / 16.0)
    known = (values > 0).astype(np.float32)
    # the right image read at column u - d: a larger d shifts what is seen to the right
    moment = cv2.GaussianBlur(known * slope * (warped - first), (0, 0), window)
    power = cv2.GaussianBlur(known * slope * slope, (0, 0), window)
    mean = float((known * slope * slope).sum() / max(float(known.sum()), 1.0))
    change = moment / (power + np.float32(LEAST_SLOPE * mean + 1e-9))
    moved = values + np.clip(change, -LARGEST_REFINEMENT, LARGEST_REFINEMENT)
    return np.asarray(np.where((values > 0) & (moved > 0), moved, 0.0), dtype=np.float32)


def _without_speckles(values: NDArray[np.floating], matcher: Matcher) -> Image:
    """Pieces smaller than `speckle_area` px, whose neighbours differ by less than `speckle_step` px, are no reading."""
    import cv2

    if matcher.speckle_area > 0:
        whole = np.rint(values * SIXTEENTHS).astype(np.int16)
        cv2.filterSpeckles(whole, 0, matcher.speckle_area, matcher.speckle_step * SIXTEENTHS)
        values = np.where(whole > 0, values, 0.0)
    return values.astype(np.float32)
