"""What of an object's surface a camera sees from each of many directions: its aspects, cast once per object.

Hundreds of poses are asked how well they agree with an image before the best are looked at ray by ray. Seen from nearly
the same direction an object shows nearly the same points, wherever it is and however it is turned about the line of
sight: these are projected, and no ray is cast (sparse views; Stoiber et al. 2022 have them of outlines). Object frame,
metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.geometry.objects import ObjectModel
from scenes.threads import run_chunks
from vision.picture.aspect_kernels import sum_aspects
from vision.picture.columns import SUMS
from vision.picture.glimpse_kernels import glimpse_aspects
from vision.picture.settings import SLENDER

Array = NDArray[np.float64]

# Directions: cells along either side of each face of a cube, of equal angles: 7.5 degrees, by which a point's own
# direction is off, too, where the object is near.
CELLS = 12
# Rays along each side of the box around an outline, and the share of their square that usually meets the object.
SIDE = 12
USUAL = 0.6
# Radii from which it is looked at: a thing in a hand from half a metre to one.
AWAY = 6.0
# Points of the surface whose projections bound the outline.
BOUNDING = 200
# Poses that are enough for another thread, of those summed up and of those glimpsed: half a millisecond's.
ENOUGH, ENOUGH_GLIMPSED = 100, 2000


@dataclass(frozen=True)
class Aspects:
    """Of each of k directions: points (k, m, 3) that are seen, the first count (k,) of which are there; near (k, m, 4):
    which of them is beside each in the grid of rays, one up, left, down and right, -1 for none; cell (k,): what of the
    outline each stands for (m^2, at the centroid's distance). filling: mean share of the boxes around its outlines that
    is the object.
    """

    points: NDArray[np.float32]
    near: NDArray[np.int16]
    count: NDArray[np.int64]
    cell: Array
    filling: float


# images, and camera, noise and limits, of vision.picture.kernels.compare_pixels; parts of part_pieces
Images = tuple[NDArray[Any], ...]
Numbers = tuple[float, ...]
Parts = tuple[NDArray[np.int64], int, Array, float]

# Every so manieth point is looked at in a glimpse, around and around: a prime.
STRIDE = 7


@dataclass(frozen=True)
class Glimpses:
    """Few of the points of each aspect, side by side: points (k, m, 3), the first count (k,) of which are there, evenly
    chosen, any of the first all over the outline.
    """

    points: NDArray[np.float32]
    count: NDArray[np.int64]


_MADE: WeakKeyDictionary[ObjectModel, Aspects] = WeakKeyDictionary()
_GLIMPSES: WeakKeyDictionary[ObjectModel, dict[int, Glimpses]] = WeakKeyDictionary()


def aspects_of(model: ObjectModel) -> Aspects:
    """Those of an object; made at its first call."""
    found = _MADE.get(model)
    if found is None:
        found = _MADE[model] = make_aspects(model)
    return found


def glimpses_of(model: ObjectModel, most: int) -> Glimpses:
    """At most so many points of each aspect of an object; made at its first call."""
    found = _GLIMPSES.setdefault(model, {})
    if most not in found:
        known = aspects_of(model)
        count = np.minimum(known.count, most)
        turn = np.arange(most)[None]
        several = np.maximum(count, 1)[:, None]
        order = np.where(several % STRIDE > 0, turn * STRIDE % several, turn % several)
        chosen = ((order + 0.5) * (known.count[:, None] / several)).astype(np.int64)
        points = np.take_along_axis(known.points, np.minimum(chosen, known.points.shape[1] - 1)[..., None], axis=1)
        found[most] = Glimpses(np.ascontiguousarray(points), count)
    return found[most]


def directions(cells: int) -> Array:
    """(6 cells^2, 3) unit vectors through the middles of the cells of a cube's faces: first those of +x, -x, +y, ..."""
    middles = np.tan((2.0 * (np.arange(cells) + 0.5) / cells - 1.0) * np.pi / 4.0)
    out = np.zeros((6, cells, cells, 3))
    for face in range(6):
        axis = face // 2
        out[face, ..., axis] = 1.0 - 2.0 * (face % 2)
        out[face, ..., (axis + 1) % 3], out[face, ..., (axis + 2) % 3] = np.meshgrid(middles, middles, indexing="ij")
    flat = out.reshape(-1, 3)
    return np.asarray(flat / np.linalg.norm(flat, axis=1, keepdims=True))


def finer(side: int, filling: float) -> int:
    """Rays along each side of the box around an outline that fills this share of it, so that about as many of them meet
    the object as meet a usual one of `side`; twice that at most.
    """
    return int(np.rint(side * np.sqrt(np.clip(USUAL / max(filling, 1e-3), 1.0, 4.0))))


def make_aspects(model: ObjectModel, cells: int = CELLS, side: int = SIDE) -> Aspects:
    """The aspects of an object from `cells` directions along each side of a cube's faces, side^2 rays each, or more of
    a thing that fills little of its outlines' boxes.
    """
    made = _cast(model, cells, side)
    more = finer(side, made.filling)
    return made if more == side else replace(_cast(model, cells, more), filling=made.filling)


def _cast(model: ObjectModel, cells: int, side: int) -> Aspects:
    towards, away = directions(cells), AWAY * model.radius
    across = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards), axis=1)])
    across /= np.linalg.norm(across, axis=1)[:, None]
    # axes of each camera, as rows
    axes = np.stack([across, np.cross(-towards, across), -towards], axis=1)
    outer, _ = model.bounding_points(BOUNDING)
    plane = _projected(outer - model.centroid, axes, away)
    turned = _along_outline(axes, plane)
    along = _projected(outer - model.centroid, turned, away)
    thin = np.prod(np.ptp(along, axis=1), axis=1) < SLENDER * np.prod(np.ptp(plane, axis=1), axis=1)
    axes[thin], plane[thin] = turned[thin], along[thin]
    low, high = plane.min(axis=1), plane.max(axis=1)
    step = (high - low) / side
    at = low[:, None] + step[:, None] * (np.arange(side) + 0.5)[:, None]
    rays = np.ones((len(towards), side, side, 3))
    rays[..., 0], rays[..., 1] = at[:, None, :, 0], at[:, :, None, 1]
    rays = np.einsum("krci,kij->krcj", rays, axes)
    origins = np.broadcast_to((model.centroid + away * towards)[:, None, None], rays.shape)
    depth = model.surface.cast(origins.reshape(-1, 3), rays.reshape(-1, 3)).reshape(rays.shape[:3])
    hit = np.isfinite(depth)
    count = hit.reshape(len(towards), -1).sum(axis=1)
    # a ray's place among those that meet the object; a border of none around all
    place = np.full((len(towards), side + 2, side + 2), -1, dtype=np.int16)
    inner = place[:, 1:-1, 1:-1]
    inner[hit] = (np.cumsum(hit.reshape(len(towards), -1), axis=1) - 1).reshape(hit.shape)[hit]
    points = np.zeros((len(towards), int(count.max()), 3), dtype=np.float32)
    near = np.full((*points.shape[:2], 4), -1, dtype=np.int16)
    which = np.nonzero(hit)[0]
    points[which, inner[hit]] = (origins + depth[..., None] * rays)[hit]
    for way, (down, right) in enumerate(((0, 1), (1, 0), (2, 1), (1, 2))):
        near[which, inner[hit], way] = place[:, down : down + side, right : right + side][hit]
    return Aspects(points, near, count, np.prod(step, axis=1) * away**2, float(hit.mean()))


