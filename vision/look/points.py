"""A frame's points as other methods take them: all of them, or the usual crop. Camera frame, metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.objects import ObjectModel
from scenes.recordings.frames import Frame

Array = NDArray[np.float64]

# Radius (m) of the crop that people use around a start, beyond the model's own.
CROP_MARGIN = 0.01


def all_points(frame: Frame) -> Array:
    """(n, 3) points of the depth image (mask applied when there is one) and the cloud."""
    parts = []
    if frame.depth is not None and frame.camera is not None:
        parts.append(frame.camera.back_project(frame.depth, frame.mask))
    if frame.cloud is not None:
        cloud = frame.cloud[np.isfinite(frame.cloud).all(axis=1)]
        parts.append(cloud @ frame.camera_from_world[:3, :3].T + frame.camera_from_world[:3, 3])
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def crop_points(frame: Frame, model: ObjectModel, start: Array) -> Array:
    """(n, 3) points of the usual crop: everything seen within the model's ball around the start (4, 4)."""
    points = all_points(frame)
    centre = start[:3, :3] @ model.centroid + start[:3, 3]
    return points[np.linalg.norm(points - centre, axis=1) < model.radius + CROP_MARGIN]
