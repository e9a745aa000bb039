"""A closed mesh of an object from depth images with known poses: what was seen, and a filling for what was not.

Curless & Levoy (SIGGRAPH 1996): signed distances along the cameras' rays, truncated and averaged on a lattice. Where no
camera looked the object ends at the convex hull of what was seen and touched, and where the hand is. Object frame,
metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes._open3d import open3d
from scenes.errors import MeshError
from scenes.geometry import mesh_repair
from scenes.geometry.cameras import Camera

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class ReconstructionSettings:
    """How finely, and what is believed. Values tuned on generated captures."""

    # Voxels along the cube's side, and the smallest voxel (m): below, depth noise is all that is seen.
    resolution: int = 128
    smallest_voxel: float = 0.001
    # Distances are kept this many voxels to either side of a surface: less than a mug's wall and its noise lose touch.
    truncation: float = 4.0
    # Room (m) around what was seen.
    margin: float = 0.015
    # Unseen borders are smoothed over this many voxels: they are where sight ended, in steps of pixels.
    smooth: float = 1.5
    # Share of the views (at least one) that must have looked at a voxel before it is believed.
    least_views: float = 0.1
    # Pieces of observed surface smaller than this share of the largest are flying pixels.
    smallest_piece: float = 0.05
    # Views (number) at which a vertex is half sure: confidence is views / (views + this).
    half_sure: float = 2.0
    # Triangles of the mesh, at most; more where simplifying it would open it.
    most_faces: int = 20_000


@dataclass(frozen=True)
class DepthView:
    """One depth image: camera; camera_from_object (4, 4); depth (h, w) m, 0 where nothing is to be believed; mask
    (h, w), the pixels of `depth` that are the object's (the others say what is free before them).
    """

    camera: Camera
    camera_from_object: Array
    depth: NDArray[np.float32]
    mask: NDArray[np.bool_]

    def points(self) -> Array:
        """(n, 3) points of the object's pixels, object frame."""
        seen = self.camera.back_project(self.depth, self.mask)
        rotation, translation = self.camera_from_object[:3, :3], self.camera_from_object[:3, 3]
        return (seen - translation) @ rotation


@dataclass(frozen=True)
class Reconstruction:
    """vertices (n, 3) m and faces (m, 3), closed and wound outwards; confidence (n,): 0 where filled, towards 1 the
    more views saw the place; voxel: size (m) of what can be told apart.
    """

    vertices: Array
    faces: Faces
    confidence: Array
    voxel: float

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(n,) vertices that a camera saw."""
        return self.confidence > 0


def reconstruct(
    views: Sequence[DepthView],
    touched: Array | None = None,
    hand: tuple[Array, Faces] | None = None,
    settings: ReconstructionSettings | None = None,
) -> Reconstruction:
    """Fuse views into a closed mesh.

    touched (k, 3): points felt on the surface, object frame. hand: vertices and faces of the hand that holds it,
    object frame: no part of the object is in there. Raises MeshError when the views show no surface.
    """
    from scipy.spatial import cKDTree

    settings = settings or ReconstructionSettings()
    points = [view.points() for view in views]
    seen = np.concatenate(points) if points else np.zeros((0, 3))
    if len(seen) < 100:
        raise MeshError(f"views: expected some hundred readings of the object, got {len(seen)} in {len(views)} views")
    felt = np.zeros((0, 3)) if touched is None else np.asarray(touched, dtype=np.float64).reshape(-1, 3)
    low, high = np.percentile(seen, (0.5, 99.5), axis=0)
    if len(felt):
        low, high = np.minimum(low, felt.min(axis=0)), np.maximum(high, felt.max(axis=0))
    middle, side = 0.5 * (low + high), float((high - low).max()) + 2 * settings.margin
    voxel = max(side / settings.resolution, settings.smallest_voxel)
    count = int(np.ceil(side / voxel))
    side = count * voxel
    origin = middle - 0.5 * side
    volume = _volume(side, count, settings.truncation * voxel, origin)
    for view in views:
        _integrate(volume, view)
    grid = np.asarray(volume.extract_volume_tsdf()).reshape(count, count, count, 2)
    distance, weight = grid[..., 0].copy(), grid[..., 1].copy()
    known = weight >= max(1.0, settings.least_views * len(views))
    shell = _surface(volume, distance, known, settings)
    if len(shell) < 20:
        raise MeshError(f"views: expected a surface that several views share, got {len(shell)} points of one")
    field = _completed(distance, known, np.concatenate([shell, felt]), origin, voxel, hand, settings)
    vertices, faces = _march(volume, field)
    vertices, faces = _largest(vertices, faces)
    raw, sure = vertices, _confidence(vertices, distance, np.where(known, weight, 0.0), origin, voxel, settings)
    vertices, faces = _simplified(vertices, faces, settings.most_faces)
    vertices, faces, _ = mesh_repair.close(vertices, faces, "reconstruction")
    return Reconstruction(vertices, faces, sure[cKDTree(raw).query(vertices)[1]], voxel)


def _volume(side: float, count: int, truncation: float, origin: Array) -> Any:
    o3d = open3d()
    kind = o3d.pipelines.integration.TSDFVolumeColorType.NoColor
    return o3d.pipelines.integration.UniformTSDFVolume(side, count, truncation, kind, origin=origin)


def _integrate(volume: Any, view: DepthView) -> None:
    o3d = open3d()
    camera = view.camera
    depth = o3d.geometry.Image(np.ascontiguousarray(view.depth, dtype=np.float32))
    blank = o3d.geometry.Image(np.zeros((camera.height, camera.width), dtype=np.float32))
    image = o3d.geometry.RGBDImage()
    image.depth, image.color = depth, blank
    intrinsic = o3d.camera.PinholeCameraIntrinsic(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    )
    volume.integrate(image, intrinsic, view.camera_from_object)


def _march(volume: Any, field: Array) -> tuple[Array, Faces]:
    """Marching cubes of a field on the volume's lattice, positive outside."""
    o3d = open3d()
    pairs = np.stack([field.ravel(), np.ones(field.size)], axis=1)
    volume.inject_volume_tsdf(o3d.utility.Vector2dVector(pairs))
    mesh = volume.extract_triangle_mesh()
    return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)


