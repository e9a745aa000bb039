"""Whether another thing in the image shows the object as well: the second of two cans on a table.

A search without a start ends in one of them, and all that is asked of the answer says yes: it explains what is seen
there, and all around it is worse. Which of the two is meant nothing tells. So where nobody says what hides the object,
and nothing is felt of it, the pixels that the answer leaves over are searched at a glance, each piece of the image by
itself, and what is found there and costs hardly more, or is as clear as an answer is, is a hypothesis of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fusion.estimation.confidence import ConfidenceSettings, chances
from fusion.estimation.search.pool import Pool
from scenes.evidence.modes import Mode
from scenes.geometry import poses as se3
from scenes.geometry.objects import ObjectModel
from vision.look.looked import surface_rows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AnotherSettings:
    """What is another like the answer. By judgement, but for `as_likely` and `clear`."""

    # Pixels this near to the answer's surface are its own: a share of the object's radius, and metres at least.
    own_share: float = 0.1
    own: float = 0.005
    # Poses that are fitted, the best of what each piece proposes.
    fitted: int = 3
    # Nats that it may cost more than the answer, which was searched with care: of 13 copies beside an object in packed
    # scenes of another generator the farthest cost 6.8 more, of other things beside answers that were right and `ok`
    # there the nearest 7.8; no right answer of the tuning families, which have no copies, has another by this.
    as_likely: float = 7.5
    # Or nats that it costs itself, at most: what is half hidden earns less than what is not. Copies in another
    # generator's scenes of two cost -22.9 at most, other things beside 58 answers of the tuning families -17.4 at
    # least; half of these answers themselves less than -25.
    clear: float = -20.0
    # Chance of being right (no unit) that it would be given, were it the answer: from here on.
    least: float = 0.5


def why_no_other(pool: Pool, doubted: bool) -> str:
    """Why no other thing like the answer need be looked for; "" where it must. doubted: the answer is not sure by
    itself.
    """
    if doubted:
        return "the answer is in doubt"
    if pool.prior is not None:
        return "a start says which is meant"
    if pool.contacts:
        return "it is felt where it is"
    return "it is known what hides the object" if pool.predictor.told_apart else ""


def another(
    pool: Pool, modes: tuple[Mode, ...], confident: ConfidenceSettings, settings: AnotherSettings | None = None
) -> tuple[Mode, float] | None:
    """What is elsewhere, by the answer's other modes or by what the first leaves over in the image, and would be given
    the largest chance of being right, were it the answer: a mode with a weight of 1 and a cost beside the answer's, and
    that chance; None where nothing is about as likely.
    """
    s, model, first = settings or AnotherSettings(), pool.model, modes[0]
    own = max(s.own, s.own_share * model.radius)
    poses = np.concatenate([np.array([mode.pose for mode in modes]), _glanced(pool, first.pose, own)])
    poses = poses[_elsewhere(pool, poses, first.pose)]
    ends = pool.compete(poses, s.fitted) if len(poses) else ()
    here = float(pool.costs(first.pose[None])[0])
    best: tuple[Mode, float] | None = None
    for end in ends:
        more = end.cost - here
        unlikely = more > s.as_likely and end.cost > s.clear
        if unlikely or not _elsewhere(pool, end.pose[None], first.pose)[0]:
            continue
        one, picture = (replace(end, weight=1.0, cost=first.cost + more),), pool.predictor.predict(end.pose[None])
        chance = chances(model, one, picture, (), 0.0, confident, pool.prior is None)[0]
        if chance >= max(s.least, best[1] if best is not None else 0.0):
            best = one[0], chance
    return best


def with_other(
    model: ObjectModel, modes: tuple[Mode, ...], right: float, other: Mode, chance: float, printed: float = 1.0
) -> tuple[tuple[Mode, ...], float]:
    """Modes with another after the first, in place of those where it is, and the chance that the first is right: it had
    `right` by itself, the other `chance`, and one of them at most is the object that is meant. printed: how many times
    as likely the other is than the first by what is printed on it.
    """
    odds, against = (p / max(1.0 - p, 1e-6) for p in (right, chance))
    against *= printed
    share = against / max(odds + against, 1e-12)
    away = [_apart(model, mode.pose[None], other.pose)[0] > model.radius for mode in modes[1:]]
    kept = [modes[0], *(mode for mode, is_away in zip(modes[1:], away) if is_away)]
    whole = max(sum(mode.weight for mode in kept), 1e-12)
    rest = tuple(replace(mode, weight=(1.0 - share) * mode.weight / whole) for mode in kept)
    return (rest[0], replace(other, weight=share), *rest[1:]), odds / (1.0 + odds + against)


def _glanced(pool: Pool, pose: Array, own: float) -> Array:
    """(n, 4, 4) poses that a few pairs of pixels propose, of the image and of each piece of it by itself, without the
    pixels within `own` (m) of the surface at pose (4, 4).
    """
    found = [np.zeros((0, 4, 4))]
    for pixels in (pool.looked.pixels, *pool.looked.pieces):
        off = np.abs(pool.model.field.distance(se3.apply(se3.inverse(pose), pixels.points)))
        left = replace(pool.looked, pixels=pixels.take(np.flatnonzero(off > own)))
        rest = replace(pool, looked=left, rng=pool.rng.spawn(1)[0])
        found.append(rest.glanced(surface_rows(left, pool.depth, pool.rows)))
    return np.concatenate(found)


def _elsewhere(pool: Pool, poses: Array, pose: Array) -> NDArray[np.bool_]:
    """Which of poses (n, 4, 4) have the object's middle at least its radius beside where pose (4, 4) has it."""
    return _apart(pool.model, poses, pose) > pool.model.radius


def _apart(model: ObjectModel, poses: Array, pose: Array) -> Array:
    """(n,) metres from the object's middle at poses (n, 4, 4) to where pose (4, 4) has it."""
    away = poses[:, :3, :3] @ model.centroid + poses[:, :3, 3] - se3.apply(pose, model.centroid[None])
    return np.asarray(np.linalg.norm(away, axis=1))
