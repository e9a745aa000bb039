"""The DIGIT gel sensor (Lambeta et al., RA-L 2020) with the dimensions of its published model (TACTO, RA-L 2022).

The model's frame: x out of the finger, z along its longer side, the camera on the x axis at z = 15 mm, looking along x;
the image's columns run along -y, its rows along -z. Metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.geometry import poses
from scenes.robot.gels import Gel, dome

Array = NDArray[np.float64]

# Camera to the highest point of the skin (m), vertical field of view (rad), thickness of the gel (m).
DISTANCE = 0.022
FIELD_OF_VIEW = float(np.deg2rad(60.0))
THICKNESS = 0.005
# The skin: 20 mm across (y), 30 mm along (z), a cap of a sphere of 100 mm scaled to fall off 5 mm to its corners.
WIDTH, LENGTH, RADIUS, DROP = 0.020, 0.030, 0.100, 0.005
# Image (columns, rows).
SIZE = (240, 320)
# What is solid behind the skin for sure: a box from the camera to below the skin's lowest corner, model frame (m).
HOUSING = ((0.0, 0.015), (-0.5 * WIDTH, 0.5 * WIDTH), (0.0, LENGTH))


def digit_gel(size: tuple[int, int] = SIZE, background: NDArray[np.uint8] | None = None) -> Gel:
    """The sensor's gel for images of `size` (columns, rows), with the untouched skin's image when there is one."""
    width, height = size
    focal = 0.5 * height / np.tan(0.5 * FIELD_OF_VIEW)
    matrix = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    flat = Gel(width, height, np.zeros((height, width)), None, matrix, DISTANCE, THICKNESS)
    reach = float(np.hypot(0.5 * WIDTH, 0.5 * LENGTH))
    surface = dome(width, height, flat.rays, DISTANCE, RADIUS, DROP, reach)
    return Gel(width, height, surface, None, matrix, DISTANCE, THICKNESS, background)


def model_from_sensor() -> Array:
    """(4, 4): the gel's sensor frame (z out of the finger, x and y along the image) in the model's frame."""
    rotation = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return poses.make_pose(rotation, (DISTANCE, 0.0, 0.5 * LENGTH))