def _surface(volume: Any, distance: Array, known: NDArray[np.bool_], settings: ReconstructionSettings) -> Array:
    """(n, 3) points of the surface that was seen, flying pieces left out."""
    o3d = open3d()
    pairs = np.stack([distance.ravel(), known.ravel().astype(np.float64)], axis=1)
    volume.inject_volume_tsdf(o3d.utility.Vector2dVector(pairs))
    mesh = volume.extract_triangle_mesh()
    if not len(mesh.triangles):
        return np.zeros((0, 3))
    piece, size, _ = mesh.cluster_connected_triangles()
    piece, size = np.asarray(piece), np.asarray(size)
    kept = size[piece] >= settings.smallest_piece * size.max()
    return np.asarray(mesh.vertices)[np.unique(np.asarray(mesh.triangles)[kept])]


def _completed(
    distance: Array,
    known: NDArray[np.bool_],
    shell: Array,
    origin: Array,
    voxel: float,
    hand: tuple[Array, Faces] | None,
    settings: ReconstructionSettings,
) -> Array:
    """The measured field, and where nothing was measured the signed distance (in truncations) to the convex hull of
    `shell` (n, 3) less the hand; the lattice's border is outside.
    """
    from scipy import ndimage
    from scipy.spatial import ConvexHull

    reach = settings.truncation * voxel
    count = len(distance)
    field = np.where(known, distance, 1.0)
    hull = ConvexHull(shell)
    centres = origin + voxel * (np.arange(count)[:, None] + 0.5)
    low, high = shell.min(axis=0), shell.max(axis=0)
    inside = [(centres[:, k] > low[k]) & (centres[:, k] < high[k]) for k in range(3)]
    unknown = np.argwhere(~known & inside[0][:, None, None] & inside[1][:, None] & inside[2])
    points = origin + voxel * (unknown + 0.5)
    value = np.zeros(len(points))
    for begin in range(0, len(points), 50_000):
        part = points[begin : begin + 50_000]
        value[begin : begin + 50_000] = (part @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    if hand is not None:
        within = np.flatnonzero(value < 0)
        value[within] = np.maximum(value[within], -_signed(hand, points[within]))
    field[tuple(unknown.T)] = np.clip(value / reach, -1.0, 1.0)
    # nothing was measured inside a solid: pockets there are where rays ended, and the smooth border is as good as any
    solid = ndimage.binary_fill_holes(field < 0)
    field = np.where(solid & (field > 0), -1.0, field)
    measured = known & (np.abs(distance) < 1.0)
    field = np.where(measured, field, ndimage.gaussian_filter(field, settings.smooth))
    for axis in range(3):
        edge = np.moveaxis(field, axis, 0)
        edge[0], edge[-1] = 1.0, 1.0
    return field


def _signed(mesh: tuple[Array, Faces], points: Array) -> Array:
    """(n,) signed distances of points to a closed mesh, positive outside."""
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(mesh[0], dtype=np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(mesh[1], dtype=np.uint32)),
    )
    if not len(points):
        return np.zeros(0)
    return scene.compute_signed_distance(o3d.core.Tensor(points.astype(np.float32))).numpy().astype(np.float64)


def _largest(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """The piece of a mesh that holds most volume."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        raise MeshError("views: expected a surface, got none")
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(len(vertices),) * 2)
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    corners = vertices[faces] - vertices.mean(axis=0)
    volumes = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    chosen = faces[piece == int(np.argmax(np.abs(np.bincount(piece, volumes))))]
    used, renumbered = np.unique(chosen, return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3).astype(np.int64)


def _simplified(vertices: Array, faces: Faces, most: int) -> tuple[Array, Faces]:
    """At most `most` triangles of the same shape; as it is when simplifying opens it."""
    if len(faces) <= most:
        return vertices, faces
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    small = mesh.simplify_quadric_decimation(most)
    if not small.is_watertight():
        return vertices, faces
    return np.asarray(small.vertices).copy(), np.asarray(small.triangles).astype(np.int64)


def _confidence(
    vertices: Array, distance: Array, views: Array, origin: Array, voxel: float, settings: ReconstructionSettings
) -> Array:
    """(n,) how sure each vertex is, as marching cubes puts it on an edge of the lattice: the fewer views of the edge's
    two ends, over views + half_sure. 0 where the edge crosses no measured surface but the border of what was seen.
    """
    place = (vertices - origin) / voxel - 0.5
    last = len(views) - 1
    ends = [np.clip(f(place + s).astype(np.int64), 0, last) for f, s in ((np.floor, 1e-4), (np.ceil, -1e-4))]
    one, other = (distance[tuple(end.T)] for end in ends)
    least = np.minimum(*(views[tuple(end.T)] for end in ends))
    return np.asarray(np.where(one * other <= 0, least / (least + settings.half_sure), 0.0))
