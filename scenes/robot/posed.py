"""A hand's surface at its joints: what is near it, closest points, and how the camera sees it. Hand frame, metres.

A hand is another mesh in every frame. Which of its triangles are together is not: a tree of them is planned once for a
hand, link by link, and only its boxes are laid anew. To build a ray-casting scene took longer than to ask it.
"""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.cameras import Camera
from scenes.geometry.surface import OUTWARD_RAYS, UPRIGHT
from scenes.geometry.surface_kernels import in_cells
from scenes.robot import closest_kernels
from scenes.robot import posed_kernels as kernels
from scenes.robot.hands import Hand

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Triangles of a leaf of the tree.
LEAF = 4
# Most cells along the longest side of the grid that sorts out what is far away.
CELLS = 64
# What is nearer to the camera's plane than this (m) has no bounds in the image.
NEAREST_DRAWN = 1e-3

# right, start and count of the tree's nodes, and faces in its order
Plan = tuple[tuple[Indices, Indices, Indices], Indices]
_PLANS: WeakKeyDictionary[Hand, Plan] = WeakKeyDictionary()


class PosedHand:
    """A hand's mesh at its joints. Attributes: vertices (n, 3), faces (m, 3), bounds: lowest and highest corner (3,) of
    the box around it.
    """

    def __init__(self, hand: Hand, joints: dict[str, float]) -> None:
        """joints: as for `Hand.mesh`."""
        self._tree, self.faces = _plan(hand)
        self.vertices = hand.vertices(joints)
        self._corners, self._normals = np.zeros((len(self.faces), 3, 3)), np.zeros((len(self.faces), 3))
        self._boxes = np.zeros((len(self._tree[0]), 6))
        kernels.lay(self.vertices, self.faces, *self._tree, self._corners, self._normals, self._boxes)
        self.bounds: tuple[Array, Array] = (self._boxes[0, :3], self._boxes[0, 3:])

    def may_be_within(self, points: Array, distance: float) -> NDArray[np.bool_]:
        """(n,) False only for points (n, 3) farther than `distance` (m) from the surface: cheap, to ask few for more.

        A point that near lies in some triangle's box widened by the distance; the boxes are marked on a grid.
        """
        origin = self.bounds[0] - distance
        extent = self.bounds[1] + distance - origin
        cell = float(max(distance, extent.max() / CELLS))
        covered = np.zeros((extent / cell).astype(np.int64) + 1, dtype=bool)
        kernels.mark_near(self._corners, distance, origin, cell, covered)
        out = np.zeros(len(points), dtype=bool)
        in_cells(np.ascontiguousarray(points, np.float64), np.zeros(3), origin, cell, covered, out)
        return out

    def is_within(self, points: Array, distance: float) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) are nearer than `distance` (m) to the surface, on either side."""
        out = np.zeros(len(points), dtype=bool)
        kernels.any_within(
            np.ascontiguousarray(points, np.float64), distance, self._tree, self._corners, self._boxes, out
        )
        return out

    def closest(self, points: Array, within: float = np.inf) -> tuple[Array, Array]:
        """For points (n, 3): signed distance (n,) and its unit gradient (n, 3), as of scenes.geometry.surface.Surface.

        Where nothing is nearer than `within` (m), that and a gradient of 0: the less is asked for, the sooner it is
        told.
        """
        asked = np.ascontiguousarray(points, np.float64)
        distance, gradient = np.zeros(len(asked)), np.zeros((len(asked), 3))
        hand = self._tree, self._corners, self._normals, self._boxes
        closest_kernels.closest(asked, float(within), hand, UPRIGHT, OUTWARD_RAYS, distance, gradient)
        return distance, gradient

    def gap(self, points: Array) -> float:
        """Least distance (m) of points (n, 3) from the surface, on either side; inf for none."""
        return float(kernels.least(np.ascontiguousarray(points, np.float64), self._tree, self._corners, self._boxes))

    def box_within(
        self, camera: Camera, pose: Array, box: tuple[int, int, int, int]
    ) -> tuple[int, int, int, int] | None:
        """The part of a box (u0, v0, u1, v1) of pixels in which the hand at pose (4, 4) camera_from_hand may be drawn;
        None for none.
        """
        at = self.vertices @ pose[:3, :3].T + pose[:3, 3]
        if (at[:, 2] < NEAREST_DRAWN).any():
            return box
        at[:, :2] /= at[:, 2:]
        (left, top), (right, bottom) = at[:, :2].min(axis=0).tolist(), at[:, :2].max(axis=0).tolist()
        # compared before they are made whole: what is far beside the image is no whole number
        u0, u1 = max(camera.fx * left + camera.cx - 1.0, box[0]), min(camera.fx * right + camera.cx + 2.0, box[2])
        v0, v1 = max(camera.fy * top + camera.cy - 1.0, box[1]), min(camera.fy * bottom + camera.cy + 2.0, box[3])
        return (int(u0), int(v0), math.ceil(u1), math.ceil(v1)) if u0 < u1 and v0 < v1 else None

    def depth(self, camera: Camera, pose: Array, box: tuple[int, int, int, int], step: int = 1) -> Array:
        """(h, w) depth (m) at pose (4, 4) camera_from_hand through every `step` pixels of a box (u0, v0, u1, v1), half
        open; inf where the hand is not.
        """
        u0, v0, u1, v1 = box
        out = np.full((-(-(v1 - v0) // step), -(-(u1 - u0) // step)), np.inf)
        lens = camera.fx, camera.fy, camera.cx, camera.cy
        kernels.draw(self.vertices, self.faces, np.ascontiguousarray(pose), lens, u0, v0, step, NEAREST_DRAWN, out)
        return out


def _plan(hand: Hand) -> Plan:
    """The tree of a hand's triangles, made at the first call: of its open hand, but it serves any."""
    known = _PLANS.get(hand)
    if known is None:
        vertices, faces, link = hand.mesh({})
        centres = vertices[faces].mean(axis=1)
        count = np.maximum(np.bincount(link, minlength=len(hand.link_names)), 1)
        middles = np.stack([np.bincount(link, weights=x, minlength=len(count)) / count for x in centres.T], axis=1)
        order, right, start, own = np.arange(len(faces)), *np.zeros((3, 2 * len(faces)), dtype=np.int64)
        nodes = kernels.plan(centres, link, middles, LEAF, order, right, start, own)
        known = (right[:nodes].copy(), start[:nodes].copy(), own[:nodes].copy()), faces[order]
        _PLANS[hand] = known
    return known
