"""Photographs of posed things by cameras imitated from their optics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from scenes.geometry.appearance.rendering import Renderer
from scenes.geometry.cameras import Camera
from scenes.synthesis.optics.light.things import Material, material_table
from scenes.synthesis.optics.light.views import Scene
from scenes.synthesis.optics.settings import OpticalCamera, PatternCamera, StereoCamera
from scenes.synthesis.optics.shots import Shot
from scenes.synthesis.optics.units import CameraUnit, draw_unit


def take(
    renderer: Renderer,
    camera_from_mesh: Mapping[str, ArrayLike],
    camera: Camera,
    built: OpticalCamera,
    rng: np.random.Generator,
    unit: CameraUnit | None = None,
    materials: Mapping[str, Material] | None = None,
) -> Shot:
    """Depth and infra-red image of the renderer's meshes at poses camera_from_mesh (4, 4), others are absent.

    camera: lens and size of the frame (the depth camera, or the left one). unit: the camera and the things' looks when
    they are to last over frames; drawn anew without. materials: of some or all things. Everything else of the shot
    (noise) is drawn from rng. Raises InputError as `Renderer.render`.
    """
    unit = draw_unit(rng) if unit is None else unit
    scene = Scene(renderer, dict(camera_from_mesh), material_table(list(camera_from_mesh), unit.seed, materials))
    if isinstance(built, StereoCamera):
        from scenes.synthesis.optics.stereo import stereo_shot

        return stereo_shot(scene, camera, built, unit, rng)
    if isinstance(built, PatternCamera):
        from scenes.synthesis.optics.stereo import pattern_shot

        return pattern_shot(scene, camera, built, unit, rng)
    from scenes.synthesis.optics.time_of_flight import time_of_flight_shot

    return time_of_flight_shot(scene, camera, built, unit, rng)
