"""Silhouettes of a posed mesh as polygons in image pixels, to be drawn over a picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera

Array = NDArray[np.float64]

# Traced at twice the camera's resolution and straightened by this many pixels: no stairs, and still few points.
OVERSAMPLING = 2
STRAIGHTENING = 0.35

# Outlines around fewer pixels than this (of the traced image) are specks at the mesh's rim.
SMALLEST_AREA = 12.0


def silhouette(renderer: Renderer, name: str, camera: Camera, pose: Array) -> list[Array]:
    """Closed polygons (n, 2) of pixels (u, v) around where the renderer's mesh `name` is seen at camera_from_mesh.

    Holes (a mug's handle) are polygons too. Empty when the pose is not finite or the mesh is not in the image.
    """
    import cv2

    if not np.isfinite(pose).all():
        return []
    fine = camera.scaled(OVERSAMPLING)
    try:
        rendering = renderer.render(fine, {name: pose}, _window(fine.project(renderer.vertices(name, pose))[0], fine))
    except InputError:
        # a pose that is no rigid transform has no outline; that the estimate is lost is told elsewhere
        return []
    mask = rendering.mask(name)
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    polygons = []
    for contour in contours:
        if cv2.contourArea(contour) < SMALLEST_AREA:
            continue
        straight = cv2.approxPolyDP(contour, STRAIGHTENING * OVERSAMPLING, closed=True).reshape(-1, 2)
        if len(straight) > 2:
            polygons.append((straight + rendering.region[:2] + 0.5) / OVERSAMPLING - 0.5)
    return polygons


def _window(pixels: Array, camera: Camera) -> tuple[int, int, int, int] | None:
    """The part of the image that holds the projected vertices (n, 2); None, all of it, with some behind the camera."""
    if not np.isfinite(pixels).all():
        return None
    size = (camera.width, camera.height)
    low = np.clip(np.floor(pixels.min(axis=0)) - 2, 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + 3, 0, size).astype(int)
    return (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