def _projected(points: Array, axes: Array, away: float) -> Array:
    """(k, n, 2) where cameras with axes (k, 3, 3), as rows, that look at the origin from so far see points (n, 3)."""
    local = points @ axes.transpose(0, 2, 1) + np.array([0.0, 0.0, away])
    return np.asarray(local[..., :2] / local[..., 2:])


def _along_outline(axes: Array, places: Array) -> Array:
    """The axes (k, 3, 3) of cameras, turned about the line of sight to those of the places (k, n, 2) that they see."""
    centred = places - places.mean(axis=1, keepdims=True)
    uu, vv = np.square(centred).sum(axis=1).T
    angle = 0.5 * np.arctan2(2.0 * centred.prod(axis=2).sum(axis=1), uu - vv)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    across = cosine * axes[:, 0] + sine * axes[:, 1]
    return np.stack([across, cosine * axes[:, 1] - sine * axes[:, 0], axes[:, 2]], axis=1)


def sums_of(
    model: ObjectModel,
    poses: Array,
    images: Images,
    camera: Numbers,
    noise: Numbers,
    limits: Numbers,
    running: Numbers,
    parts: Parts,
) -> tuple[Array, Array, Array]:
    """What the points that the object shows at poses (n, 4, 4) camera_from_object add up to: shares (n, SUMS), how much
    of what is seen is of parts that go on beyond the outline (n,), and the outline's area (n,) px^2. All else as
    `sum_aspects` takes it.
    """
    known = aspects_of(model)
    sums, (beyond, area) = np.zeros((len(poses), SUMS)), np.zeros((2, len(poses)))
    most, poses = known.points.shape[1], np.ascontiguousarray(poses)
    about = (known.points, known.near, known.count, known.cell), CELLS, model.centroid
    frame = images, camera, noise, limits, running, parts

    def work(part: slice) -> None:
        (seen, fade), (column, row) = np.zeros((2, most)), np.zeros((2, most), dtype=np.int64)
        rooms = (seen, fade, np.zeros(most, dtype=np.uint8), column, row), np.zeros((2, len(parts[2])))
        sum_aspects(*about, poses[part], *frame, *rooms, (sums[part], beyond[part], area[part]))

    run_chunks(work, len(poses), smallest=ENOUGH)
    return sums, beyond, area


def glimpsed(
    model: ObjectModel,
    poses: Array,
    small: NDArray[np.float32],
    step: int,
    camera: Numbers,
    noise: Numbers,
    sigmas: float,
    most: int,
) -> Array:
    """(n, 2) shares, of `most` points that the object shows at poses (n, 4, 4) camera_from_object, that are seen, as
    well as they agree, and seen past. All else as `glimpse_aspects` takes it.
    """
    known, shares = glimpses_of(model, most), np.zeros((len(poses), 2))
    about, poses = (known.points, known.count, CELLS, model.centroid), np.ascontiguousarray(poses)

    def work(part: slice) -> None:
        glimpse_aspects(*about, poses[part], small, step, camera, noise, sigmas, shares[part])

    run_chunks(work, len(poses), smallest=ENOUGH_GLIMPSED)
    return shares
