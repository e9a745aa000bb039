"""Compiled: signed distances of points from a hand's triangles, and their gradients. Hand frame, metres."""

from __future__ import annotations

import numba
import numpy as np

from scenes.geometry.surface_kernels import feet
from scenes.robot.posed_kernels import inside, nearest


@numba.njit(cache=True, nogil=True)
def closest(points, within, hand, upright, rays, distance, gradient):  # type: ignore[no-untyped-def]
    """Fill distance (n,), signed, and its unit gradient (n, 3) of points (n, 3); where nothing is nearer than `within`
    (m), that and a gradient of 0.

    hand: tree, corners, normals and boxes, as of scenes.robot.posed_kernels.nearest. upright: see
    scenes.geometry.surface_kernels.feet; rays (3, 3) tell the sign where a foot is on an edge or a corner.
    """
    tree, corners, normals, boxes = hand
    n = points.shape[0]
    face, foot, slanted = np.zeros(n, dtype=np.int64), np.zeros((n, 3)), np.zeros(n, dtype=np.bool_)
    distance[:], gradient[:] = within, 0.0
    nearest(points, within, tree, corners, normals, boxes, face, foot)
    feet(points, face, corners, normals, upright, foot, distance, gradient, slanted)
    doubtful = np.flatnonzero(slanted)
    if not len(doubtful):
        return
    inner = np.zeros(len(doubtful), dtype=np.bool_)
    inside(points[doubtful], rays, tree, corners, boxes, inner)
    for k in range(len(doubtful)):
        one = doubtful[k]
        if inner[k] != (distance[one] < 0.0):
            distance[one] *= -1.0
            for i in range(3):
                gradient[one, i] *= -1.0
