"""What a frame leaves open of a turn about an axis about which most of an object is round, as a mug without its handle.

A handle that nobody sees may be anywhere where it would not be seen, far from where samples about one pose reach, and
a search's modes are some of these places. So the whole objective is asked about the pose turned all around.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.search.pool import Pool
from scenes.evidence import table as tables
from scenes.evidence.align import costs
from scenes.evidence.near_symmetries import TURNS, WITHIN, small_turn, turns_about
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from vision.picture import columns

Array = NDArray[np.float64]


# Rays (no unit) of a predicted picture on what is not round, of those that nothing hides, which must be seen at the
# depth predicted: at least so many, and this share. By judgement: of a handle that is seen there are twenty and more of
# 28 x 28, of a finger's edge that is taken for one a few.
LEAST_SHOWN, SHARE_SHOWN = 8, 0.6


def left_by_turns(pool: Pool, pose: Array, as_seen: Array, known: Array, share: float, side: int) -> Array:
    """(6, 6) by how much more than `known` (6, 6) a frame leaves open of an object at pose (4, 4), camera axes; nothing
    more without an image, which sees where a handle is not, and where it is seen.

    as_seen (4, 4): where the depth image shows it. share: of what is sensed, the nats that count (see
    `ModeSettings.temper`); a prior's count in full. side: rays along each side of an outline's box.
    """
    turns = turned(pool.model, as_seen)
    if not (pool.predictor.sees and len(turns)):
        return np.zeros((6, 6))
    # a handle that is seen is its own reason, however little of a picture it is
    unseen = ~shown(pool, as_seen, side)
    if not unseen.any():
        return np.zeros((6, 6))
    asked = np.concatenate([as_seen[None], turns])
    nats = pool.costs(asked, side)
    by_prior = np.zeros(len(asked))
    if pool.prior is not None:
        by_prior = costs(pool.model, tables.empty(), asked, pool.prior)
    nats = share * (nats - by_prior) + by_prior
    return open_by_turns(pool.model, pose, np.where(np.repeat(unseen, TURNS - 1), nats[1:] - nats[0], np.inf), known)


def shown(pool: Pool, pose: Array, side: int) -> NDArray[np.bool_]:
    """(k,) whether the image shows what is not round about each axis where it is at pose (4, 4)."""
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
        off = [np.abs(model.field.distance(se3.apply(turn, points))) for turn in turns]
        part = np.mean(off, axis=0) > WITHIN
        seen, bare = np.count_nonzero(part & near), np.count_nonzero(part & ~hidden)
        out[k] = seen >= max(LEAST_SHOWN, SHARE_SHOWN * bare)
    return out


def turned(model: ObjectModel, pose: Array) -> Array:
    """(n, 4, 4) an object at pose (4, 4), turned about each axis about which most of it is round."""
    return np.asarray(pose @ turns_about(model).reshape(-1, 4, 4))


def open_by_turns(model: ObjectModel, pose: Array, nats: Array, known: Array) -> Array:
    """(6, 6) by how much more than `known` (6, 6) is open, where an object at pose (4, 4) that is turned as `turned`
    has it costs nats (n,) more. It is told as of small turns about each axis, which take the centroid along its circle:
    what knows where that is knows nothing of the turn.
    """
    out = np.zeros((6, 6))
    axes = np.kron(np.eye(2), pose[:3, :3])
    angles = np.arange(1, TURNS) * (2.0 * np.pi / TURNS)
    angles = np.minimum(angles, 2.0 * np.pi - angles)
    for turns, of_each in zip(turns_about(model), nats.reshape(-1, TURNS - 1)):
        weights = np.exp(min(0.0, float(of_each.min())) - np.append(0.0, of_each))  # of inf 0
        square = float(weights[1:] @ angles**2 / weights.sum())
        along = axes @ small_turn(model, turns)
        there = float(along[:3] @ (known + out)[:3, :3] @ along[:3])
        out += max(square - there, 0.0) * np.outer(along, along)
    return out
