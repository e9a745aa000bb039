"""Where to begin when nothing is known: poses that put the object behind the pixels that show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.alignment.search import rotation_grid
from scenes.objects import ObjectModel

Array = NDArray[np.float64]


def pixel_starts(model: ObjectModel, points: Array, count: int, rng: np.random.Generator) -> Array:
    """(count, 4, 4) camera_from_object: even rotations, each with a seen point on the surface that faces the camera.

    points (n, 3): pixels that may be the object, camera frame.
    """
    rotations = rotation_grid(count, rng)
    surface, normals = model.sample_surface(2000, seed=int(rng.integers(2**31)))
    towards = -points.mean(axis=0) / max(float(np.linalg.norm(points.mean(axis=0))), 1e-12)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotations
    seen = points[rng.integers(len(points), size=count)]
    # of a few surface points, take one that faces the camera at this rotation
    tries = rng.integers(len(surface), size=(count, 6))
    facing = np.einsum("ncj,nij,i->nc", normals[tries], rotations, towards)
    chosen = tries[np.arange(count), np.argmax(facing > 0.2, axis=1)]
    poses[:, :3, 3] = seen - np.einsum("nij,nj->ni", rotations, surface[chosen])
    # half of the starts: the seen points' mean on the centroid, pushed back by half the object
    half = slice(0, count, 2)
    middle = points.mean(axis=0) - 0.5 * model.radius * towards
    offset = rng.normal(size=(len(poses[half]), 3)) * 0.3 * model.radius
    poses[half, :3, 3] = middle + offset - rotations[half] @ model.centroid
    return poses
