"""Parts on a hand that its model lacks: an adapter, a camera on a bracket. Hand frame, metres."""

from __future__ import annotations

import numpy as np

from scenes.robot.hands import Hand
from scenes.robot.urdf import make_shape
from scenes.synthesis.shapes import Mesh

# Boxes: middle and size, for a hand whose x is along the fingers and whose back is at -z.
MOUNTS = (((0.035, 0.0, -0.035), (0.07, 0.06, 0.044)), ((0.060, 0.0, -0.072), (0.030, 0.100, 0.030)))


def hand_mesh(hand: Hand, joints: dict[str, float], mounted: bool) -> Mesh:
    """The hand as the camera sees it: vertices (n, 3) and faces (m, 3), with the parts its model lacks when mounted."""
    vertices, faces, _ = hand.mesh(joints)
    if not mounted:
        return vertices, faces
    parts, triangles = [vertices], [faces]
    for middle, size in MOUNTS:
        box = make_shape("box", size)
        triangles.append(box.faces + sum(map(len, parts)))
        parts.append(box.vertices + np.array(middle))
    return np.concatenate(parts), np.concatenate(triangles)
