"""The outline that an object must show at a pose: places in the image, their normals, and the points of the surface
that make them. Camera frame, metres; pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.errors import InputError
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from vision.contour import kernels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OutlineSettings:
    """How an outline is drawn. By judgement."""

    # Rays along the longer side of the box around the outline, and the least distance between them (px).
    side: int = 48
    finest: float = 1.0
    # Halvings between a ray that meets the object and its neighbour that does not: a 32nd of their distance is left.
    halvings: int = 5
    # A place's normal is that of the line through its neighbours within so many steps of the rays; where these lie off
    # it by more than this share (least over largest standard deviation) the outline has a corner and no normal.
    around: float = 3.0
    straight: float = 0.3
    # An outline that is drawn anew from the one before follows it, where at least this share of its places still is a
    # border between so many steps of the rays on either side of where it moved to.
    follows: float = 0.9
    across: float = 0.5

    def __post_init__(self) -> None:
        """Refuse distances that no neighbour is within."""
        if not self.around > 0.0:
            raise InputError(f"around: expected steps above 0, got {self.around:g}")


@dataclass(frozen=True)
class Outline:
    """places (n, 2) in the image (px); normals (n, 2) unit, away from the object; points (n, 3) of the surface,
    camera frame; step: distance between the rays it was found with (px).
    """

    places: Array
    normals: Array
    points: Array
    step: float

    def __len__(self) -> int:
        return len(self.places)

    def take(self, rows: NDArray) -> Outline:
        """The chosen places, in that order."""
        return Outline(self.places[rows], self.normals[rows], self.points[rows], self.step)


def outline_of(model: ObjectModel, camera: Camera, pose: Array, settings: OutlineSettings | None = None) -> Outline:
    """The outer border of the object at pose (4, 4) camera_from_object, as far as it is inside the image.

    Rays on a grid tell inside from outside; between neighbours that differ the border is bracketed by halving.
    """
    s = settings or OutlineSettings()
    none = Outline(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 3)), s.finest)
    low, high = _box(model, camera, pose)
    if not (high > low).all():
        return none
    step = max(float((high - low).max()) / s.side, s.finest)
    low, high = low - 1.5 * step, high + 1.5 * step
    u, v = np.arange(low[0], high[0], step), np.arange(low[1], high[1], step)
    caster = Caster(model, camera, pose)
    grid = caster.depth(np.stack([np.tile(u, len(v)), np.repeat(v, len(u))], axis=1))
    inner, outer, depth = kernels.brackets(grid.reshape(len(v), len(u)), u, v)
    if not len(inner):
        return none
    away = outer - inner
    for _ in range(s.halvings):
        middle = 0.5 * (inner + outer)
        kernels.narrow(inner, outer, middle, caster.depth(middle), depth)
    places, within = _in_image(camera, inner, outer)
    within &= np.isfinite(depth)
    places, away, depth = places[within], away[within], depth[within]
    if len(places) < 3:
        return none
    normals, straight = _normals(places, away, step, s)
    return Outline(places, normals, _points(camera, places) * depth[:, None], step).take(straight)


def outline_near(
    model: ObjectModel,
    camera: Camera,
    pose: Array,
    before: tuple[Outline, Array],
    settings: OutlineSettings | None = None,
) -> Outline:
    """As `outline_of`, from the outline at a pose (4, 4) nearby: its places move with their points of the surface, keep
    their normals, and are bracketed across these; what is no border there any more is left out. Where that is much of
    it, the outline is looked for anew.
    """
    s, (drawn, there) = settings or OutlineSettings(), before
    points = se3.apply(pose @ se3.inverse(there), drawn.points)
    caster, middle, room = Caster(model, camera, pose), camera.project(points)[0], s.across * drawn.step
    inner, outer = middle - room * drawn.normals, middle + room * drawn.normals
    ends = caster.depth(np.concatenate([inner, outer]))
    is_border = np.isfinite(ends[: len(middle)]) & ~np.isfinite(ends[len(middle) :])
    if is_border.sum() < s.follows * len(middle):
        return outline_of(model, camera, pose, s)
    inner, outer, depth = inner[is_border], outer[is_border], ends[: len(middle)][is_border]
    for _ in range(s.halvings):
        middle = 0.5 * (inner + outer)
        kernels.narrow(inner, outer, middle, caster.depth(middle), depth)
    places, within = _in_image(camera, inner, outer)
    points = _points(camera, places) * depth[:, None]
    return Outline(places, drawn.normals[is_border], points, drawn.step).take(within)


def _in_image(camera: Camera, inner: Array, outer: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The middles (n, 2) of brackets, and whether they are in the image."""
    places = 0.5 * (inner + outer)
    within = (places >= 0.0).all(axis=1) & (places[:, 0] <= camera.width - 1) & (places[:, 1] <= camera.height - 1)
    return places, within


