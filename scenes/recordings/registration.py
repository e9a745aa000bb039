"""A colour image as the depth camera would have it, where another camera with its own intrinsics and pose took it.

Camera frames, metres; pixel centres on integers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses
from scenes.geometry.cameras import Camera, is_reading

Array = NDArray[np.float64]

# A place is hidden from the colour camera when something is nearer to it there by more (share of its depth): three
# times what depth cameras are wrong by at an edge's foot; and the buffer that tells has pixels of this size (px).
NEARER, CELL = 0.02, 2


def registered(
    rgb: NDArray[np.uint8], rgb_camera: Camera, depth: NDArray[np.floating], camera: Camera, rgb_from_depth: Array
) -> NDArray[np.uint8]:
    """The colours (h, w, 3) at the pixels of a depth image (h, w), black where the colour camera does not see them.

    rgb: of rgb_camera's size; depth (m): of camera's; rgb_from_depth (4, 4). Pixels without a reading take the depth of
    the nearest that has one. Raises InputError for images of another size than their cameras', or no rigid motion.
    """
    import cv2

    for name, image, own in (("rgb", rgb, rgb_camera), ("depth", depth, camera)):
        if image.shape[:2] != (own.height, own.width):
            sizes = f"{own.width}x{own.height} pixels like its camera, got {image.shape[1]}x{image.shape[0]}"
            raise InputError(f"{name}: expected {sizes}")
    moved = poses.check_pose(rgb_from_depth, "rgb_from_depth")
    read = is_reading(depth)
    if not read.any():
        return np.zeros((*depth.shape, 3), dtype=np.uint8)
    # each hole with the depth of the nearest reading
    _, label = cv2.distanceTransformWithLabels((~read).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    of_label = np.zeros(int(label.max()) + 1)
    of_label[label[read]] = depth[read]
    filled = of_label[label]
    points = poses.apply(moved, (camera.rays() * filled[..., None]).reshape(-1, 3))
    uv, z = rgb_camera.project(points)
    size = np.array([rgb_camera.width, rgb_camera.height])
    inside = (z > 0) & np.isfinite(uv).all(axis=1)
    inside &= (np.nan_to_num(uv, nan=-1.0) >= 0).all(axis=1) & (np.nan_to_num(uv, nan=-1.0) <= size - 1).all(axis=1)
    cells = np.where(inside[:, None], np.nan_to_num(uv), 0.0).astype(np.int64) // CELL
    nearest = np.full(size[::-1] // CELL + 1, np.inf)
    np.minimum.at(nearest, (cells[inside, 1], cells[inside, 0]), z[inside])
    inside &= z <= (1.0 + NEARER) * nearest[cells[:, 1], cells[:, 0]]
    at = np.where(inside[:, None], np.nan_to_num(uv), -10.0).astype(np.float32).reshape(*depth.shape, 2)
    seen = cv2.remap(
        rgb, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0, 0)
    )
    return np.asarray(seen, dtype=np.uint8)
