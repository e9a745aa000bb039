"""Motions that leave most of an object where it was: the poses that a rough look confuses with the right one.

A mug without its handle is round, a hammer's handle has two sides. While a search is blurred, such poses cost almost
the same, and what tells them apart, a handle, is looked at last; so a search that has found one asks for the others.
Unlike `scenes.geometry.symmetries`, they are no excuse: their errors count.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations, product
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenes.cache import remembered
from scenes.evidence import table as evidence
from scenes.evidence.align import AlignSettings, align
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel

Array = NDArray[np.float64]

# Raised whenever what is found below changes, so that old files are not read.
CACHE_VERSION = 2


@dataclass(frozen=True)
class NearSettings:
    """What is nearly the same. Values by judgement, on mugs and tools."""

    # Turns about each principal axis that are tried (rad): a handle is some 20 degrees wide.
    step: float = float(np.deg2rad(15.0))
    # Surface samples.
    samples: int = 300
    # Distance from the surface, as a share of the radius, within which a moved sample is where one was; and the least
    # share of samples for which that must hold. A mug's handle is a sixth of its surface.
    near_share: float = 0.05
    least: float = 0.7
    # Motions that differ by less than this (rad) are one.
    same: float = float(np.deg2rad(8.0))


# Turns (no unit), evenly about an axis, all of which must leave this share of the surface where it is, to so much (m:
# half of what an answer may be off), for an object to be round about it: of a mug a sixth is handle. And the cosine
# from which on two axes are one.
TURNS, OF_SURFACE, WITHIN, SAME_AXIS = 12, 0.95, 0.0025, 0.99

# Turns (no unit), evenly about an axis of which most of an object is round: a handle is some 20 degrees wide.
AROUND = 24

_FOUND: WeakKeyDictionary[ObjectModel, Array] = WeakKeyDictionary()
_ROUND: WeakKeyDictionary[ObjectModel, Array] = WeakKeyDictionary()
_TURNS: WeakKeyDictionary[ObjectModel, Array] = WeakKeyDictionary()
_TURNING: WeakKeyDictionary[ObjectModel, Array] = WeakKeyDictionary()


def _once(
    kept: WeakKeyDictionary[ObjectModel, Array], model: ObjectModel, make: Callable[[ObjectModel], Array]
) -> Array:
    """What is made of an object at the first call, and kept as long as it is."""
    found = kept.get(model)
    if found is None:
        found = kept[model] = make(model)
    return found


def near_symmetries(model: ObjectModel) -> Array:
    """(k, 4, 4) object_from_object motions, the identity not among them; found at the first call for an object and kept
    on disk.
    """
    found = _FOUND.get(model)
    if found is None:
        settings = NearSettings()
        axes = [part for axis in model.symmetries.axes for part in (axis.point, axis.direction)]
        arrays = remembered(
            "alike",
            (CACHE_VERSION, settings),
            (model.vertices, model.faces, model.symmetries.discrete, *axes),
            lambda: {"motions": find_near_symmetries(model, settings)},
            lambda stored: stored["motions"].shape[1:] == (4, 4) and bool(np.isfinite(stored["motions"]).all()),
        )
        found = _FOUND[model] = arrays["motions"]
    return found


def find_near_symmetries(model: ObjectModel, settings: NearSettings | None = None) -> Array:
    """(k, 4, 4) turns about the principal axes, settled where most of the surface lies on itself. k may be 0."""
    settings = settings or NearSettings()
    points, _ = model.sample_surface(settings.samples, seed=3)
    # principal axes of the surface's inner half, which parts that stand out do not tilt
    away = np.linalg.norm(points - model.centroid, axis=1)
    inner = points[away <= np.quantile(away, 0.75)]
    axes = [np.linalg.svd(cloud - cloud.mean(axis=0), full_matrices=False)[2] for cloud in (points, inner)]
    angles = np.arange(settings.step, 2 * np.pi - 0.5 * settings.step, settings.step)
    rotations = se3.exp_rotation((angles[:, None, None] * np.concatenate(axes)[None]).reshape(-1, 3))
    starts = np.tile(np.eye(4), (len(rotations), 1, 1))
    starts[:, :3, :3] = rotations
    starts[:, :3, 3] = model.centroid - rotations @ model.centroid
    near = settings.near_share * model.radius
    # gates of three sigmas: what stands out does not pull
    rows = evidence.make(points, 0.5 * near, evidence.TOUCH, gate_above=3.0, gate_below=3.0)
    settled = align(model, rows, starts, settings=AlignSettings(iterations=15)).poses
    off = np.array([np.abs(model.field.distance(se3.apply(pose, points))) for pose in settled])
    shares = (off < near).mean(axis=1)
    kept = [np.eye(4)]
    # of those that leave as much in place, the one that settled best: others are still on their way, degrees off
    for i in np.lexsort((np.minimum(off, near).mean(axis=1), -np.round(shares, 2))):
        if shares[i] < settings.least:
            break
        # modulo what really is a symmetry: a bottle turned about its axis is the bottle
        alike = model.symmetries.nearest(np.tile(settled[i], (len(kept), 1, 1)), np.array(kept))
        turned = np.swapaxes(np.array(kept)[:, :3, :3], -1, -2) @ alike[:, :3, :3]
        if se3.rotation_angle(turned).min() > settings.same:
            kept.append(settled[i])
    return np.array(kept[1:]).reshape(-1, 4, 4)


def round_axes(model: ObjectModel) -> Array:
    """(k, 3) unit vectors, object axes, about which it is round but for little, though nobody has said so: a can with a
    seam. Worked out at the first call for an object.
    """
    return _once(_ROUND, model, _round_axes)


def _round_axes(model: ObjectModel) -> Array:
    points, _ = model.sample_surface(NearSettings().samples, seed=3)

    def stays(turns: Array) -> NDArray[np.bool_]:
        """Which of turns (n, 4, 4) leave the surface in its place."""
        off = [np.abs(model.field.distance(se3.apply(turn, points))) for turn in turns]
        return np.array([float(np.quantile(one, OF_SURFACE)) < WITHIN for one in off], dtype=np.bool_)

    turns = near_symmetries(model)
    logs = np.array([se3.log_rotation(turn[:3, :3]) for turn in turns[stays(turns)]]).reshape(-1, 3)
    axes = logs / np.maximum(np.linalg.norm(logs, axis=1, keepdims=True), 1e-12)
    out: list[Array] = []
    for axis in axes:
        if any(abs(float(axis @ other)) > SAME_AXIS for other in out):
            continue
        # turns by nearly half a turn tell of their axis best
        near = np.where(np.abs(axes @ axis) > SAME_AXIS, np.linalg.norm(logs, axis=1), 0.0) * np.sign(axes @ axis)
        mean = near @ axes
        mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
        angles = np.arange(1, TURNS) * (2.0 * np.pi / TURNS)
        rotations = se3.exp_rotation(angles[:, None] * mean)
        if stays(se3.make_poses(rotations, model.centroid - rotations @ model.centroid)).all():
            out.append(mean)
    return np.array(out).reshape(-1, 3)


def turns_about(model: ObjectModel) -> Array:
    """(k, 23, 4, 4) object_from_object: the turns by every 15 degrees about each of the k axes about which most of an
    object (`NearSettings.least`) is round, as all of a mug is but its handle; those of a declared symmetry, and those
    about which it is round but for little (`round_axes`), are not among them. Worked out at the first call for an
    object.
    """
    return _once(_TURNING, model, _turns_about)


def _turns_about(model: ObjectModel) -> Array:
    settings = NearSettings()
    points, _ = model.sample_surface(settings.samples, seed=3)

    def off(motion: Array, share: float = settings.least) -> float:
        return float(np.quantile(np.abs(model.field.distance(se3.apply(motion, points))), share))

    out: list[Array] = []
    axes = [axis.direction for axis in model.symmetries.axes]
    for motion in sorted(near_symmetries(model), key=off):  # those that settled best tell of their axis best
        log = se3.log_rotation(motion[:3, :3])
        direction = log / max(float(np.linalg.norm(log)), 1e-12)
        if any(abs(float(direction @ other)) > SAME_AXIS for other in axes):
            continue
        # what a turn R p + t leaves in place, at the height of the centroid
        rows = np.concatenate([np.eye(3) - motion[:3, :3], direction[None]])
        point = np.linalg.lstsq(rows, np.append(motion[:3, 3], direction @ model.centroid), rcond=None)[0]
        rotations = se3.exp_rotation(np.arange(1, AROUND)[:, None] * (2.0 * np.pi / AROUND) * direction)
        turns = se3.make_poses(rotations, point - rotations @ point)
        if max(off(turn) for turn in turns) < WITHIN:
            axes = [*axes, direction]
            if max(off(turn, OF_SURFACE) for turn in turns) >= WITHIN:
                out.append(turns)
    return np.array(out).reshape(-1, AROUND - 1, 4, 4)


def small_turn(model: ObjectModel, turns: Array) -> Array:
    """(6,) how a turn of 1 rad about an axis, were it small, turns the object and moves its centroid, object axes; of
    turns (n, 4, 4) all around it, of `turns_about`.
    """
    steps = se3.difference(np.array([turns[0], turns[-1]]), np.eye(4), model.centroid)
    step = steps[0] - steps[1]
    axis = step[:3] / max(float(np.linalg.norm(step[:3])), 1e-12)
    # R^T t = (R^T - 1) a for a point a of the axis, and all turns of it, the one by nothing among them, add up to 0
    beside = np.sum([turn[:3, :3].T @ turn[:3, 3] for turn in turns], axis=0) / (len(turns) + 1)
    return np.concatenate([axis, np.cross(axis, model.centroid + beside)])


def quarter_turns(model: ObjectModel) -> Array:
    """(23, 4, 4) object_from_object: the turns of a cube about the object's centroid and principal axes, the identity
    not among them; worked out at the first call for an object.
    """
    return _once(_TURNS, model, _quarter_turns)


def _quarter_turns(model: ObjectModel) -> Array:
    points, _ = model.sample_surface(NearSettings().samples, seed=3)
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    axes = axes * np.sign(np.linalg.det(axes))
    turns = np.array(
        [np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]
    )
    turns = turns[np.linalg.det(turns) > 0.0]
    turns = turns[np.trace(turns, axis1=1, axis2=2) < 2.9]
    rotations = axes.T @ turns @ axes
    return se3.make_poses(rotations, model.centroid - rotations @ model.centroid)