def _points(camera: Camera, places: Array) -> Array:
    """(n, 3) points of depth 1 that are seen at places (n, 2)."""
    return np.concatenate([(places - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones((len(places), 1))], 1)


def inner_depths(model: ObjectModel, camera: Camera, pose: Array, outline: Outline, across: tuple[float, ...]) -> Array:
    """(k, n) depth (m) of the object `across` (px along the normal, k) from the outline's places; inf beside it."""
    inside = (outline.places[None] + np.array(across)[:, None, None] * outline.normals[None]).reshape(-1, 2)
    return Caster(model, camera, pose).depth(inside).reshape(len(across), len(outline))


class Caster:
    """Depths of the object at a pose along rays through places of the image."""

    def __init__(self, model: ObjectModel, camera: Camera, pose: Array) -> None:
        self.surface, inverse = model.surface, se3.inverse(pose)
        self.lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self.rotation = np.ascontiguousarray(inverse[:3, :3])
        self.origin = inverse[:3, 3] - self.surface.middle

    def depth(self, places: Array) -> Array:
        """(n,) m along z through places (n, 2); inf where the ray misses."""
        rays = np.zeros((len(places), 6), dtype=np.float32)
        kernels.rays_through(places, self.lens, self.rotation, self.origin, rays)
        return self.surface.cast_local(rays)


def _box(model: ObjectModel, camera: Camera, pose: Array) -> tuple[Array, Array]:
    """Lowest and highest place of the object in the image (px), clipped to it; empty where it is not ahead."""
    bounds = np.zeros(5)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    kernels.box(model.outer_vertices, np.ascontiguousarray(pose[:3, :3]), pose[:3, 3].copy(), lens, bounds)
    if bounds[4] < 1e-3:
        return np.ones(2), np.zeros(2)
    size = np.array([camera.width - 1.0, camera.height - 1.0])
    return np.clip(bounds[[0, 2]], 0.0, size), np.clip(bounds[[1, 3]], 0.0, size)


def _normals(places: Array, away: Array, step: float, settings: OutlineSettings) -> tuple[Array, NDArray[np.bool_]]:
    """(n, 2) normals away from the object, and where the outline is straight enough to have one."""
    found = np.zeros((len(places), 4))
    kernels.spreads(places, settings.around * step, found)
    count, xx, yy, xy = found.T
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)  # of the line along the outline
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    largest, least = half + root, np.maximum(half - root, 0.0)
    normals = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    normals *= np.where(np.einsum("ij,ij->i", normals, away) < 0.0, -1.0, 1.0)[:, None]
    straight = (least < settings.straight**2 * largest) & (count >= 4)
    return normals, straight


def bends(outline: Outline) -> Array:
    """(n, 3) how far (px) places move along their normals where an image has the outline turned, stretched along one
    axis as it shrinks along the other, and sheared, each by a pixel at the mean distance (root mean square) of places
    from their middle.
    """
    about = outline.places - outline.places.mean(axis=0)
    size = max(float(np.sqrt(np.square(about).sum(axis=1).mean())), 1.0)
    (x, y), (u, v) = about.T / size, outline.normals.T
    return np.stack([v * x - u * y, u * x - v * y, u * y + v * x], axis=1)
