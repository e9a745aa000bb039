"""Nothing is under a table or behind a wall, whether its surface is read there or something else hides that.

A ray that meets the object under what is read of a table is seen past. Where another thing stands before the table, or
where nothing is read, rays tell nothing of that; yet the table goes on there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.recordings.beliefs import DepthModel

Array = NDArray[np.float64]


def beneath(points: Array, floors: Array, candidates: Array, depth: DepthModel, margin: float, sigmas: float) -> Array:
    """(n,) the share of an object's points (k, 3), object frame, that are under one of floors (m, 6) at poses
    (n, 4, 4), camera frame.

    A point is under a floor where a reading as far under it would not be the floor's own (margin, m, and sigmas of the
    noise of readings, as far as they scatter), at the depth of the points' middle.
    """
    out = np.zeros(len(candidates))
    rotation, move = candidates[:, :3, :3], candidates[:, :3, 3]
    own = depth.independent_sigma(rotation[:, 2] @ points.mean(axis=0) + move[:, 2])
    for floor in floors:
        normal, offset, scatter = floor[:3], floor[3], floor[4]
        room = np.maximum(margin + sigmas * own, sigmas * scatter * np.hypot(own, margin / sigmas))
        height = (normal @ rotation) @ points.T + (move @ normal + offset)[:, None]
        out = np.maximum(out, (height < -room[:, None]).mean(axis=1))
    return out
