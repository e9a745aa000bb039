"""Where to begin when nothing is known: poses that put the object behind the pixels that show it.

Two kinds. Pairs of pixels with normals are matched to pairs of the object's surface that look alike (Drost et al.,
CVPR 2010; see scenes.evidence.point_pairs): few are needed where the shape tells. Even rotations behind random pixels
do where normals tell nothing. All are looked at once by what the camera sees past them, those that may be among the
best on few rows of evidence, too, and only the best that differ are moved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scenes.evidence.align import AlignSettings, costs
from scenes.evidence.point_pairs import pair_table
from scenes.evidence.search import best_that_differ, first_of_cells, rotation_grid, thin
from scenes.evidence.table import Evidence
from scenes.geometry import poses as se3
from scenes.geometry.cameras import Camera
from scenes.geometry.objects import ObjectModel
from vision.normal_kernels import surface_at

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StartSettings:
    """How many poses are thought of, and how many are kept. Values tuned on generated captures."""

    # Pixels that get a normal, and how far what it is fitted to reaches: share of the object's radius, of how thick it
    # is (the mean length of lines through it), since a pipe is round within the first, and limits (m).
    oriented: int = 150
    reach_share: float = 0.12
    reach_thick: float = 0.4
    reach: tuple[float, float] = (0.005, 0.012)
    # Neighbours of points without an image. Fewest readings or neighbours, and the largest thickness (m) of what is
    # taken for a surface: noise at two sigmas.
    neighbours: int = 40
    fewest: int = 8
    thickest: float = 0.003
    # Pairs of pixels looked up, how many alike each brings, and the shortest as a share of the object's radius; whether
    # these are drawn from those that look alike, or are the nearest of all.
    pairs: int = 100
    each: int = 12
    shortest: float = 0.3
    drawn: bool = False
    # Starts of even rotations.
    even: int = 600
    # Rows of evidence that the starts are ranked on, and the blur of pairs and of even ones, in radii and metres.
    rows: int = 40
    blur_pairs: tuple[float, float, float] = (0.10, 0.004, 0.010)
    blur_even: tuple[float, float, float] = (0.35, 0.010, 0.040)
    # Starts kept of each kind.
    keep_pairs: int = 200
    keep_even: int = 80
    # Starts nearer than this to a better one are left out: radians, shares of the radius.
    same_angle: float = 0.25
    same_share: float = 0.12


@dataclass(frozen=True)
class Seen:
    """What may be the object: points (n, 3), camera frame; and of which pixels uv (n, 2) of a depth image (h, w) they
    are, where there is one: all that is read about them tells their normals.
    """

    points: Array
    uv: NDArray[np.int64] | None = None
    depth: NDArray[np.float32] | None = None
    camera: Camera | None = None

    def oriented(
        self, model: ObjectModel, rng: np.random.Generator, settings: StartSettings | None = None
    ) -> tuple[Array, Array]:
        """Some of the points and their outward normals, both (m, 3), m at most settings.oriented: those that are on a
        surface.
        """
        s = settings or StartSettings()
        if self.uv is None or self.depth is None or self.camera is None:
            return oriented_points(self.points, model, rng, s)
        chosen = self.uv[rng.permutation(len(self.points))[: s.oriented]]
        (places, normals), good = np.zeros((2, len(chosen), 3)), np.zeros(len(chosen), dtype=bool)
        lens = float(self.camera.fx), float(self.camera.fy), float(self.camera.cx), float(self.camera.cy)
        limits = reach_of(model, s), s.fewest, s.thickest
        surface_at(self.depth, lens, np.ascontiguousarray(chosen), *limits, places, normals, good)
        return places[good], normals[good]


def reach_of(model: ObjectModel, settings: StartSettings) -> float:
    """How far (m) what tells a normal of the object may reach."""
    thick = 4.0 * model.volume / max(model.area, 1e-12)
    within = min(settings.reach_share * model.radius, settings.reach_thick * thick)
    return float(np.clip(within, *settings.reach))


def pixel_starts(model: ObjectModel, points: Array, count: int, rng: np.random.Generator) -> Array:
    """(count, 4, 4) camera_from_object: even rotations, each with a seen point on the surface that faces the camera.

    points (n, 3): pixels that may be the object, camera frame.
    """
    rotations = rotation_grid(count, rng)
    surface, normals = model.sample_surface(2000, seed=int(rng.integers(2**31)))
    towards = -points.mean(axis=0) / max(float(np.linalg.norm(points.mean(axis=0))), 1e-12)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotations
    seen = points[rng.integers(len(points), size=count)]
    # of a few surface points, take one that faces the camera at this rotation
    tries = rng.integers(len(surface), size=(count, 6))
    facing = np.einsum("ncj,nij,i->nc", normals[tries], rotations, towards)
    chosen = tries[np.arange(count), np.argmax(facing > 0.2, axis=1)]
    poses[:, :3, 3] = seen - np.einsum("nij,nj->ni", rotations, surface[chosen])
    # half of the starts: the seen points' mean on the centroid, pushed back by half the object
    half = slice(0, count, 2)
    middle = points.mean(axis=0) - 0.5 * model.radius * towards
    offset = rng.normal(size=(len(poses[half]), 3)) * 0.3 * model.radius
    poses[half, :3, 3] = middle + offset - rotations[half] @ model.centroid
    return poses


def oriented_points(
    points: Array, model: ObjectModel, rng: np.random.Generator, settings: StartSettings
) -> tuple[Array, Array]:
    """Some of the points (n, 3), camera frame, and their outward normals (m, 3), which face the camera.

    A normal is that of the plane through the neighbours (principal axes); points among too few of them, or where they
    are no surface but a rim, are left out.
    """
    from scipy.spatial import cKDTree

    if len(points) < settings.fewest:
        return np.zeros((0, 3)), np.zeros((0, 3))
    chosen = points[rng.permutation(len(points))[: settings.oriented]]
    count = min(settings.neighbours, len(points))
    distance, index = cKDTree(points).query(chosen, k=count, distance_upper_bound=reach_of(model, settings))
    near = np.isfinite(distance).reshape(len(chosen), count)
    patch = points[np.where(near, index.reshape(near.shape), 0)] - chosen[:, None]
    weight = near / np.maximum(near.sum(axis=1, keepdims=True), 1)
    middle = np.einsum("mk,mki->mi", weight, patch)
    spread = np.einsum("mk,mki,mkj->mij", weight, patch, patch) - middle[:, :, None] * middle[:, None, :]
    values, vectors = np.linalg.eigh(spread)
    normals = vectors[:, :, 0]
    normals = np.where(np.sum(normals * chosen, axis=1, keepdims=True) > 0, -normals, normals)
    thickness = np.sqrt(np.maximum(values, 0.0))
    flat = (thickness[:, 0] < settings.thickest) & (thickness[:, 0] < 0.6 * thickness[:, 1])
    good = flat & (near.sum(axis=1) >= settings.fewest)
    return (chosen + middle)[good], normals[good]


def pair_starts(
    model: ObjectModel, seen: Seen, rng: np.random.Generator, settings: StartSettings | None = None
) -> Array:
    """(n, 4, 4) camera_from_object that lay pairs of the object onto pairs of pixels; none without a pair apart."""
    settings = settings or StartSettings()
    points, normals = seen.oriented(model, rng, settings)
    if len(points) < 2:
        return np.zeros((0, 4, 4))
    first, second = rng.integers(len(points), size=(2, 8 * settings.pairs))
    length = np.linalg.norm(points[first] - points[second], axis=1)
    use = np.flatnonzero((length > settings.shortest * model.radius) & (length < model.diameter))
    # pairs of one plane look like too many others: half of the places go to those whose normals differ most
    telling = np.sum(normals[first[use]] * normals[second[use]], axis=1)
    order = use[np.argsort(telling, kind="stable")]
    half = settings.pairs // 2
    order = np.concatenate([order[:half], np.sort(order[half:])[: settings.pairs - half]])
    if not len(order):
        return np.zeros((0, 4, 4))
    of, table = (points, normals, first[order], second[order], settings.each), pair_table(model)
    rotations, origins = table.drawn(*of, rng) if settings.drawn else table.matching(*of)
    return se3.make_poses(rotations, origins)


def seen_starts(
    model: ObjectModel,
    seen: Seen,
    rows: Evidence,
    rank: Callable[[Array, float], Array],
    rng: np.random.Generator,
    settings: StartSettings | None = None,
) -> Array:
    """The most promising starts (n, 4, 4) camera_from_object of both kinds, those that differ.

    rows: the evidence that ranks them, with rank(poses, blur) -> (n,) in
    the same units added (what the camera saw past). Camera frame.
    """
    settings = settings or StartSettings()
    few = thin(rows, settings.rows)
    # drawn after the pairs, so that these are the same without
    pairs = pair_starts(model, seen, rng, settings)
    even = pixel_starts(model, seen.points, settings.even, rng) if settings.even else np.zeros((0, 4, 4))
    kept = [np.zeros((0, 4, 4))]
    for candidates, (share, low, high), keep in (
        (pairs, settings.blur_pairs, settings.keep_pairs),
        (even, settings.blur_even, settings.keep_even),
    ):
        if not len(candidates):
            continue
        blur = float(np.clip(share * model.radius, low, high))
        how = AlignSettings(blur=blur, blur_normal=0.5)
        past, fit = rank(candidates, blur), partial(costs, model, few, settings=how)
        differ = partial(different, model, settings=settings)
        kept.append(candidates[best_that_differ(candidates, past, fit, differ, keep)[0]])
    return np.concatenate(kept)


def different(
    model: ObjectModel, candidates: Array, merit: Array, settings: StartSettings | None = None
) -> NDArray[np.intp]:
    """Indices of candidates (n, 4, 4), best (lowest merit) first, one of each cell of poses modulo symmetry."""
    s = settings or StartSettings()
    return first_of_cells(model, candidates, np.argsort(merit, kind="stable"), s.same_share, s.same_angle)
