"""Depth, instance ids and normals of posed triangle meshes, by ray casting. Camera frame, metres.

Each mesh has a ray-casting scene of its own, in its own frame and centred (Open3D computes in float32): moving a
mesh costs nothing, and only the pixels inside its projected box are cast. Rays have z = 1, so that the ray
parameter of a hit is the z-depth. Every hit is then computed again in float64 from the plane of the triangle hit,
so that render -> back-project lands on the mesh to better than a micrometre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.errors import InputError
from scenes.geometry import rendering_kernels as kernels
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
        corners = apply(pose, self.outline)
        if (corners[:, 2] <= 0).all():
            return (region[0], region[1], region[0], region[1])
        if (corners[:, 2] < NEAREST_CORNER).any():
            return region
        pixels, _ = camera.project(corners)
        low = np.clip(np.floor(pixels.min(axis=0)) - 1, -1e9, 1e9).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)) + 2, -1e9, 1e9).astype(int)
        return (max(region[0], low[0]), max(region[1], low[1]), min(region[2], high[0]), min(region[3], high[1]))

    def cast(self, camera: Camera, part: Region, pose: Array) -> tuple[Array, NDArray[np.uint32]]:
        """z-depths (h, w), inf for no hit, and triangle indices of the rays through the pixels of `part`."""
        if len(self.faces) <= FEW_FACES:
            shape = (part[3] - part[1], part[2] - part[0])
            depth, found = np.zeros(shape), np.zeros(shape, dtype=np.uint32)
            lens = (camera.fx, camera.fy, camera.cx, camera.cy, part[0], part[1])
            kernels.few_faces(*lens, apply(pose, self.vertices)[self.faces], depth, found)
            return depth, found
        mesh_from_camera = inverse(pose)
        origin, rotation = mesh_from_camera[:3, 3].copy(), np.ascontiguousarray(mesh_from_camera[:3, :3])
        shape = (part[3] - part[1], part[2] - part[0])
        view = (camera.fx, camera.fy, camera.cx, camera.cy, part[0], part[1])
        rays = np.zeros((*shape, 6), dtype=np.float32)
        kernels.mesh_rays(*view, origin - self.centre, rotation, rays)
        from scenes._open3d import open3d

        threads = thread_count() if shape[0] * shape[1] > MANY_RAYS else 1
        answer = self._build().cast_rays(open3d().core.Tensor(rays), nthreads=threads)
        hits, triangles = answer["t_hit"].numpy(), answer["primitive_ids"].numpy()
        depth = np.zeros(shape)
        planes = (self.normals, self.offsets, LARGEST_REFINEMENT)
        kernels.exact_hits(*view, origin, rotation, *planes, hits, triangles, depth)
        return depth, triangles


class Renderer:
    """Named triangle meshes that can be seen from any camera at any pose."""

    def __init__(self, meshes: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None) -> None:
        """meshes: name -> (vertices (n, 3) metres, faces (m, 3)), each in its own frame; a mesh may be empty."""
        self._casters: dict[str, _Caster] = {}
        for name, (vertices, faces) in (meshes or {}).items():
            self.add(name, vertices, faces)

    @property
    def names(self) -> tuple[str, ...]:
        """The meshes held, in the order they came."""
        return tuple(self._casters)

    def add(self, name: str, vertices: ArrayLike, faces: ArrayLike) -> None:
        """Add a mesh, or replace the one of that name. Raises InputError for non-finite vertices or bad indices."""
        self._casters[name] = _Caster(name, vertices, faces)

    def vertices(self, name: str, pose: Array) -> Array:
        """(n, 3) vertices of the named mesh at a pose target_from_mesh (4, 4)."""
        return apply(pose, self._casters[name].vertices)

    def _checked(self, poses: Mapping[str, ArrayLike]) -> dict[str, Array]:
        unknown = [name for name in poses if name not in self._casters]
        if unknown:
            raise InputError(f"renderer: expected meshes among {list(self.names)}, got {unknown[0]!r}")
        return {name: check_pose(pose, f"pose of {name!r}") for name, pose in poses.items()}

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
            view = (camera.fx, camera.fy, camera.cx, camera.cy, part[0], part[1])
            kernels.merge(*view, rotation, caster.normals, index, t, triangles, *image)
        depth[ids < 0] = 0.0
        return Rendering(depth.astype(np.float32), ids, tuple(checked), normals, whole)

    def own_pixels(self, camera: Camera, poses: Mapping[str, ArrayLike], name: str) -> tuple[int, int]:
        """Counts of the named mesh's in-image pixels: (seen when it is alone, seen with everything posed)."""
        checked = self._checked(poses)
        if name not in checked:
            raise InputError(f"renderer: expected a pose of {name!r}, got poses of {list(checked)}")
        part = self._casters[name].bounds(camera, checked[name], _clip(None, camera))
        if part[2] <= part[0] or part[3] <= part[1]:
            return 0, 0
        own, _ = self._casters[name].cast(camera, part, checked[name])
        alone = np.isfinite(own)
        front = alone.copy()
        for other, pose in checked.items():
            if other == name:
                continue
            caster = self._casters[other]
            sub = caster.bounds(camera, pose, part)
            if sub[2] <= sub[0] or sub[3] <= sub[1]:
                continue
            t, _ = caster.cast(camera, sub, pose)
            rows, columns = slice(sub[1] - part[1], sub[3] - part[1]), slice(sub[0] - part[0], sub[2] - part[0])
            front[rows, columns] &= own[rows, columns] <= t
        return int(alone.sum()), int(front.sum())

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
