"""Gels that a ball presses, for tests."""

from __future__ import annotations

import numpy as np

from scenes.geometry import poses as se3
from scenes.robot.gels import Gel
from scenes.synthesis import library
from scenes.synthesis.gels import pressed_by

# The ball's radius (m) that calibrates.
BALL = 0.004


def flat_gel(side=160, pitch=1e-4):
    return Gel(side, side, np.zeros((side, side)), pitch, thickness=0.004)


def ball_depth(gel, radius, depth, u, v):
    """A ball over pixel (u, v): the oracle is plain geometry, column by column."""
    place, out = gel.points()[v, u], gel.normals()[v, u]
    centre = place + (radius - depth) * out
    sphere = library.make("sphere")
    scaled = type(sphere).from_mesh(sphere.vertices / sphere.radius * radius, sphere.faces, "ball")
    return pressed_by(scaled, se3.make_pose(None, -centre), gel)
