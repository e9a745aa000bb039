"""Light that reaches a depth camera by way of a second surface: concavities read too far. Camera frame, metres.

Every lit patch is a second light source (Fuchs, "Multipath interference compensation in time-of-flight camera images",
ICPR 2010): with Lambertian surfaces of one albedo, a patch q lit by the camera's lamp sends
albedo cos(q to p) cos(p to q) / (pi r^2) of its own light on to p, and that light has come a way longer by
(|q| + r - |p|) / 2. The reading is the mean of direct and detoured ways, weighted by their light (the phasor sum of
detours short against the modulation wavelength). Whether something stands between p and q is not asked.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from scenes.geometry.appearance.rendering import Rendering, region_rays
from scenes.geometry.cameras import Camera

Array = NDArray[np.float64]

# Pixels between patches that receive and that send (px): light that came by a detour varies slowly.
RECEIVER_STEP = 6
SENDER_STEP = 12


def multipath_error(rendering: Rendering, camera: Camera, albedo: float) -> Array:
    """(h, w) metres by which depth is read too far; 0 where nothing is seen."""
    from scipy.ndimage import map_coordinates

    rays = region_rays(camera, rendering.region)
    points = rays * rendering.depth[..., None].astype(np.float64)
    sent = _patches(rendering, points, camera, SENDER_STEP)
    rows, columns = (np.arange(0, n, RECEIVER_STEP) for n in rendering.depth.shape)
    grid = np.ix_(rows, columns)
    seen = rendering.ids[grid] >= 0
    longer = np.zeros(seen.shape)
    longer[seen] = detours(points[grid][seen], rendering.normals[grid][seen], *sent, albedo)
    # along the ray by the factor of depth per distance; from the receivers to all pixels, each within what is seen
    scale = np.linalg.norm(rays, axis=2)
    v, u = np.meshgrid(*(np.arange(n) / RECEIVER_STEP for n in rendering.depth.shape), indexing="ij")
    weight = map_coordinates(seen.astype(np.float64), [v, u], order=1, mode="nearest")
    spread = map_coordinates(np.where(seen, longer, 0.0), [v, u], order=1, mode="nearest")
    error = np.divide(spread, weight, out=np.zeros_like(spread), where=weight > 1e-9) / scale
    return np.where(rendering.ids >= 0, error, 0.0)


def _patches(rendering: Rendering, points: Array, camera: Camera, step: int) -> tuple[Array, Array, Array]:
    """Points (k, 3), normals (k, 3) and areas (k,) m^2 of every step-th pixel that sees something."""
    half = step // 2
    sparse = (slice(half, None, step), slice(half, None, step))
    seen = rendering.ids[sparse] >= 0
    place, normal = points[sparse][seen], rendering.normals[sparse][seen]
    distance = np.linalg.norm(place, axis=1)
    slope = np.abs(np.einsum("ni,ni->n", place, normal)) / np.maximum(distance, 1e-9)
    # a pixel's patch, held at grazing incidence where it would have no bounds
    area = (step * place[:, 2]) ** 2 / (camera.fx * camera.fy)
    return place, normal, area * (distance / place[:, 2]) / np.maximum(slope, 0.1)


def detours(points: Array, normals: Array, senders: Array, sender_normals: Array, areas: Array, albedo: float) -> Array:
    """(n,) metres by which the ways of light to points (n, 3) with unit normals (n, 3) are longer in the mean.

    senders (k, 3), their normals (k, 3) and areas (k,); the camera and its lamp are at the origin.
    """
    out = np.zeros(len(points))
    arrays = [np.ascontiguousarray(a, dtype=np.float64) for a in (points, normals, senders, sender_normals, areas)]
    _detours(arrays[0], arrays[1], arrays[2], arrays[3], arrays[4], albedo, out)
    return out


@numba.njit(cache=True, nogil=True)
def _detours(points, normals, senders, sender_normals, areas, albedo, out):  # type: ignore[no-untyped-def]
    for n in range(len(points)):
        p0, p1, p2 = points[n]
        own = np.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
        facing = -(p0 * normals[n, 0] + p1 * normals[n, 1] + p2 * normals[n, 2]) / own
        direct = max(facing, 0.02) / (own * own)
        light, way = 0.0, 0.0
        for k in range(len(senders)):
            d0, d1, d2 = senders[k, 0] - p0, senders[k, 1] - p1, senders[k, 2] - p2
            here = d0 * normals[n, 0] + d1 * normals[n, 1] + d2 * normals[n, 2]
            there = -(d0 * sender_normals[k, 0] + d1 * sender_normals[k, 1] + d2 * sender_normals[k, 2])
            if here <= 0.0 or there <= 0.0:
                continue
            square = d0 * d0 + d1 * d1 + d2 * d2
            q0, q1, q2 = senders[k]
            far = np.sqrt(q0 * q0 + q1 * q1 + q2 * q2)
            lit = -(q0 * sender_normals[k, 0] + q1 * sender_normals[k, 1] + q2 * sender_normals[k, 2]) / far
            # near patches are no points: the area in the denominator keeps their share below one
            form = here * there / (square * (np.pi * square + areas[k]) + 1e-18)
            came = albedo * areas[k] * form * max(lit, 0.0) / (far * far)
            light += came
            way += came * 0.5 * max(far + np.sqrt(square) - own, 0.0)
        out[n] = way / (direct + light)
