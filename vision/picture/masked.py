"""A mask says which pixels are the object's: a pose whose outline leaves some of them to nothing has them against it.

What is seen outside a mask is not the object, which the predicted picture knows. This is the other half: a pose of
which only a corner shows at the mask's rim agrees with what is seen there, and explains nothing of the rest.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.table import COLUMNS, GATE_ABOVE, POINT, SIGMA, VISION, WEIGHT, Evidence
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from vision.picture.settings import CoverSettings

# What a ray passes nearer to the camera than this (m) it is not looked at: rows divide by their depth.
IN_FRONT = 1e-3

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
    return np.asarray(missing(model, camera, pixels, candidates).mean(axis=1), dtype=np.float64)


def missing(model: ObjectModel, camera: Camera, pixels: NDArray[np.int64], candidates: Array) -> NDArray[np.bool_]:
    """(n, k) whether the rays of pixels (k, 2) meet nothing of the object at poses (n, 4, 4)."""
    rotation = candidates[:, :3, :3]
    rays = np.zeros((len(candidates), len(pixels), 6), dtype=np.float32)
    # where the camera is, in the object's frame
    rays[:, :, :3] = (_eyes(candidates) - model.surface.middle)[:, None]
    rays[:, :, 3:] = np.einsum("nji,kj->nki", rotation, _directions(camera, pixels))
    met = model.surface.cast_local(rays.reshape(-1, 6)).reshape(rays.shape[:2])
    return np.asarray(~np.isfinite(met))


def beside(model: ObjectModel, directions: Array, candidates: Array, steps: int) -> Array:
    """(r, 3) camera frame: the place on each ray from the camera, along directions (r, 3), that is nearest to the
    object at the ray's own pose of candidates (r, 4, 4), in front of the camera.

    Of so many places over the object's depth the nearest, then of as many between those before and after it.
    """
    along = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    eyes = _eyes(candidates)
    inside = np.einsum("rji,rj->ri", candidates[:, :3, :3], along)
    middle = np.einsum("ri,ri->r", model.centroid - eyes, inside)
    reach, even = np.full(len(along), model.radius), np.linspace(-1.0, 1.0, steps)
    for _ in range(2):
        depths = np.maximum(middle[:, None] + reach[:, None] * even, IN_FRONT)
        places = eyes[:, None] + depths[:, :, None] * inside[:, None]
        distances = model.field.distance(places.reshape(-1, 3)).reshape(depths.shape)
        middle = depths[np.arange(len(along)), np.argmin(distances, axis=1)]
        reach = reach * 2.0 / (steps - 1)
    return np.asarray(middle[:, None] * along)


def covering_rows(
    model: ObjectModel,
    camera: Camera,
    pixels: NDArray[np.int64],
    candidates: Array,
    settings: CoverSettings,
    told: float,
) -> list[Evidence]:
    """Of each of poses (n, 4, 4) a row for every one of a mask's pixels (k, 2) whose ray misses the object there: at
    the place on the ray that is nearest to it, one-sided, so that a fit draws the outline over what it leaves bare.

    told: what the mask amounts to, 0 to 1. Where a ray meets the object nothing is left to say.
    """
    of, ray = np.nonzero(missing(model, camera, pixels, candidates))
    rows = np.zeros((len(of), COLUMNS))
    if len(of):
        rows[:, POINT] = beside(model, _directions(camera, pixels)[ray], candidates[of], settings.steps)
        rows[:, SIGMA], rows[:, GATE_ABOVE] = settings.sigma, settings.gate
        rows[:, WEIGHT] = settings.amount * told / len(pixels)
    bounds = np.searchsorted(of, np.arange(len(candidates) + 1))
    return [Evidence(rows[a:b], np.full(b - a, VISION, dtype=np.uint8)) for a, b in pairwise(bounds)]


def _directions(camera: Camera, pixels: NDArray[np.int64]) -> Array:
    """(k, 3) rays of pixels (k, 2), camera frame, one metre deep."""
    directions = np.ones((len(pixels), 3))
    directions[:, 0] = (pixels[:, 0] - camera.cx) / camera.fx
    directions[:, 1] = (pixels[:, 1] - camera.cy) / camera.fy
    return directions


def _eyes(candidates: Array) -> Array:
    """(n, 3) where the camera is in the object's frame at poses (n, 4, 4)."""
    return np.asarray(-np.einsum("nji,nj->ni", candidates[:, :3, :3], candidates[:, :3, 3]))
