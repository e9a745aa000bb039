"""The robot's own hand and the mask, drawn as the prediction of an image compares with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera
from vision.look.hand.hand import HandView
from vision.picture.kernels import spread

Array = NDArray[np.float64]


def widened(mask: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """(h, w) the mask and what is within `margin` pixels of it along either axis."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) > 0)


def hand_depth(camera: Camera, hand: HandView, step: int) -> tuple[Array, Array]:
    """Least and largest depth (m) of the hand at and beside every `step` pixels; +inf and -inf where it is not."""
    drawn = hand.surface.depth(camera, hand.aligned, (0, 0, camera.width, camera.height), step)
    low, high = np.full(drawn.shape, np.inf), np.full(drawn.shape, -np.inf)
    spread(drawn, low, high)
    return low, high
