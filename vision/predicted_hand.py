"""The robot's own hand and the mask, drawn as the prediction of an image compares with them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from vision.look.hand import HandView

Array = NDArray[np.float64]


def widened(mask: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """(h, w) the mask and what is within `margin` pixels of it along either axis."""
    import cv2

    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) > 0)


def hand_depth(camera: Camera, hand: HandView, step: int) -> tuple[Array, Array]:
    """Least and largest depth (m) of the hand at and beside every `step` pixels; +inf and -inf where it is not."""
    import cv2

    low = np.full((-(-camera.height // step), -(-camera.width // step)), np.inf)
    inverse = se3.inverse(hand.aligned)
    u0, v0, u1, v1 = _box_of(camera, hand, step)
    u, v = np.arange(u0, u1) * step, np.arange(v0, v1) * step
    rays = np.stack(
        np.broadcast_arrays((u - camera.cx) / camera.fx, ((v - camera.cy) / camera.fy)[:, None], 1.0), axis=-1
    ).reshape(-1, 3)
    depth = hand.surface.cast(np.broadcast_to(inverse[:3, 3], rays.shape), rays @ inverse[:3, :3].T)
    low[v0:v1, u0:u1] = depth.reshape(len(v), len(u))
    high = np.where(np.isfinite(low), low, -np.inf)
    around = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.erode(low, around)), np.asarray(cv2.dilate(high, around))


def _box_of(camera: Camera, hand: HandView, step: int) -> tuple[int, int, int, int]:
    """Columns and rows (u0, v0, u1, v1), of every `step` pixels, that can see the hand; all when it is near."""
    columns, rows = -(-camera.width // step), -(-camera.height // step)
    ends = hand.surface.bounds
    corners = np.array([[ends[i][0], ends[j][1], ends[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    uv, z = camera.project(se3.apply(hand.aligned, corners))
    if (z <= 1e-3).any():
        return 0, 0, columns, rows
    low, high = np.floor(uv.min(axis=0) / step) - 1, np.ceil(uv.max(axis=0) / step) + 2
    u0, u1 = (int(np.clip(x, 0, columns)) for x in (low[0], high[0]))
    v0, v1 = (int(np.clip(x, 0, rows)) for x in (low[1], high[1]))
    return u0, v0, u1, v1
