"""What a frame leaves open of a turn about an axis about which most of an object is round, as a mug without its handle.

A handle that nobody sees may be anywhere where it would not be seen, far from where samples about one pose reach, and
a search's modes are some of these places. So the whole objective is asked about the pose turned all around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.pool import Pool
from scenes.evidence import table as tables
from scenes.evidence.align import costs
from scenes.evidence.symmetry.near_symmetries import AROUND, WITHIN, small_turn, turns_about
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from vision.picture import columns

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TurnSettings:
    """When a turn is told. By judgement; tried on 18 sequences of a mug of the tuning families `lab`, `rough` and
    `borrowed` (docs/method/tracking.md).
    """

    # Rays (no unit) of a predicted picture on what is not round, of those that nothing hides, which must be seen at the
    # depth predicted: at least so many, and this share. Of a handle that is seen there are twenty and more of 28 x 28,
    # of a finger's edge that is taken for one a few.
    shown: int = 8
    shown_share: float = 0.6
    # What is left open (rad) of a turn at most that the picture is said to tell: as wide as a handle.
    narrow: float = 0.35


@dataclass(frozen=True)
class Around:
    """What a frame tells of turns about axes of roundness. covariance (6, 6), camera axes: by how much more than was
    known they are open about the pose that was asked about. pose (4, 4): the one that is told, which is that one where
    turns are wide open; left (6, 6): by how much more they are open about it.
    """

    covariance: Array
    pose: Array
    left: Array


def by_turns(
    pool: Pool,
    pose: Array,
    as_seen: Array,
    known: Array,
    share: float,
    side: int,
    settings: TurnSettings | None = None,
) -> Around:
    """What a frame tells of an object at pose (4, 4), known to a covariance (6, 6) by itself; nothing more without an
    image, which sees where a handle is not, where it is seen, and of an object with a print, which tells the turn.

    as_seen (4, 4): where the depth image shows it. share: of what is sensed, the nats that count (see
    `ModeSettings.temper`); a prior's count in full. side: rays along each side of an outline's box.
    """
    settings = settings or TurnSettings()
    turns, nothing = turned(pool.model, as_seen), Around(np.zeros((6, 6)), pose, np.zeros((6, 6)))
    if not (pool.predictor.sees and len(turns)) or pool.model.texture is not None:  # a print tells the turn
        return nothing
    # a handle that is seen is its own reason, however little of a picture it is
    unseen = ~shown(pool, as_seen, side, settings)
    if not unseen.any():
        return nothing
    asked = np.concatenate([as_seen[None], turns])
    nats = pool.walking(asked)  # told as well as by rays: either is off by four nats
    by_prior = np.zeros(len(asked))
    if pool.prior is not None:
        by_prior = costs(pool.model, tables.empty(), asked, pool.prior)
    nats = share * (nats - by_prior) + by_prior
    more = np.where(np.repeat(unseen, AROUND - 1), nats[1:] - nats[0], np.inf)
    return around(pool.model, pose, more, known, settings)


def shown(pool: Pool, pose: Array, side: int, settings: TurnSettings | None = None) -> NDArray[np.bool_]:
    """(k,) whether the image shows what is not round about each axis where it is at pose (4, 4)."""
    s = settings or TurnSettings()
    predictor, model = pool.predictor, pool.model
    axes = turns_about(model)
    assert predictor.camera is not None
    view, c = predictor.view(pose[None], side), predictor.camera
    hit = view.has(columns.HIT)[0]
    z, u, v = view.expected[0, hit], view.u[0, hit], view.v[0, hit]
    points = se3.apply(se3.inverse(pose), np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], axis=1))
    near, hidden = (view.has(bit)[0, hit] for bit in (columns.NEAR, columns.HIDDEN | columns.BY_HAND))
    out = np.zeros(len(axes), dtype=np.bool_)
    for k, turns in enumerate(axes):
        several = turns[3::4]  # by 60 degrees: what is not round is off by nearly all of them
        there = points @ np.swapaxes(several[:, :3, :3], 1, 2) + several[:, None, :3, 3]
        off = np.abs(model.field.distance(there.reshape(-1, 3))).reshape(len(several), -1)
        part = off.mean(axis=0) > WITHIN
        seen, bare = np.count_nonzero(part & near), np.count_nonzero(part & ~hidden)
        out[k] = seen >= max(s.shown, s.shown_share * bare)
    return out


def turned(model: ObjectModel, pose: Array) -> Array:
    """(n, 4, 4) an object at pose (4, 4), turned about each axis about which most of it is round."""
    return np.asarray(pose @ turns_about(model).reshape(-1, 4, 4))


def around(model: ObjectModel, pose: Array, nats: Array, known: Array, settings: TurnSettings | None = None) -> Around:
    """What is told where an object at pose (4, 4) that is turned as `turned` has it costs nats (n,) more. It is told as
    of small turns about each axis, which take the centroid along its circle: what knows where that is knows nothing of
    the turn.
    """
    narrow = (settings or TurnSettings()).narrow
    out, left, to = np.zeros((6, 6)), np.zeros((6, 6)), pose
    axes = np.kron(np.eye(2), pose[:3, :3])
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    for turns, of_each in zip(turns_about(model), nats.reshape(-1, AROUND - 1)):
        weights = np.exp(min(0.0, float(of_each.min())) - np.append(0.0, of_each))  # of inf 0
        weights = weights / weights.sum()
        along = axes @ small_turn(model, turns)
        there = float(along[:3] @ (known + out)[:3, :3] @ along[:3])
        square = _square(angles, weights)
        out += max(square - there, 0.0) * np.outer(along, along)
        likeliest = int(np.argmax(weights))
        about = _square(np.asarray(angles - angles[likeliest], dtype=np.float64), weights)
        if about < min(narrow**2, 0.5 * square):
            to, square = to @ turns[likeliest - 1], about
        left += max(square - there, 0.0) * np.outer(along, along)
    return Around(out, to, left)


def _square(angles: Array, weights: Array) -> float:
    """Mean square of angles (n,) (rad), the short way round."""
    return float(weights @ np.abs((angles + np.pi) % (2.0 * np.pi) - np.pi) ** 2)
