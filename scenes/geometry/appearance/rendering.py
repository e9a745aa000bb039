"""Depth, instance ids and normals of posed triangle meshes, by ray casting. Camera frame, metres.

Each mesh has a ray-casting scene of its own, in its own frame and centred (Open3D computes in float32): moving a
mesh costs nothing, and only the pixels inside its projected box are cast. Rays have z = 1, so that the ray
parameter of a hit is the z-depth. Every hit is then computed again in float64 from the plane of the triangle hit,
so that render -> back-project lands on the mesh to better than a micrometre.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry.appearance import rendering_kernels as kernels
from scenes.geometry.cameras import Camera
from scenes.geometry.poses import apply, check_pose, inverse
from scenes.threads import thread_count

Array = NDArray[np.float64]
Region = tuple[int, int, int, int]

# Float64 refinement may move a hit by no more than this (m): beyond it the ray is parallel to its triangle and
# the plane says nothing, so the float32 hit is kept.
LARGEST_REFINEMENT = 1e-4
# Corners nearer than this (m) to the camera plane do not bound the projection: the whole region is cast.
NEAREST_CORNER = 1e-3
# A mesh of at most this many faces (walls, tables, boxes) is met by formula instead of a ray-casting scene.
FEW_FACES = 4
# Rays up to here are cast by one thread: more take longer to begin than to end, and twice as long where cores are busy.
MANY_RAYS = 16384
# One of fewer vertices has no need of its convex hull to be bounded quickly.
FEW_CORNERS = 500
# A mesh of more vertices than this is bounded by the corners of its box.
MANY_VERTICES = 4000


@dataclass(frozen=True)
class Rendering:
    """What the camera sees in a region of its image.

    depth (h, w) float32 metres along z, 0 where nothing is; ids (h, w) int32, index into `names`, -1 where nothing
    is; normals (h, w, 3) unit, camera frame, turned to the camera, 0 where nothing is; region (u0, v0, u1, v1),
    half open: h = v1 - v0 and w = u1 - u0, the whole image unless a region was asked for.
    """

    depth: NDArray[np.float32]
    ids: NDArray[np.int32]
    names: tuple[str, ...]
    normals: Array
    region: Region

    def mask(self, name: str) -> NDArray[np.bool_]:
        """(h, w) pixels where the named mesh is seen; none when it was not rendered."""
        if name not in self.names:
            return np.zeros(self.ids.shape, dtype=bool)
        return np.asarray(self.ids == self.names.index(name))


class _Caster:
    """One mesh: its centred float32 ray-casting scene and its float64 planes."""

    def __init__(self, name: str, vertices: ArrayLike, faces: ArrayLike) -> None:
        self.vertices = np.array(vertices, dtype=np.float64).reshape(-1, 3)
        self.faces = np.array(faces, dtype=np.int64).reshape(-1, 3)
        if not np.isfinite(self.vertices).all():
            raise InputError(f"renderer: expected finite vertices, got some not finite in mesh {name!r}")
        if len(self.faces) and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise InputError(f"renderer: expected face indices below {len(self.vertices)} in mesh {name!r}")
        self.scene: Any = None
        if len(self.faces):
            low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
            self.centre = (low + high) / 2
            grid = np.array(np.meshgrid(*([[0.0, 1.0]] * 3), indexing="ij")).reshape(3, -1).T
            # of a mesh of few vertices they bound the projection themselves: a hand fills little of its box
            self.outline = self.vertices if len(self.vertices) <= MANY_VERTICES else low + grid * (high - low)
            first, second, third = (self.vertices[self.faces[:, i]] for i in range(3))
            normals = np.cross(second - first, third - first)
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            self.normals = normals / np.where(length > 0, length, 1.0)
            self.offsets = np.einsum("ij,ij->i", self.normals, first)

    def _build(self) -> Any:
        # Built at the first cast: a scene of Open3D does not pickle, arrays do
        if self.scene is None:
            from scenes._open3d import open3d

            core = open3d().core
            scene = open3d().t.geometry.RaycastingScene(nthreads=thread_count())
            scene.add_triangles(
                core.Tensor((self.vertices - self.centre).astype(np.float32)),
                core.Tensor(self.faces.astype(np.uint32)),
            )
            # the first ray makes its tree; only then may other threads see it: frames of a sequence share a renderer
            scene.cast_rays(core.Tensor(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]], dtype=np.float32)))
            self.scene = scene
        return self.scene

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "scene": None}

    def bounds(self, camera: Camera, pose: Array, region: Region) -> Region:
        """The part of `region` that the mesh's box can project to; empty when u1 <= u0 or v1 <= v0."""
        if not len(self.faces):
            return (region[0], region[1], region[0], region[1])
        nearest, farthest, *box = kernels.box_of(*_lens(camera), pose, self.outline)
        if farthest <= 0:
            return (region[0], region[1], region[0], region[1])
        if nearest < NEAREST_CORNER:
            return region
        u0, v0, u1, v1 = (min(max(x, -1e9), 1e9) for x in box)
        low, high = (math.floor(u0) - 1, math.floor(v0) - 1), (math.ceil(u1) + 2, math.ceil(v1) + 2)
        return (max(region[0], low[0]), max(region[1], low[1]), min(region[2], high[0]), min(region[3], high[1]))

    def cast(self, camera: Camera, part: Region, pose: Array) -> tuple[Array, NDArray[np.uint32]]:
        """z-depths (h, w), inf for no hit, and triangle indices of the rays through the pixels of `part`."""
        if len(self.faces) <= FEW_FACES:
            shape = (part[3] - part[1], part[2] - part[0])
            depth, found = np.zeros(shape), np.zeros(shape, dtype=np.uint32)
            kernels.few_faces(*_lens(camera), *part[:2], apply(pose, self.vertices)[self.faces], depth, found)
            return depth, found
        origin, rotation = self._view(pose)
        shape = (part[3] - part[1], part[2] - part[0])
        view = (*_lens(camera), part[0], part[1])
        rays = np.zeros((*shape, 6), dtype=np.float32)
        kernels.mesh_rays(*view, origin - self.centre, rotation, rays)
        hits, triangles = self._hits(rays)
        depth = np.zeros(shape)
        planes = (self.normals, self.offsets, LARGEST_REFINEMENT)
        kernels.exact_hits(*view, origin, rotation, *planes, hits, triangles, depth)
        return depth, triangles

    def _hits(self, rays: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Ray parameters, inf for no hit, and triangles of rays (..., 6)."""
        from scenes._open3d import open3d

        threads = thread_count() if rays.size > 6 * MANY_RAYS else 1
        answer = self._build().cast_rays(open3d().core.Tensor(rays), nthreads=threads)
        return answer["t_hit"].numpy(), answer["primitive_ids"].numpy()

    @cached_property
    def hull(self) -> Array:
        """(n, 3) vertices of the convex hull: what bounds the mesh in an image most narrowly."""
        from scenes.geometry.surface import hull_of

        return np.ascontiguousarray(self.vertices[hull_of(self.vertices)])

    def seen_at(self, camera: Camera, part: Region, pose: Array) -> tuple[NDArray[np.int64], Array]:
        """Pixels (n, 2) of `part` in which the mesh is seen when it is alone, row by row, and its depths (n,) there."""
        pixels = np.zeros(((part[2] - part[0]) * (part[3] - part[1]), 2), dtype=np.int64)
        corners = self.hull if len(self.vertices) > FEW_CORNERS else self.vertices
        if float((corners @ pose[2, :3]).min()) + pose[2, 3] < NEAREST_CORNER:
            corners = corners[:0]
        pixels = pixels[: kernels.pixels_about(*_lens(camera), pose, corners, part, pixels)]
        own, view, planes = np.zeros(len(pixels)), self._view(pose), (self.normals, self.offsets, LARGEST_REFINEMENT)
        _, hits, triangles = self._hits_at(camera, part, pixels, *view)
        count = kernels.hit_pixels(*_lens(camera), *view, *planes, hits, triangles, pixels, own)
        return pixels[:count], own[:count]

    def keep_seen(self, camera: Camera, part: Region, pose: Array, pixels: NDArray[np.int64], own: Array) -> int:
        """How many of pixels (n, 2) with depths own (n,) this mesh, seen in `part` alone, does not cover; these are put
        first.
        """
        view, planes = self._view(pose), (self.normals, self.offsets, LARGEST_REFINEMENT)
        which, hits, triangles = self._hits_at(camera, part, pixels, *view)
        return int(kernels.keep_seen(*_lens(camera), *view, *planes, hits, triangles, which, pixels, own))

    def _view(self, pose: Array) -> tuple[Array, Array]:
        """The camera's place (3,) and axes (3, 3) in the mesh's frame."""
        mesh_from_camera = inverse(pose)
        return mesh_from_camera[:3, 3].copy(), np.ascontiguousarray(mesh_from_camera[:3, :3])

    def _hits_at(
        self, camera: Camera, part: Region, pixels: NDArray[np.int64], origin: Array, rotation: Array
    ) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.uint32]]:
        """Which of pixels (n, 2) are in `part` (m,), and their rays' hits (m,) and triangles (m,)."""
        which, rays = np.zeros(len(pixels), dtype=np.int64), np.zeros((len(pixels), 6), dtype=np.float32)
        count = kernels.rays_at(*_lens(camera), pixels, part, origin - self.centre, rotation, which, rays)
        return which[:count], *self._hits(rays[:count])


def _lens(camera: Camera) -> tuple[float, float, float, float]:
    return camera.fx, camera.fy, camera.cx, camera.cy


class Renderer:
    """Named triangle meshes that can be seen from any camera at any pose."""

    def __init__(self, meshes: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None) -> None:
        """meshes: name -> (vertices (n, 3) metres, faces (m, 3)), each in its own frame; a mesh may be empty."""
        self._casters: dict[str, _Caster] = {}
        self._last: tuple[_Caster, Camera, Array, Region, NDArray[np.int64], Array] | None = None
        for name, (vertices, faces) in (meshes or {}).items():
            self.add(name, vertices, faces)

    @property
    def names(self) -> tuple[str, ...]:
        """The meshes held, in the order they came."""
        return tuple(self._casters)

    def add(self, name: str, vertices: ArrayLike, faces: ArrayLike) -> None:
        """Add a mesh, or replace the one of that name. Raises InputError for non-finite vertices or bad indices."""
        self._casters[name] = _Caster(name, vertices, faces)

    def copy(self) -> Renderer:
        """Another that holds the same meshes, and shares what was built to cast at them."""
        other = Renderer()
        other._casters = dict(self._casters)
        return other

    def vertices(self, name: str, pose: Array) -> Array:
        """(n, 3) vertices of the named mesh at a pose target_from_mesh (4, 4)."""
        return apply(pose, self._casters[name].vertices)

    def _checked(self, poses: Mapping[str, ArrayLike]) -> dict[str, Array]:
        unknown = [name for name in poses if name not in self._casters]
        if unknown:
            raise InputError(f"renderer: expected meshes among {list(self.names)}, got {unknown[0]!r}")
        named = [np.asarray(pose, dtype=np.float64) for pose in poses.values()]
        if len(named) > 1 and all(pose.shape == (4, 4) for pose in named):
            with suppress(InputError):  # which names none of them
                return dict(zip(poses, check_pose(np.stack(named))))
        return {name: check_pose(pose, f"pose of {name!r}") for name, pose in zip(poses, named)}

    def render(self, camera: Camera, poses: Mapping[str, ArrayLike], region: Region | None = None) -> Rendering:
        """See the posed meshes.

        poses: name -> camera_from_mesh (4, 4); meshes not named are absent from the view. region: pixels
        (u0, v0, u1, v1), half open, clipped to the image; default the whole image. Raises InputError for an unknown
        name or a bad pose.
        """
        whole = _clip(region, camera)
        height, width = whole[3] - whole[1], whole[2] - whole[0]
        depth = np.full((height, width), np.inf)
        ids = np.full((height, width), -1, dtype=np.int32)
        normals = np.zeros((height, width, 3))
        checked = self._checked(poses)
        for index, (name, pose) in enumerate(checked.items()):
            caster = self._casters[name]
            part = caster.bounds(camera, pose, whole)
            if part[2] <= part[0] or part[3] <= part[1]:
                continue
            t, triangles = caster.cast(camera, part, pose)
            rows = slice(part[1] - whole[1], part[3] - whole[1])
            columns = slice(part[0] - whole[0], part[2] - whole[0])
            rotation = np.ascontiguousarray(pose[:3, :3])
            image = (depth[rows, columns], ids[rows, columns], normals[rows, columns])
            view = (*_lens(camera), part[0], part[1])
            kernels.merge(*view, rotation, caster.normals, index, t, triangles, *image)
        depth[ids < 0] = 0.0
        return Rendering(depth.astype(np.float32), ids, tuple(checked), normals, whole)

    def own_pixels(self, camera: Camera, poses: Mapping[str, ArrayLike], name: str) -> tuple[int, int]:
        """Counts of the named mesh's in-image pixels: (seen when it is alone, seen with everything posed)."""
        checked = self._checked(poses)
        if name not in checked:
            raise InputError(f"renderer: expected a pose of {name!r}, got poses of {list(checked)}")
        part, pixels, own = self._alone(camera, checked[name], name)
        count = len(own)
        for other, pose in checked.items():
            if other == name or not count:
                continue
            caster = self._casters[other]
            sub = caster.bounds(camera, pose, part)
            if sub[2] <= sub[0] or sub[3] <= sub[1]:
                continue
            if len(caster.faces) <= FEW_FACES:
                t, _ = caster.cast(camera, sub, pose)
                count = kernels.keep_before(*sub[:2], t, pixels[:count], own[:count])
            else:
                count = caster.keep_seen(camera, sub, pose, pixels[:count], own[:count])
        return len(own), count

    def _alone(self, camera: Camera, pose: Array, name: str) -> tuple[Region, NDArray[np.int64], Array]:
        """Where the mesh may be in the image, its pixels (n, 2) when it is alone, and their depths (n,). Those of the
        last view are kept: what hides an object is tried many times in one view of it. Both arrays are the caller's.
        """
        caster = self._casters[name]
        last = self._last
        if last is None or last[0] is not caster or last[1] != camera or not np.array_equal(last[2], pose):
            part = caster.bounds(camera, pose, _clip(None, camera))
            pixels, own = np.zeros((0, 2), dtype=np.int64), np.zeros(0)
            if part[2] > part[0] and part[3] > part[1]:
                pixels, own = caster.seen_at(camera, part, pose)
            last = self._last = caster, camera, pose, part, pixels, own
        return last[3], last[4].copy(), last[5].copy()

    def visible_fraction(self, camera: Camera, poses: Mapping[str, ArrayLike], name: str) -> float:
        """Share of the named mesh's own in-image pixels that stay visible among all posed meshes.

        1 - this is the hidden share, the measure of occlusion. 0 when the mesh is not in the image at all.
        """
        alone, seen = self.own_pixels(camera, poses, name)
        return seen / alone if alone else 0.0


def region_rays(camera: Camera, region: Region) -> Array:
    """(v1 - v0, u1 - u0, 3) ray directions with z = 1 through the pixel centres of a region (u0, v0, u1, v1)."""
    u0, v0, u1, v1 = region
    rays = np.ones((v1 - v0, u1 - u0, 3))
    rays[..., 0] = (np.arange(u0, u1) - camera.cx) / camera.fx
    rays[..., 1] = ((np.arange(v0, v1) - camera.cy) / camera.fy)[:, None]
    return rays


def _clip(region: Region | None, camera: Camera) -> Region:
    if region is None:
        return (0, 0, camera.width, camera.height)
    u0, v0, u1, v1 = (int(x) for x in region)
    u0, v0 = min(max(u0, 0), camera.width), min(max(v0, 0), camera.height)
    return (u0, v0, max(u0, min(u1, camera.width)), max(v0, min(v1, camera.height)))


# Flat colours of instances when none are given: the first mesh, the second, and so on (RGB).
PALETTE = ((214, 120, 60), (222, 184, 160), (120, 134, 150), (110, 160, 120), (150, 120, 170), (200, 190, 120))
AMBIENT = 0.35  # share of light that reaches surfaces turned away from the lamp (no unit); looks natural


def shade(
    rendering: Rendering,
    colours: Mapping[str, tuple[int, int, int]] | None = None,
    light: ArrayLike = (-0.3, -0.5, -1.0),
    background: tuple[int, int, int] = (24, 26, 30),
) -> NDArray[np.uint8]:
    """A colour image (h, w, 3) uint8: each instance in its flat colour under one distant lamp (Lambert).

    colours: name -> RGB, palette otherwise. light: direction towards the lamp, camera frame.
    """
    given = dict(colours or {})
    table = [given.get(name, PALETTE[i % len(PALETTE)]) for i, name in enumerate(rendering.names)]
    table.append(background)
    toward = np.asarray(light, dtype=np.float64)
    toward = toward / np.linalg.norm(toward)
    image = np.zeros((*rendering.ids.shape, 3), dtype=np.uint8)
    kernels.paint(rendering.ids, rendering.normals, np.array(table, dtype=np.float64), toward, AMBIENT, image)
    return image
