"""Printed colour on an object: bands, a label and speckles in its own frame, the same in every frame."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, shade
from scenes.geometry.appearance.texture import Texture, TextureSettings
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Inks of packages (RGB, shares of white).
INKS = np.array(
    [[0.85, 0.1, 0.12], [0.08, 0.25, 0.65], [0.95, 0.8, 0.1], [0.1, 0.5, 0.25], [0.95, 0.95, 0.92], [0.08, 0.08, 0.1]]
)
# Widths of bands and letters (m).
BAND, LETTER = 0.022, 0.006


def ink(points: Array, model: ObjectModel) -> Array:
    """(n, 3) colour, shares of white, of points (n, 3) of the object's surface, object frame."""
    rng = np.random.default_rng(zlib.crc32(model.name.encode()))
    order = rng.permutation(len(INKS))
    axes = poses.random_rotations(1, rng)[0]
    local = (points - model.centroid) @ axes.T
    band = np.floor(local[:, 2] / BAND + rng.uniform()).astype(np.int64)
    colour = INKS[order[np.array([0, 1, 0, 2])[band % 4]]]
    # a label of rows of letters on one side of every other band
    label = (band % 2 == 1) & (local[:, 0] > 0)
    row, column = np.floor(local[:, 2] / LETTER), np.floor(local[:, 1] / (0.6 * LETTER))
    letter = np.sin(12.9898 * row + 78.233 * column) * 43758.5453
    dark = label & (row % 2 == 0) & (letter - np.floor(letter) < 0.6)
    colour[dark] = INKS[order[3]]
    return colour


def printed(
    rgb: NDArray[np.uint8], scene: dict[str, Array], renderer: Renderer, camera: Camera, model: ObjectModel
) -> NDArray[np.uint8]:
    """The picture with the object's own pixels printed; scene: camera_from_mesh of everything in it."""
    seen = renderer.render(camera, scene)
    mask = seen.mask("object")
    if not mask.any():
        return rgb
    points = poses.apply(poses.inverse(scene["object"]), camera.back_project(seen.depth, mask))
    white = shade(seen, {"object": (255, 255, 255)})[mask].astype(np.float64)
    out = rgb.copy()
    out[mask] = np.clip(np.rint(white * ink(points, model)), 0, 255).astype(np.uint8)
    return out


def with_print(model: ObjectModel) -> ObjectModel:
    """The object as it is printed in `printed` pictures: with a texture that a capture's mesh carries along."""
    settings = TextureSettings()
    points, _ = model.sample_surface(settings.samples, seed=1)
    return model.with_texture(Texture(points, np.rint(255.0 * ink(points, model)), settings))
