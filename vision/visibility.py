"""What of an object at a pose the camera should see, and what it does see: by ray casting against the depth image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import is_reading
from scenes.geometry.objects import ObjectModel
from scenes.recordings.beliefs import DepthModel
from scenes.recordings.frames import Frame
from vision.contour import kernels
from vision.contour.outline import Caster
from vision.picture.masked import core_of, uncovered
from vision.picture.settings import PredictionSettings

Array = NDArray[np.float64]

# Rays a side over the object's outline: a share is then known to a percent or two.
RAYS = 40
# Pixels that a mask is told by: a share is then known to six percent.
MASKED = 64


@dataclass(frozen=True)
class Visibility:
    """Shares of the object's own pixels inside the image (they sum to 1; NaN when it has none):

    visible: the depth agrees with the object; hidden: something is in front; violated: the camera saw past it, so it
    cannot be there; unread: no depth reading. bare: share of a mask's inner pixels at which the object is not; NaN
    without a mask.
    """

    visible: float
    hidden: float
    violated: float
    unread: float
    bare: float = float("nan")


def visibility(frame: Frame, model: ObjectModel, pose: Array, depth_model: DepthModel | None = None) -> Visibility:
    """Compare the object at pose (4, 4) camera_from_object with the frame's depth image."""
    depth_model = depth_model or DepthModel()
    if frame.depth is None or frame.camera is None:
        return Visibility(np.nan, np.nan, np.nan, np.nan)
    camera, bare = frame.camera, np.nan
    if frame.mask is not None and frame.mask.any():
        core = core_of(frame.mask, PredictionSettings.mask_margin, MASKED)
        bare = float(uncovered(model, camera, core, pose[None])[0])
    nothing = Visibility(np.nan, np.nan, np.nan, np.nan, bare)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    some, bounds = np.ascontiguousarray(model.vertices[:: max(1, len(model.vertices) // 2000)]), np.zeros(5)
    kernels.box(some, np.ascontiguousarray(pose[:3, :3]), pose[:3, 3].copy(), lens, bounds)
    if bounds[4] <= 0:
        return nothing
    low = np.maximum(np.floor(bounds[[0, 2]]), 0).astype(int)
    high = np.minimum(np.ceil(bounds[[1, 3]]), [camera.width - 1, camera.height - 1]).astype(int)
    if (high < low).any():
        return nothing
    # each once, in order
    u, v = (np.linspace(first, last, min(RAYS, last - first + 1)).round().astype(int) for first, last in zip(low, high))
    u, v = np.tile(u, len(v)), np.repeat(v, len(u))
    expected = Caster(model, camera, pose).depth(np.stack([u, v], axis=1).astype(np.float64))
    on = np.isfinite(expected)
    if not on.any():
        return nothing
    z, seen = expected[on], frame.depth[v[on], u[on]].astype(np.float64)
    # twice what noise, smooth bias and scale together do to one pixel
    sigma = np.sqrt(
        depth_model.independent_sigma(z) ** 2 + depth_model.bias_sigma**2 + (depth_model.scale_sigma * z) ** 2
    )
    unread = ~is_reading(seen)
    difference = np.where(unread, 0.0, seen - z)
    hidden = difference < -2.5 * sigma
    violated = difference > 2.5 * sigma
    visible = ~unread & ~hidden & ~violated
    states = np.stack([visible, hidden & ~unread, violated & ~unread, unread])
    seen_of, hidden_of, violated_of, unread_of = states.mean(axis=1).tolist()
    return Visibility(seen_of, hidden_of, violated_of, unread_of, bare)
