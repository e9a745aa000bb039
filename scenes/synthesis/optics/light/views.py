"""A scene as one eye of a camera sees it: rays, materials, where the projector stands. Camera frame, metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.geometry import poses
from scenes.geometry.appearance.rendering import Renderer, Rendering
from scenes.geometry.cameras import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Posed things: the renderer that holds them, camera_from_mesh (4, 4) by name, materials (k, 5) in that order."""

    renderer: Renderer
    camera_from_mesh: Mapping[str, ArrayLike]
    materials: Array


@dataclass(frozen=True)
class View:
    """What `samples` rays a pixel side meet: rendering (of the finer camera), and mesh_from_camera (k, 3, 4)."""

    rendering: Rendering
    camera: Camera
    samples: int
    meshes: Array

    @property
    def lens(self) -> Array:
        """fx, fy, cx, cy of the rays."""
        return np.array([self.camera.fx, self.camera.fy, self.camera.cx, self.camera.cy])


def see(scene: Scene, camera: Camera, samples: int, eye_from_camera: Array) -> View:
    """The scene from an eye at eye_from_camera (4, 4), the same lens there."""
    fine = camera.scaled(samples)
    placed = {
        name: eye_from_camera @ np.asarray(pose, dtype=np.float64) for name, pose in scene.camera_from_mesh.items()
    }
    meshes = [poses.inverse(pose)[:3] for pose in placed.values()]
    rendering = scene.renderer.render(fine, placed)
    return View(rendering, fine, samples, np.array(meshes).reshape(-1, 3, 4))
