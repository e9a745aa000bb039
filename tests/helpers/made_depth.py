"""What a camera without any error sees of planes and of two walls: what the tests of depth noise disturb."""

import numpy as np

from scenes.geometry.appearance.rendering import Rendering
from scenes.geometry.cameras import Camera
from scenes.synthesis.noise import presets as noise

CAMERA = Camera(570.0, 570.0, 159.5, 119.5, 320, 240)
OFF = noise.PRESETS["none"].depth


def plane(normal, distance, camera=CAMERA):
    """What the camera sees of an infinite plane normal . x = -distance."""
    normal = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    depth = -distance / (camera.rays() @ normal)
    shape = depth.shape
    whole = (0, 0, camera.width, camera.height)
    return Rendering(
        depth.astype(np.float32), np.zeros(shape, np.int32), ("plane",), np.broadcast_to(normal, (*shape, 3)), whole
    )


def two_walls(near=0.6, far=1.0, column=160):
    """A near wall on the right of a far one, both facing the camera."""
    depth = np.where(np.arange(320) >= column, near, far)[None].repeat(240, 0).astype(np.float32)
    ids = (np.arange(320) < column).astype(np.int32)[None].repeat(240, 0)
    return Rendering(depth, ids, ("near", "far"), np.broadcast_to([0.0, 0.0, -1.0], (240, 320, 3)), (0, 0, 320, 240))


FRONTAL = plane([0, 0, -1], 0.7)


def tilted(angle):
    return plane([np.sin(angle), 0, -np.cos(angle)], 0.6 * np.cos(angle))
