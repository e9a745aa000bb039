"""Exact closest points on a mesh, for the digits that a lattice rounds away. Object frame, metres."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from scenes._open3d import open3d
from scenes.geometry.surface_kernels import feet, in_cells, mark_cells
from scenes.threads import thread_count

Array = NDArray[np.float64]

# Above this cosine between its offset and the triangle's normal, a foot lies within the triangle.
UPRIGHT = 0.999
# Points that lie in a plane up to this share of how far they spread in it have no hull.
FLAT = 1e-3
# Most cells along the longest side of the grid that sorts out what is far away.
_CELLS = 64
# Rays that vote on inside and outside: one may run through an edge.
OUTWARD_RAYS = np.array([[0.5377, 0.7213, 0.4366], [-0.6124, 0.3391, 0.7141], [0.2267, -0.8315, 0.5072]])


class Surface:
    """Closest-point queries against the triangles of a closed mesh."""

    def __init__(self, vertices: Array, faces: NDArray[np.int64]) -> None:
        """Vertices (n, 3) metres, faces (m, 3) wound outwards."""
        o3d = open3d()
        # of the box around the mesh, about which all is: single precision loses digits far from the origin
        self.middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        self._corners = (vertices - self.middle)[faces]
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor((vertices - self.middle).astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
        )
        cross = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0])
        self._normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner (3,) of the box around the mesh."""
        low, high = self._boxes
        return low.min(axis=0) + self.middle, high.max(axis=0) + self.middle

    @cached_property
    def _boxes(self) -> tuple[Array, Array]:
        """Lowest and highest corner (m, 3) of every triangle."""
        a, b, c = self._corners[:, 0], self._corners[:, 1], self._corners[:, 2]
        return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)

    def may_be_within(self, points: Array, distance: float) -> NDArray[np.bool_]:
        """(n,) False only for points (n, 3) farther than `distance` (m) from the surface: cheap, to ask few for more.

        A point that near lies in some triangle's box widened by the distance; the boxes are marked on a grid.
        """
        low, high = self._boxes
        low, high = low - distance, high + distance
        origin = low.min(axis=0)
        extent = high.max(axis=0) - origin
        cell = float(max(distance, extent.max() / _CELLS))
        covered = np.zeros((extent / cell).astype(np.int64) + 1, dtype=bool)
        mark_cells(low, high, origin, cell, covered)
        out = np.zeros(len(points), dtype=bool)
        in_cells(np.ascontiguousarray(points, np.float64), self.middle, origin, cell, covered, out)
        return out

    def is_within(self, points: Array, distance: float) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) are nearer than `distance` (m) to the surface, on either side."""
        near = self.may_be_within(points, distance)
        near[near] = np.abs(self.closest(points[near])[0]) < distance
        return near

    def closest(self, points: Array) -> tuple[Array, Array, Array]:
        """For points (n, 3): signed distance (n,), its unit gradient (n, 3), and the closest points (n, 3).

        The closest point is found in single precision and its foot recomputed in double on that triangle's plane.
        The sign is that of the nearest triangle's side; where the foot is on an edge or a corner, whose triangles see
        the point from different sides, it is told by rays.
        """
        o3d = open3d()
        local = np.ascontiguousarray(points, dtype=np.float64) - self.middle
        if len(local) == 0:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3))
        found = self._scene.compute_closest_points(o3d.core.Tensor(local.astype(np.float32)), thread_count())
        face = found["primitive_ids"].numpy().astype(np.int64)
        foot = found["points"].numpy().astype(np.float64)
        distance, slanted = np.zeros(len(local)), np.zeros(len(local), dtype=bool)
        gradient = np.zeros((len(local), 3))
        feet(local, face, self._corners, self._normals, UPRIGHT, foot, distance, gradient, slanted)
        if slanted.any():
            # their sign is that of the side that rays tell
            wrong = np.flatnonzero(slanted)[self._is_inside(local[slanted]) != (distance[slanted] < 0)]
            distance[wrong] *= -1.0
            gradient[wrong] *= -1.0
        return distance, gradient, foot + self.middle

    def _is_inside(self, local: Array) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) about the middle are inside: most of three rays cross the surface an odd number of
        times. The rays are always the same; Open3D's own vote draws them anew at every call.
        """
        o3d = open3d()
        points = np.repeat(local, len(OUTWARD_RAYS), axis=0)
        rays = np.concatenate([points, np.tile(OUTWARD_RAYS, (len(local), 1))], axis=1).astype(np.float32)
        crossings = self._scene.count_intersections(o3d.core.Tensor(rays), thread_count()).numpy()
        return np.asarray((crossings % 2).reshape(len(local), len(OUTWARD_RAYS)).sum(axis=1) * 2 > len(OUTWARD_RAYS))

    def cast(self, origins: Array, directions: Array) -> Array:
        """Ray parameter t (n,) of the first hit, inf for none: origins (n, 3) + t directions (n, 3)."""
        return self.cast_local(np.concatenate([origins - self.middle, directions], axis=1).astype(np.float32))

    def cast_local(self, rays: NDArray[np.float32]) -> Array:
        """As `cast`, of rays (n, 6): origin less `middle`, and direction."""
        if not len(rays):
            return np.zeros(0)
        # the tensor is the array: nothing keeps it
        told = self._scene.cast_rays(open3d().core.Tensor.from_numpy(rays), thread_count())
        return np.asarray(told["t_hit"].numpy(), dtype=np.float64)


def hull_of(points: Array) -> NDArray[np.intp]:
    """Which of points (n, 3) are corners of their convex hull, in order; all where they lie in one plane, or nearly."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) < 5 or spread[2] < FLAT * spread[0]:
        return np.arange(len(points))
    geometry, utility = open3d().geometry, open3d().utility
    _, corners = geometry.PointCloud(utility.Vector3dVector(points)).compute_convex_hull()
    return np.sort(np.asarray(corners, dtype=np.intp))
