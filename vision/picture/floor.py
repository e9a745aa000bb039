"""Nothing is under a table or behind a wall, whether its surface is read there or something else hides that.

A ray that meets the object under what is read of a table is seen past. Where another thing stands before the table, or
where nothing is read, rays tell nothing of that; yet the table goes on there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.recordings.beliefs import DepthModel
from vision.picture.scoring_kernels import share_beneath

Array = NDArray[np.float64]


def beneath(points: Array, floors: Array, candidates: Array, depth: DepthModel, margin: float, sigmas: float) -> Array:
    """(n,) the share of an object's points (k, 3), object frame, that are under one of floors (m, 6) at poses
    (n, 4, 4), camera frame.

    A point is under a floor where a reading as far under it would not be the floor's own (margin, m, and sigmas of the
    noise of readings, as far as they scatter), at the depth of the points' middle.
    """
    out = np.zeros(len(candidates))
    poses, floors = np.ascontiguousarray(candidates), np.ascontiguousarray(floors)
    own = depth.independent_sigma(poses[:, 2, :3] @ points.mean(axis=0) + poses[:, 2, 3])
    share_beneath(points, floors, poses, own, margin, sigmas, out)
    return out
