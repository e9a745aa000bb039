"""A mask says which pixels are the object's: a pose whose outline leaves some of them to nothing has them against it.

What is seen outside a mask is not the object, which the predicted picture knows. This is the other half: a pose of
which only a corner shows at the mask's rim agrees with what is seen there, and explains nothing of the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]


def core_of(mask: NDArray[np.bool_], margin: int, most: int) -> NDArray[np.int64]:
    """(k, 2) at most `most` pixels (u, v), evenly chosen, of a mask (h, w) that is right to `margin` pixels: so far
    from its border, or half as far as any where all of it is thinner.
    """
    import cv2

    # what the image's border cuts off goes on
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    v, u = np.nonzero(mask & (inside >= min(float(margin), 0.5 * float(inside.max(initial=0.0)))))
    chosen = np.linspace(0, len(u) - 1, min(most, len(u))).astype(np.int64)
    return np.stack([u[chosen], v[chosen]], axis=1).astype(np.int64)


def uncovered(model: ObjectModel, camera: Camera, pixels: NDArray[np.int64], candidates: Array) -> Array:
    """(n,) share of pixels (k, 2), k at least 1, whose rays meet nothing of the object at poses (n, 4, 4)."""
    directions = np.ones((len(pixels), 3))
    directions[:, 0] = (pixels[:, 0] - camera.cx) / camera.fx
    directions[:, 1] = (pixels[:, 1] - camera.cy) / camera.fy
    rotation = candidates[:, :3, :3]
    rays = np.zeros((len(candidates), len(pixels), 6), dtype=np.float32)
    # where the camera is, in the object's frame
    rays[:, :, :3] = (-np.einsum("nji,nj->ni", rotation, candidates[:, :3, 3]) - model.surface.middle)[:, None]
    rays[:, :, 3:] = np.einsum("nji,kj->nki", rotation, directions)
    met = model.surface.cast_local(rays.reshape(-1, 6)).reshape(len(candidates), -1)
    return np.asarray((~np.isfinite(met)).mean(axis=1), dtype=np.float64)
